"""The scripts under benchmarks/ run, report every row, and refuse to compare different work."""

from __future__ import annotations

import contextlib
import gc
import importlib.util
import io
import json
from typing import Any

import numpy as np
import pytest
from bench.scripts import FOLDER, load_benchmark
from made import events_of, random_model

from async_tnt import TNTConfig, load_model
from async_tnt.checking import backends
from async_tnt.checking.interleaved import WorkDiffers
from async_tnt.checking.moments import Moment, bench_recordings, windows_of

DIGITS = load_model("digits")
decisions, starts, touched = map(load_benchmark, ("decisions", "measure_starts", "measure_touched"))


# -- memory.py, peers.py ---------------------------------------------------------------------------------


def test_memory_is_compared_with_a_limit(capsys):
    memory = load_benchmark("memory")
    words = ["--events", "1100000", "--json", "--limit-mb"]
    assert (memory.main([*words, "1000"]), memory.main([*words, "-1000"])) == (0, 1)
    result = json.loads(capsys.readouterr().out.splitlines()[0])
    assert result["events"] >= 1_100_000
    assert result["decisions"] >= 6 * (result["events"] // 16_900)  # 4 to 5 triggers, the end, and on demand
    assert result["grown_mb"] == pytest.approx(result["end_mb"] - result["first_million_mb"], abs=0.02)
    before, block = memory.resident_mb(), np.ones(64 << 20, np.uint8)  # more than malloc ever takes from memory it has
    assert 50 < memory.resident_mb() - before < 80 and block.any()
    with pytest.raises(SystemExit, match="2"):
        memory.main(["--events", "1000000"])
    assert "--events must be more than the first 1,000,000, got 1,000,000" in capsys.readouterr().err


def test_every_peer_is_timed_or_left_out_with_a_reason(tmp_path):
    assert load_benchmark("peers").main(["--quick", "--json", str(tmp_path / "peers.json")]) == 0
    report = json.loads((tmp_path / "peers.json").read_text(encoding="utf-8"))
    (result,) = report["results"]
    rows, left_out = result["rows"], set(report["left_out"])
    assert rows.keys() | left_out == report["work"].keys() and not rows.keys() & left_out
    for name, row in rows.items():
        assert row["mev_per_s"] == pytest.approx(1e3 / row["ns_per_event"]["median"])
        assert name.startswith("ours") or row["times_ours_update_read"] > 0
    for package, name in (("torch", "dsec_torch"), ("torch", "torch_scatter"), ("eventcv", "eventcv_numpy")):
        if importlib.util.find_spec(package):
            assert result["largest_difference"][name] < 1e-4
    assert {"ours_update", "ours_update_read", "ours_fresh", "ours_fresh_raw"} <= rows.keys()


def test_unequal_volumes_stop_the_comparison_of_peers(monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed")
    peers = load_benchmark("peers")
    right = peers.dsec_volume
    monkeypatch.setattr(peers, "dsec_volume", lambda *columns: right(*columns) * 1.01)
    with pytest.raises(RuntimeError, match=r"must make the same volume as ours .*'dsec_torch': 0\.01"):
        peers.compare((34, 34), 1300, 1, rounds=1)


# -- decisions.py ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """One quick run: its report, text and picture."""
    folder = tmp_path_factory.mktemp("decisions")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        words = ["--quick", "--json", str(folder / "d.json"), "--picture", str(folder / "d.png")]
        assert decisions.main(words) == 0
    return json.loads((folder / "d.json").read_text(encoding="utf-8")), printed.getvalue(), folder / "d.png"


def test_every_row_is_timed_or_left_out_with_a_reason(quick):
    report, text, _ = quick
    for part in ("network", "end_to_end", "starts"):
        rows = report[part] if part == "starts" else report[part]["1"]["in_blocks"]["us"]
        assert set(rows) | set(report["left_out"][part]) == set(report["work"][part])
        assert not set(rows) & set(report["left_out"][part])
        assert not [work for name, work in report["work"][part].items() if name in rows and work not in text]
    assert "left out: compiling takes too long for a quick look" in text


def test_figures_are_in_order_and_in_the_text(quick):
    report, text, _ = quick
    size, blocks = report["settings"]["decisions_a_block"], report["settings"]["blocks"]
    assert list(report["network"]) == ["1", "10", "100", "1300", "random"]
    for part, base in (("network", "incremental"), ("end_to_end", "ours")):
        for name, row in report[part].items():
            for mode in row.values():
                first = "dense" if name == "random" else base
                assert next(iter(mode["us"])) == first and set(mode["ratio"]) == set(mode["us"]) - {first}
                assert 0 <= mode["largest_difference"] < 1e-4
                for figure in mode["us"].values():
                    assert figure["n"] == size * blocks
                    assert 0 < figure["q1"] <= figure["median"] <= figure["q3"] <= figure["p99"] <= figure["max"]
                    assert f"{figure['median']:,.1f} [{figure['q1']:,.1f}, {figure['q3']:,.1f}]" in text
    for row in report["every_event"]["singles"].values():
        assert 0 < row["q1"] <= row["median"] <= row["q3"] <= row["p99"] <= row["p999"] <= row["max"]
    assert "\n".join(decisions.lines(report)) + "\n" == text and gc.isenabled()


def test_the_picture_is_drawn_from_the_figures_alone(quick, tmp_path, capsys):
    report, _, picture = quick
    (tmp_path / "d.json").write_text(json.dumps(report), encoding="utf-8")
    words = ["--from", str(tmp_path / "d.json"), "--picture", str(tmp_path / "again.png")]
    assert decisions.main(words) == 0
    assert (tmp_path / "again.png").read_bytes() == picture.read_bytes()
    drawing = decisions.draw_decisions.__globals__
    for axes, part, looks in zip(
        decisions.draw_decisions(report).axes,
        ("network", "end_to_end"),
        (drawing["NETWORKS"], drawing["WAYS"]),
        strict=True,
    ):
        rows = report[part]
        shown = set(rows["1"]["in_blocks"]["us"])
        if part == "network" and report["settings"]["onnxruntime_way"]:
            shown -= {*backends.ONNXRUNTIME} - {report["settings"]["onnxruntime_way"]}
        assert sorted(text.get_text() for text in axes.texts) == sorted(looks[name][0] for name in shown)
        drawn = [[float(y) for y in line.get_ydata()] for line in axes.lines]
        for name in shown:
            for mode in ("in_blocks", "call_by_call"):
                assert [rows[n][mode]["us"][name]["median"] for n in ("1", "10", "100", "1300")] in drawn


def test_backends_that_do_not_agree_are_exit_code_1(monkeypatch, capsys):
    def differ(*settings):
        raise WorkDiffers("got ours and theirs 1.0e-03 apart")

    monkeypatch.setattr(decisions, "measure", differ)
    assert decisions.main(["--quick"]) == 1
    printed, err = capsys.readouterr()
    assert printed == "" and err.endswith("got ours and theirs 1.0e-03 apart\n")


def keys_of(value: Any, prefix: str = "") -> set[str]:
    if not isinstance(value, dict):
        return {prefix}
    return {key for name, part in value.items() for key in keys_of(part, f"{prefix}/{name}")}


def test_the_recorded_run_was_a_full_one_of_this_script(quick):
    recorded = json.loads((FOLDER / "results" / "decisions.json").read_text(encoding="utf-8"))
    report = quick[0]
    assert {k: recorded["settings"][k] for k in decisions.FULL} == decisions.FULL and not recorded["settings"]["quick"]
    assert recorded["left_out"] == {"network": {}, "end_to_end": {}, "starts": {}}
    assert recorded["work"] == report["work"]
    # either way of calling onnxruntime may have been the faster
    missing = {
        key for key in keys_of(report) - keys_of(recorded) if "/left_out" not in key and "onnxruntime_" not in key
    }
    assert not missing and any("ours_cold" in key for key in keys_of(recorded) - keys_of(report))


LOOK = """
import os
folder = os.environ["NUMBA_CACHE_DIR"]
seconds["found"] = len(os.listdir(folder))
open(os.path.join(folder, str(len(os.listdir(folder)))), "w").close()
step("decision")
"""


def test_a_cold_start_finds_an_empty_cache_and_a_warm_one_a_full_one(monkeypatch):
    monkeypatch.setattr(backends, "is_installed", lambda *names: False)
    monkeypatch.setattr(starts, "_OURS", LOOK)
    found = starts.bench_starts(DIGITS, rounds=3)
    assert found["ours_cold"]["found"]["max"] == 0 and found["ours_cold"]["process"]["n"] == 3
    assert (found["ours_warm"]["found"]["min"], found["ours_warm"]["found"]["max"]) == (1, 3)
    assert starts.left_out() == {
        "onnxruntime": "onnx and onnxruntime are not installed",
        "torch": "torch and tnt_reference are not installed",
    }
    monkeypatch.setattr(starts, "_OURS", "raise OSError('the disk is full')")
    with pytest.raises(RuntimeError, match=r"the start of ours_warm failed:(?s:.)*the disk is full"):
        starts.bench_starts(DIGITS, rounds=1, cold=False)


# -- what new events touch -------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(14, 18), (15, 17), (8, 9)])
def test_reached_cells_are_those_whose_taps_see_the_changed_one(shape):
    rows, columns = shape[0] // 2, shape[1] // 2
    for y, x in np.ndindex(shape):
        changed = np.zeros(shape, bool)
        changed[y, x] = True
        expected = np.zeros((rows, columns), bool)
        for row, column in np.ndindex(rows, columns):
            expected[row, column] = -1 <= y - 2 * row <= 2 and -1 <= x - 2 * column <= 2
        assert np.array_equal(touched._reached(changed, (rows, columns)), expected), (y, x)


@pytest.mark.parametrize(
    "transform, x, changed, reached",
    [
        ("none", 9, 2, (8, 2 * 2, 3 * 3)),  # whole pixels: two time bins; rows 2 and 3, columns 4 and 5
        ("tnt", 17, 0, (8, 0, 0)),  # early: (17 - 8.5) / .8 lies off the grid
    ],
)
def test_one_event_by_hand(transform, x, changed, reached):
    config = TNTConfig(sensor=(18, 14), grid=(18, 14), bins=4, window_us=1000, landmark="center", transform=transform)
    events = events_of([100, 450 if x == 9 else 101], [9, x], [6, 6 if x == 9 else 13], [1, 1])
    (count,) = touched._count(random_model(config, widths=(4, 6, 8)), [Moment(0, events, 1, False)])
    assert count["changed"]["input"] == changed
    assert tuple(count["reached"][layer] for layer in ("input", "pooled_1", "pooled_2")) == reached
    assert count["reached"]["partial"] == count["changed"]["pooled_2"] <= 9


def test_more_new_events_touch_more_and_the_whole_network_by_hand():
    windows = [w for events in bench_recordings(DIGITS.config)[:3] for w in windows_of(events, DIGITS.config.window_us)]
    found = touched.bench_touched(DIGITS, windows, moments=40)
    multiplications = [found[n]["multiplications"] for n in ("1", "10", "100", "1300", "whole")]
    assert multiplications == sorted(multiplications) and multiplications[0] < multiplications[-1] / 5
    for n in ("1", "10", "100", "1300"):
        assert 0 < found[n]["changed"]["pooled_1"] <= found[n]["reached"]["pooled_1"]
    assert multiplications[-1] == 4 * 289 * 9 * 9 * 16 + 4 * 64 * 9 * 16 * 32 + 64 * 32 * 64 + 64 * 10
    assert found["whole"]["weight_bytes"] == 4 * (9 * 9 * 16 + 9 * 16 * 32 + 64 * 32 * 64 + 64 * 10)
