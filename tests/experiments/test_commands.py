"""The commands of experiments/ run, report every row, and refuse to compare different work."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from made import random_events, random_model
from small_sets import write_small_mnist

import experiments
from async_tnt import TNTConfig, load_model
from async_tnt.simulation.digits import simulate_digit
from async_tnt.sources.files.nmnist import write_nmnist
from experiments import decisions, edges, memory, peers, script_options, starts, volumes
from experiments import measure_touched as touched
from experiments.bench_moments import bench_recordings, windows_of
from experiments.mnist import load_mnist
from experiments.page_parts import RESULTS

DIGITS = load_model("digits")


# -- all ------------------------------------------------------------------------------------------------

COMMANDS = [path for path in Path(experiments.__file__).parent.glob("*.py") if "exit_with(main)" in path.read_text()]


@pytest.mark.parametrize("name", [path.stem for path in COMMANDS])
def test_every_command_has_help_and_stands_in_the_list(name, capsys):
    pytest.importorskip("torch", reason="torch is not installed")
    with pytest.raises(SystemExit, match="0"):
        importlib.import_module(f"experiments.{name}").main(["--help"])
    assert capsys.readouterr().out.startswith(f"usage: python -m experiments.{name} ")
    assert f"`python -m experiments.{name}" in (Path(experiments.__file__).parent / "README.md").read_text()


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (ValueError("got 3\nevents"), 2, "got 3\\nevents"),
        (FileNotFoundError("no folder x"), 2, "no folder x"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (
            KeyboardInterrupt("interrupted; networks are kept"),
            130,
            "interrupted; networks are kept",
        ),
    ],
)
def test_a_command_ends_with_one_line_and_the_programs_exit_codes(error, code, line, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["/checkout/experiments/early.py"])
    with pytest.raises(SystemExit, match=f"^{code}$"):
        script_options.exit_with(Mock(side_effect=error))
    assert capsys.readouterr() == ("", f"early: {line}\n")


# -- memory.py, peers.py ---------------------------------------------------------------------------------


def test_memory_is_compared_with_a_limit(capsys):
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
    assert peers.main(["--quick", "--json", str(tmp_path / "peers.json")]) == 0
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
    right = peers.dsec_volume
    monkeypatch.setattr(peers, "dsec_volume", lambda *columns: right(*columns) * 1.01)
    with pytest.raises(RuntimeError, match=r"must make the same volume as ours .*'dsec_torch': 0\.01"):
        peers.compare((34, 34), 1300, 1, rounds=1)


def test_volumes_are_timed_in_every_way(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(volumes, "GRIDS", ((34, 34), (64, 48)))
    monkeypatch.setattr(volumes, "ROUNDS", (31, 2))
    assert volumes.main(["--quick", "--json", str(tmp_path / "v.json")]) == 0
    report = json.loads((tmp_path / "v.json").read_text(encoding="utf-8"))
    ways = {"single"} | {f"packet_{n}_{form}" for n in (10, 100, 1300) for form in ("structured", "columns")}
    assert [v["grid"] for v in report["volume"]] == [[34, 34], [64, 48]]
    for volume in report["volume"]:
        assert set(volume["ns_per_event"]) == ways
        for figure in volume["ns_per_event"].values():
            ordered = [figure[name] for name in ("min", "q1", "median", "q3", "max")]
            assert ordered[0] > 0 and ordered == sorted(ordered)
    assert "packets of 1300, columns" in capsys.readouterr().out


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
    for part in ("network", "end_to_end"):
        rows = report[part]["1"]["in_blocks"]["us"]
        assert set(rows) | set(report["left_out"][part]) == set(report["work"][part])
        assert not set(rows) & set(report["left_out"][part])
        assert not [work for name, work in report["work"][part].items() if name in rows and work not in text]


def test_starts_are_timed_or_left_out_with_a_reason(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(starts, "missing", lambda *packages: f"{packages[0]} is not installed")  # ours alone: fast
    assert starts.main(["--quick", "--json", str(tmp_path / "s.json")]) == 0
    report, text = json.loads((tmp_path / "s.json").read_text(encoding="utf-8")), capsys.readouterr().out
    assert set(report["starts"]) | set(report["left_out"]) == set(starts.WORK) and "ours_warm" in report["starts"]
    assert "left out: compiling takes too long for a quick look" in text
    recorded = json.loads((RESULTS / "starts.json").read_text(encoding="utf-8"))
    assert recorded["left_out"] == {} and recorded["rounds"] == starts.ROUNDS and recorded["work"] == starts.WORK


def test_the_picture_is_drawn_from_the_figures_alone(quick, tmp_path, capsys):
    report, _, picture = quick
    (tmp_path / "d.json").write_text(json.dumps(report), encoding="utf-8")
    words = ["--from", str(tmp_path / "d.json"), "--picture", str(tmp_path / "again.png")]
    assert decisions.main(words) == 0
    assert (tmp_path / "again.png").read_bytes() == picture.read_bytes()


def test_the_recorded_run_was_a_full_one_of_this_script(quick):
    recorded = json.loads((RESULTS / "decisions.json").read_text(encoding="utf-8"))
    assert {k: recorded["settings"][k] for k in decisions.FULL} == decisions.FULL and not recorded["settings"]["quick"]
    assert recorded["left_out"] == {"network": {}, "end_to_end": {}}
    assert recorded["work"] == quick[0]["work"]


# -- what new events touch -------------------------------------------------------------------------------


def test_more_new_events_touch_more_and_the_whole_network_by_hand():
    windows = [w for events in bench_recordings(DIGITS.config)[:3] for w in windows_of(events, DIGITS.config.window_us)]
    found = touched.bench_touched(DIGITS, windows, moments=40)
    multiplications = [found[n]["multiplications"] for n in ("1", "10", "100", "1300", "whole")]
    assert multiplications == sorted(multiplications) and multiplications[0] < multiplications[-1] / 5
    for n in ("1", "10", "100", "1300"):
        assert 0 < found[n]["cells"] < found["whole"]["cells"] and 0 < found[n]["conv1"] < found["whole"]["conv1"]
    assert multiplications[-1] == 4 * 289 * 9 * 9 * 16 + 4 * 64 * 9 * 16 * 32 + 64 * 32 * 64 + 64 * 10


# -- edges.py --------------------------------------------------------------------------------------------


def test_events_fall_with_the_angle_between_edge_and_motion(tmp_path):
    """On simulated recordings in N-MNIST's layout: numbered from 1, as the images that they show."""
    mnist = write_small_mnist(tmp_path, 20)
    images, labels = load_mnist(mnist, "train")
    for i, (image, label) in enumerate(zip(images, labels, strict=True)):
        path = tmp_path / "nmnist" / "Train" / str(label) / f"{i + 1:05}.bin"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_nmnist(path, simulate_digit(image, np.random.default_rng(i)))
    report = edges.measure(tmp_path / "nmnist", mnist, 20)
    events, right = report["events_per_gradient"], report["polarity_as_expected"]
    assert report["recordings"] == 20 and min(right[:4]) > 0.9 > right[-1]
    assert events[0] > events[3] > 2 * events[5]
    assert events[3] / events[0] == pytest.approx(report["cosine"][3] / report["cosine"][0], abs=0.15)
    for found in report["between_saccades"].values():
        assert 100 < found["angle_deg"] < 130
        assert found["signed"] == pytest.approx(found["expected"], abs=0.2) and found["unsigned"] > 0.3


