"""Starts in fresh processes: which cache they see, and that a start which fails is not a time."""

from __future__ import annotations

import pytest
from bench.scripts import load_benchmark

from async_tnt import load_model
from async_tnt.checking import backends

starts = load_benchmark("measure_starts")

LOOK = """
import os
folder = os.environ["NUMBA_CACHE_DIR"]
seconds["found"] = len(os.listdir(folder))
open(os.path.join(folder, str(len(os.listdir(folder)))), "w").close()
step("decision")
"""


@pytest.fixture
def only_ours(monkeypatch):
    monkeypatch.setattr(backends, "is_installed", lambda *names: False)


def test_a_cold_start_finds_an_empty_cache_and_a_warm_one_a_full_one(monkeypatch, only_ours):
    monkeypatch.setattr(starts, "_OURS", LOOK)
    rounds = []
    found = starts.bench_starts(load_model("digits"), rounds=3, each=lambda: rounds.append(None))
    assert set(found) == {"ours_cold", "ours_warm"} and len(rounds) == 4
    assert found["ours_cold"]["found"]["max"] == 0
    assert (found["ours_warm"]["found"]["min"], found["ours_warm"]["found"]["max"]) == (1, 3)
    assert found["ours_cold"]["process"]["n"] == 3


def test_a_quick_look_compiles_nothing_and_says_so(only_ours):
    found = starts.bench_starts(load_model("digits"), rounds=1, cold=False)
    assert set(found) == {"ours_warm"}
    warm = found["ours_warm"]
    assert set(warm) == {"import", "load", "warmup", "decision", "first_decision", "process"}
    assert warm["first_decision"]["median"] == pytest.approx(
        sum(warm[step]["median"] for step in ("import", "load", "warmup", "decision"))
    )
    assert warm["process"]["median"] > warm["first_decision"]["median"]
    assert starts.left_out(cold=False) == {
        "ours_cold": "compiling takes too long for a quick look",
        "onnxruntime": "onnx and onnxruntime are not installed",
        "torch": "torch and tnt_reference are not installed",
    }


def test_a_start_that_fails_is_an_error_with_its_words(monkeypatch, only_ours):
    monkeypatch.setattr(starts, "_OURS", "raise OSError('the disk is full')")
    with pytest.raises(RuntimeError, match=r"the start of ours_warm failed:(?s:.)*the disk is full"):
        starts.bench_starts(load_model("digits"), rounds=1, cold=False)
