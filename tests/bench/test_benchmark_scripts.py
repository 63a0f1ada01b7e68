"""The scripts under benchmarks/ run, and say what they should."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bench.scripts import load_benchmark

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="benchmarks/ is not part of an installed package")


def run_memory(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(FOLDER / "memory.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_two_million_events_need_no_more_memory():
    done = run_memory("--events", "2000000", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["events"] >= 2_000_000
    assert result["decisions"] >= 6 * (result["events"] // 16_900)  # 4 to 5 triggers, the end, and on demand
    assert result["grown_mb"] == pytest.approx(result["end_mb"] - result["first_million_mb"], abs=0.02)


def test_growth_beyond_the_limit_is_exit_code_1():
    done = run_memory("--events", "1100000", "--limit-mb", "-1000")
    assert done.returncode == 1, done.stderr
    assert "after the first million" in done.stdout


def test_too_few_events_are_bad_usage():
    done = run_memory("--events", "1000000")
    assert done.returncode == 2
    assert "--events must be more than the first 1,000,000, got 1,000,000" in done.stderr


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
def test_resident_memory_sees_what_is_allocated():
    resident_mb = load_benchmark("memory").resident_mb
    before = resident_mb()
    block = np.ones(64 << 20, np.uint8)  # more than malloc ever takes from memory it has
    assert 50 < resident_mb() - before < 80
    del block


@pytest.fixture(scope="module")
def peers_report(tmp_path_factory):
    path = tmp_path_factory.mktemp("peers") / "peers.json"
    assert load_benchmark("peers").main(["--quick", "--json", str(path)]) == 0
    return json.loads(path.read_text(encoding="utf-8"))


def test_every_peer_is_timed_or_left_out_with_a_reason(peers_report):
    (result,) = peers_report["results"]
    rows, left_out = set(result["rows"]), set(peers_report["left_out"])
    assert rows | left_out == set(peers_report["work"]) and not rows & left_out
    assert {"ours_update", "ours_update_read", "ours_fresh", "ours_fresh_raw"} <= rows
    for name, row in result["rows"].items():
        assert row["mev_per_s"] == pytest.approx(1e3 / row["ns_per_event"]["median"]), name


@pytest.mark.parametrize(
    "package, row",
    [("torch", "dsec_torch"), ("torch", "torch_scatter"), ("eventcv", "eventcv_numpy"), ("tonic", "tonic")],
)
def test_a_peer_that_is_installed_is_compared(peers_report, package, row):
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    (result,) = peers_report["results"]
    assert result["rows"][row]["times_ours_update_read"] > 0
    if row != "tonic":  # tonic's bins are others; see check_work
        assert result["largest_difference"][row] < 1e-4


def test_unequal_volumes_stop_the_comparison(monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed")
    peers = load_benchmark("peers")
    right = peers.dsec_volume
    monkeypatch.setattr(peers, "dsec_volume", lambda *columns: right(*columns) * 1.01)
    with pytest.raises(RuntimeError, match=r"must make the same volume as ours .*'dsec_torch': 0\.01"):
        peers.compare((34, 34), 1300, 1, rounds=1)


def test_recorded_results_name_the_processor_and_no_path():
    found = sorted((FOLDER / "results").glob("*.json"))
    assert found
    for path in found:
        text = path.read_text(encoding="utf-8")
        assert json.loads(text)["machine"]["cpu"], path
        assert "/home/" not in text and "/tmp/" not in text and "/root/" not in text, path
