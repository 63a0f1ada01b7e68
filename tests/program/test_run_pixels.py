"""async-tnt run --roi, --crop and --mask: events left out by their pixels, before anything else."""

import json

import numpy as np
import pytest

from async_tnt import Processor, load_model
from async_tnt.cli import main
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import save_mask

SAMPLE = sample_recordings()[7]
EVENTS = open_recording(SAMPLE).read()


def decisions_of(events):
    processor = Processor(load_model("digits"))
    return [(d.time_us, d.label, d.events) for d in processor.push(events) + processor.finish()]


def printed(capsys, *options):
    assert main(["run", "--json", *options]) == 0
    out, err = capsys.readouterr()
    return [(d["time_us"], d["label"], d["events"]) for d in map(json.loads, out.splitlines())], err


def moved(events, left, top):
    """The same events on a sensor of 100x80 pixels, with others around them."""
    events = events.copy()
    events["x"] += left
    events["y"] += top
    around = events[::3].copy()
    around["x"] = np.where(np.arange(len(around)) % 2, 99, 0)
    return np.sort(np.concatenate((events, around)), order="t", kind="stable"), len(around)


def test_a_region_of_a_larger_sensor_gives_what_the_small_one_does(capsys, tmp_path):
    events, n_around = moved(EVENTS, 40, 20)
    np.savez(tmp_path / "large.npz", **{name: events[name] for name in "txyp"}, sensor=(100, 80))
    options = ["--roi", "40,20,34,34", "--crop"]
    if open_recording(tmp_path / "large.npz").sensor is None:
        options += ["--sensor", "100x80"]
    got, err = printed(capsys, str(tmp_path / "large.npz"), *options)
    assert got == decisions_of(EVENTS)
    assert err == f"async-tnt: left out: {n_around:,} outside of the region\n"


def test_a_mask_leaves_out_its_pixels(capsys, tmp_path):
    mask = np.zeros((34, 34), bool)
    mask[10:20, 12] = True
    save_mask(tmp_path / "mask.npy", mask)
    kept = PixelFilter((34, 34), mask=mask)(EVENTS)
    assert 0 < len(kept) < len(EVENTS)
    got, err = printed(capsys, str(SAMPLE), "--mask", str(tmp_path / "mask.npy"))
    assert got == decisions_of(kept) != decisions_of(EVENTS)
    assert f"{len(EVENTS) - len(kept):,} of masked pixels" in err


def test_a_region_without_crop_keeps_the_coordinates(capsys):
    kept = PixelFilter((34, 34), roi=(0, 0, 20, 34))(EVENTS)
    assert printed(capsys, str(SAMPLE), "--roi", "0,0,20,34")[0] == decisions_of(kept)


@pytest.mark.parametrize(
    "options, message",
    [
        (["--crop"], "--crop belongs to --roi"),
        (
            ["--sensor", "36x34"],
            "--sensor says 36x34 pixels, but the model is for 34x34: give --roi X,Y,34,34 --crop too",
        ),
        (
            ["--roi", "0,0,20,20", "--crop"],
            "is for 34x34 pixels, got a region of 20x20; give --roi X,Y,34,34",
        ),
        (["--roi", "20,0,20,34"], "must lie on the sensor of 34x34 pixels"),
        (["--roi", "1,1,34,34", "--crop"], "must lie on the sensor of 34x34 pixels"),
        (["--roi", "0,0,34,34", "--crop", "--sensor", "40x30"], "must lie on the sensor of 40x30 pixels"),
        (["--mask", "no_such.npy"], "no_such.npy"),
    ],
)
def test_wrong_options_are_told_in_one_line(capsys, options, message):
    assert main(["run", str(SAMPLE), *options]) == 2
    err = capsys.readouterr().err
    assert message in err and "Traceback" not in err


def test_a_sensor_that_nobody_knows(capsys, tmp_path):
    np.savez(tmp_path / "large.npz", **{name: EVENTS[name] for name in "txyp"})
    assert main(["run", str(tmp_path / "large.npz"), "--roi", "0,0,34,34", "--crop"]) == 2
    assert "does not say the camera's pixels, which --crop needs: give --sensor WxH" in capsys.readouterr().err


@pytest.mark.parametrize("roi", ["1,2,3", "a,b,c,d", "1x2x3x4"])
def test_wrong_regions(capsys, roi):
    with pytest.raises(SystemExit) as stop:
        main(["run", "--roi", roi])
    assert stop.value.code == 2
    assert "must be four whole numbers X,Y,WIDTH,HEIGHT" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--sensor", "--mask"])
def test_an_event_off_the_camera_names_the_source_of_its_size(option, capsys, tmp_path):
    (tmp_path / "a.csv").write_text("t,x,y,p\n0,99,5,1\n")
    save_mask(tmp_path / "hot.npy", np.zeros((60, 60), bool))
    words = {"--sensor": "--sensor says 60x60", "--mask": f"{tmp_path / 'hot.npy'} is a mask of 60x60"}[option]
    value = {"--sensor": "60x60", "--mask": str(tmp_path / "hot.npy")}[option]
    assert main(["run", str(tmp_path / "a.csv"), "--roi", "0,0,34,34", "--crop", option, value]) == 2
    err = capsys.readouterr().err
    assert f"{tmp_path / 'a.csv'}: `x` must be in [0, 60), got 99 at event 0; {words} pixels\n" in err
