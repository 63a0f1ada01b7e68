"""benchmarks/decisions.py: it reports what it says, draws it, and stops where backends do not agree."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench.scripts import load_benchmark

from async_tnt.checking import backends

end_to_end = load_benchmark("measure_end_to_end")

RECORDED = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "decisions.json"


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """One quick run: its module, report, text and picture."""
    folder = tmp_path_factory.mktemp("decisions")
    script = load_benchmark("decisions")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        words = ["--quick", "--json", str(folder / "d.json"), "--picture", str(folder / "d.png")]
        assert script.main(words) == 0
    return script, json.loads((folder / "d.json").read_text(encoding="utf-8")), printed.getvalue(), folder / "d.png"


def test_every_row_is_timed_or_left_out_with_a_reason(quick):
    _, report, text, _ = quick
    for part in ("network", "end_to_end", "starts"):
        rows = report[part] if part == "starts" else report[part]["1"]["in_blocks"]["us"]
        assert set(rows) | set(report["left_out"][part]) == set(report["work"][part])
        assert not set(rows) & set(report["left_out"][part])
    assert "left out: compiling takes too long for a quick look" in text
    for words in (*backends.WORK.values(), end_to_end.WORK["ours"]):
        assert words in text or "left out: " in text


def test_figures_hang_together(quick):
    _, report, _, _ = quick
    size, blocks = report["settings"]["decisions_a_block"], report["settings"]["blocks"]
    assert list(report["network"]) == ["1", "10", "100", "1300", "random"]
    assert list(report["end_to_end"]) == ["1", "10", "100", "1300"]
    for part, base in (("network", "incremental"), ("end_to_end", "ours")):
        for name, row in report[part].items():
            for mode in ("call_by_call", "in_blocks"):
                us = row[mode]["us"]
                assert next(iter(us)) == ("dense" if name == "random" else base)
                assert set(row[mode]["ratio"]) == set(us) - {next(iter(us))}
                assert 0 <= row[mode]["largest_difference"] < 1e-4
                for figure in us.values():
                    assert figure["n"] == size * blocks
                    assert 0 < figure["q1"] <= figure["median"] <= figure["q3"] <= figure["p99"] <= figure["max"]
    assert report["machine"]["cpu"] and report["machine"]["numpy"] == np.__version__
    assert report["settings"]["threads"] == 1 and report["settings"]["quick"] is True


def test_the_text_shows_the_figures(quick):
    script, report, text, _ = quick
    assert "\n".join(script.lines(report)) + "\n" == text
    figure = report["end_to_end"]["100"]["call_by_call"]["us"]["ours"]
    assert f"{figure['median']:,.1f} [{figure['q1']:,.1f}, {figure['q3']:,.1f}]" in text
    assert "backends alternate from call to call" in text and "each decides in blocks of 10 calls" in text


def test_the_picture_is_drawn_again_from_the_figures_alone(quick, tmp_path, capsys):
    script, report, _, picture = quick
    source = tmp_path / "d.json"
    source.write_text(json.dumps(report), encoding="utf-8")
    assert script.main(["--from", str(source), "--picture", str(tmp_path / "again.png")]) == 0
    assert (tmp_path / "again.png").read_bytes() == picture.read_bytes()
    assert 5_000 < picture.stat().st_size < 150_000


def test_the_picture_names_every_line_and_shows_its_medians(quick):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    script, report, _, _ = quick
    drawing = sys.modules[script.draw_decisions.__module__]
    left, right = drawing.draw_decisions(report).axes
    for axes, rows, looks in ((left, report["network"], drawing.NETWORKS), (right, report["end_to_end"], drawing.WAYS)):
        shown = set(rows["1"]["in_blocks"]["us"])
        if axes is left and report["settings"]["onnxruntime_way"]:
            shown -= {*backends.ONNXRUNTIME} - {report["settings"]["onnxruntime_way"]}
        words = sorted(text.get_text() for text in axes.texts)
        assert words == sorted(looks[name][0] for name in shown)
        drawn = [[float(y) for y in line.get_ydata()] for line in axes.lines]
        for name in shown:
            for mode in ("in_blocks", "call_by_call"):
                medians = [rows[n][mode]["us"][name]["median"] for n in ("1", "10", "100", "1300")]
                assert medians in drawn
        assert axes.get_yscale() == "log"


def test_backends_that_do_not_agree_are_exit_code_1(monkeypatch, capsys):
    right = backends.CompiledClassifier.__call__
    monkeypatch.setattr(backends.CompiledClassifier, "__call__", lambda self, volume: 1.001 * right(self, volume))
    assert load_benchmark("decisions").main(["--quick"]) == 1
    captured = capsys.readouterr()
    assert "all must give the same logits within 0.0001, got incremental and dense" in captured.err
    assert captured.out == ""


def test_a_picture_of_another_kind_is_bad_usage(capsys):
    with pytest.raises(SystemExit, match="2"):
        load_benchmark("decisions").main(["--quick", "--picture", "d.gif"])
    assert "must end in .png, .svg, .pdf, got d.gif" in capsys.readouterr().err


def shape_of(value: Any) -> Any:
    """Keys, without what differs from run to run."""
    return {key: shape_of(v) for key, v in value.items()} if isinstance(value, dict) else None


def holds(whole: Any, part: Any) -> bool:
    """Whether all keys of `part` are in `whole`, too."""
    return part is None or (whole is not None and all(k in whole and holds(whole[k], v) for k, v in part.items()))


@pytest.mark.skipif(not RECORDED.exists(), reason="results are not part of an installed package")
def test_the_recorded_run_was_a_full_one_of_this_very_script(quick):
    script, report = quick[0], copy.deepcopy(quick[1])
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))
    assert {k: recorded["settings"][k] for k in script.FULL} == script.FULL and not recorded["settings"]["quick"]
    assert recorded["left_out"] == {"network": {}, "end_to_end": {}, "starts": {}}
    assert recorded["work"] == report["work"]
    report["settings"]["onnxruntime_way"] = recorded["settings"]["onnxruntime_way"]
    del report["left_out"]
    ways = {name: row for name, row in report["every_event"]["packets"].items() if "onnxruntime" not in name}
    report["every_event"]["packets"] = ways  # either way of calling it may have been the faster
    assert holds(shape_of(recorded), shape_of(report))
    assert not holds(shape_of(report), shape_of(recorded))  # `ours_cold`: the test itself can fail
