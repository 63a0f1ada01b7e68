"""`async-tnt bench`: what an event and a decision cost on this machine."""

from __future__ import annotations

import json

import pytest
from made import random_model

from async_tnt import TNTConfig, load_model

CONFIGS = {
    "another sensor": {"sensor": (40, 30), "grid": (20, 16)},
    "windows of events": {"window_events": 500},
    "images": {"representation": "count"},
    "replayed": {"landmark": "window"},
}


def check(report):
    figures = [
        report["ns_an_event"],
        *report["us_a_decision"].values(),
        report["decisions_a_second"],
    ]
    assert list(report["us_a_decision"]) == ["1", "100", "1300"]
    assert all(
        0 < figure["q1"] <= figure["median"] <= figure["q3"] and figure["n"] > 1
        for figure in figures
    )


def test_the_report_has_machine_model_and_every_figure(program):
    code, text, _ = program("bench", "--quick", "--json")
    report = json.loads(text)
    check(report)
    assert code == 0 and report["machine"]["cpu"] and report["machine"]["numba"]
    assert report["model"] == {
        "name": "digits",
        "config": load_model("digits").config.to_dict(),
        "classes": 10,
    }
    text = program("bench", "--quick")[1]
    assert (
        "model digits: 34 x 34 pixels, landmark running; bundled samples" in text
        and "1,300 new events " in text
    )


@pytest.mark.parametrize("settings", CONFIGS.values(), ids=CONFIGS)
def test_any_model_is_measured(settings, tmp_path, program):
    path = random_model(TNTConfig(**settings), widths=(4, 6, 8)).save(tmp_path / "own.safetensors")
    code, text, _ = program("bench", "--quick", "--json", "--model", str(path))
    report = json.loads(text)
    check(report)
    assert code == 0 and report["events_from"].endswith(
        "spread over the sensor" if "sensor" in settings else "samples"
    )