# -- incremental.py --------------------------------------------------------------------------------------


def test_networks_are_compared_and_drawn(tmp_path, capsys, monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed")
    from experiments import incremental

    two = {name: incremental.NETWORKS[name] for name in ("thesis", "conv4")}
    monkeypatch.setattr(incremental, "NETWORKS", two)
    words = ["--quick", "--json", str(tmp_path / "i.json"), "--picture", str(tmp_path / "i.png")]
    assert incremental.main(words) == 0
    report, text = json.loads((tmp_path / "i.json").read_text(encoding="utf-8")), capsys.readouterr().out
    assert list(report["networks"]) == list(two) and all(name in text for name in two)
    for row in report["networks"].values():
        counts = [row["touched"][n]["multiplications"] for n in ("1", "10", "100", "1300", "whole")]
        assert counts == sorted(counts) and counts[0] < counts[-1] / 5
        assert {"incremental", "dense", "torch"} <= row["network"]["1"]["in_blocks"]["us"].keys()
    assert report["networks"]["conv4"]["touched"]["whole"]["multiplications"] == pytest.approx(12.3e6, rel=0.02)
    assert (tmp_path / "i.png").stat().st_size > 10_000


# -- datasets.py -----------------------------------------------------------------------------------------


def test_recipes_are_trained_and_tested_and_others_keep_their_entry(tmp_path, capsys):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    from experiments import datasets

    file = tmp_path / "made.json"
    assert datasets.main(["--quick", "--json", str(file), "--picture", str(tmp_path / "made.png")]) == 0
    report = json.loads(file.read_text(encoding="utf-8"))
    found = report["recipes"]
    recorded = json.loads((RESULTS / "cars.json").read_text(encoding="utf-8"))
    merged = datasets.with_earlier(report, recorded, list(datasets.DATA_SETS["cars"].recipes))["recipes"]
    assert list(merged)[:2] == ["tuned", "bare"]
    assert (merged["tuned"], merged["bare"]) == (recorded["recipes"]["tuned"], found["bare"])
    assert found["bare"]["command"].endswith("--epochs 1")
    (test,) = found["bare"]["tests"]
    assert test["recordings"] == 18 and list(test["against_time_ms"])[::3] == ["5", "20", "35", "50"]
    assert (
        found["bare"]["equal_to_dense"] > 100
        and found["bare"]["every_event"]["a_second"] > 0
        and found["bare"]["networks"][0]["network"] == "residual"
    )
    printed = capsys.readouterr().out
    assert (
        f"{test['against_time_ms']['50']:.3f}".replace("0.", ".") in printed
        and (tmp_path / "made.png").exists()
        and "decisions a second" in printed
    )
    with pytest.raises(SystemExit):
        datasets.main([])
    with pytest.raises(SystemExit):
        datasets.main(["poker", str(tmp_path), "--recipes", "tuned"])
    assert "poker has the recipes bare, got 'tuned'" in capsys.readouterr().err


def test_each_recipe_is_written_at_once_beside_what_others_wrote(tmp_path, monkeypatch):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    from experiments import datasets

    file, entry = tmp_path / "cars.json", {"tests": [], "every_event": {"a_second": 1.0}}

    def measured(data, folder, out, recipe, seeds):
        if recipe == "bare":  # meanwhile another run has written its own
            report = json.loads(file.read_text())
            report["recipes"]["equal_mean_time"] = entry
            file.write_text(json.dumps(report))
        return {"title": data.title, "shown_ms": data.shown_ms, "others": {}, "recipes": {recipe: entry}}

    monkeypatch.setattr(datasets, "measure", measured)
    assert datasets.main(["cars", str(tmp_path), "--recipes", "equal_count", "bare", "--json", str(file)]) == 0
    assert list(json.loads(file.read_text())["recipes"]) == ["bare", "equal_count", "equal_mean_time"]


def test_decisions_that_differ_from_the_dense_network_end_the_measurement(monkeypatch):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    from experiments import datasets

    model = random_model(TNTConfig(grid=(8, 8), sensor=(8, 8)), classes=2)
    recordings = [random_events(30, seed=k, duration_us=9_000, sensor=(8, 8)) for k in range(2)]
    assert datasets._compare_with_dense(model, recordings) == 60
    other = np.array([1, 2], np.float32)
    monkeypatch.setattr(datasets, "CompiledClassifier", lambda model: lambda volume: other)
    with pytest.raises(datasets.WorkDiffers, match="event 1 of a window"):
        datasets._compare_with_dense(model, recordings)
