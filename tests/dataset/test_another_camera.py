"""Two classes of another camera, in files of mixed formats, through the program: trained, evaluated, killed."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from dataset.gestures import bar
from recordings.written import FORMATS as WRITERS

from async_tnt.events import EVENT_DTYPE
from async_tnt.networks.model import load_model

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

FORMATS = ("plain.csv", "uzh.txt", "evt2.raw", "evt21.raw", "evt3.raw", "v2.dat", "dvs.es")  # two without a sensor
DURATIONS_US = (100_000, 40_000, 230_000)  # one window is 105 ms


def of_camera(kind, seed, sensor, duration_us):
    """A bar in the middle of the sensor, and an event in ten anywhere."""
    side = min(sensor)
    rng = np.random.default_rng(seed)
    events = np.zeros(1_500, EVENT_DTYPE)
    drawn = bar(kind, seed, side=side, duration_us=duration_us, start_us=1_000_000 * (seed % 7))
    for name in "txyp":
        events[name] = drawn[name]
    events["x"] += (sensor[0] - side) // 2
    noisy = rng.random(len(events)) < 0.1
    noisy[0] = False  # the recording's first event
    events["x"][noisy] = rng.integers(0, sensor[0], noisy.sum())
    events["y"][noisy] = rng.integers(0, sensor[1], noisy.sum())
    return events


def write_camera(folder, counts, sensor, formats=FORMATS, seed=0):
    for name, n in counts.items():
        (folder / name).mkdir(parents=True)
        for k in range(n):
            kind = formats[k % len(formats)]
            events = of_camera(name, 1000 * seed + k, sensor, DURATIONS_US[k % 3])
            data = WRITERS[kind].of_bytes(events, sensor)
            if kind == "uzh.txt":
                data = data.split(b"\n", 1)[1]  # without the line that states the sensor
            (folder / name / f"{k:02d}_{kind}").write_bytes(data)
    return folder


@pytest.mark.parametrize("sensor", [(304, 240), (128, 128)])
def test_formats_are_mixed_and_one_class_is_rare(tmp_path, program, sensor):
    folder = write_camera(tmp_path / "set", {"upright": 30, "flat": 10}, sensor)
    held_out = write_camera(tmp_path / "held_out", {"upright": 7, "flat": 7}, sensor, seed=1)
    (folder / "flat" / "torn.raw").write_bytes(b"no recording")
    (folder / "flat" / "empty.csv").touch()
    out = tmp_path / "m.safetensors"
    words = ("--out", out, "--run", tmp_path / "run", "--epochs", "12", "--batch", "8", "--patience", "0")
    code, _, err = program("train", folder, *words)
    assert code == 0, err
    assert err.splitlines()[-2:] == ["left out: flat/empty.csv: no events", err.splitlines()[-1]]
    assert "left out: flat/torn.raw: its first bytes are not those of a known format" in err.splitlines()[-1]
    model = load_model(out)
    assert model.config.sensor == sensor  # some files state it
    assert model.record["data"]["classes"] == {"flat": 10, "upright": 30}

    picture = tmp_path / "c.png"
    drawn = ("--picture", picture) if _has_matplotlib() else ()
    code, printed, err = program("evaluate", out, held_out, "--json", *drawn)
    report = json.loads(printed)
    assert code == 0 and report["recordings"] == 14 and report["skipped"] == []
    assert min(report["per_class"].values()) >= 6 / 7, report["confusion"]
    assert not drawn or picture.read_bytes().startswith(b"\x89PNG")


def _has_matplotlib():
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
def test_a_killed_training_resumes_to_the_same_model(tmp_path):
    """Killed twice, as soon as there is one more checkpoint on the disk."""
    write_camera(tmp_path / "set", {"upright": 4, "flat": 4}, (128, 128))
    words = [sys.executable, "-m", "async_tnt.cli", "train", "../set", "--out", "m.safetensors"]
    words += ["--epochs", "60", "--patience", "0"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}

    def start(name):
        (tmp_path / name).mkdir(exist_ok=True)
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen(words, cwd=tmp_path / name, env=env, **quiet)

    def state():
        return {path: path.stat().st_mtime_ns for path in (tmp_path / "cut").rglob("*.pt")}

    whole = start("whole")
    for _ in range(2):
        process = start("cut")
        before = state()
        while process.poll() is None and state() == before:
            time.sleep(0.005)
        process.kill()
        process.wait()
    assert start("cut").wait() == 0 and whole.wait() == 0
    for name in ("m.safetensors", "m.json"):
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "cut" / name).read_bytes(), name
