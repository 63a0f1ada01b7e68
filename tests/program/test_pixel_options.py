"""--roi, --crop, --mask and --sensor of run, evaluate and view.

Events are left out before anything else happens to them.
"""

import json

import numpy as np
import pytest
from training.gestures import write

from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixels.pixel_filter import PixelFilter
from async_tnt.sources.pixels.pixel_masks import save_mask
from async_tnt.sources.pixels.pixels import Pixels

HOT = [(3, 4), (30, 29), (4, 30)]
"""Pixels (x, y) that fire without a cause."""
SIZE = (34, 34)
"""(width, height) of the samples, and of the model."""
CAMERA = (100, 80)
"""(width, height) of a larger camera."""
CORNER = (40, 20)
"""The pixel (x, y) of the larger camera where a sample's upper left one is."""
REGION = ("--roi", "40,20,34,34", "--crop")
SAMPLE = sample_recordings()[3]
EVENTS = open_recording(SAMPLE).read()


def hot_mask(size, corner=(0, 0)):
    mask = np.zeros(size[::-1], bool)
    for x, y in HOT:
        mask[corner[1] + y, corner[0] + x] = True
    return mask


def with_hot_pixels(events, corner=(0, 0)):
    """These events, and three pixels that fire 3,000 times each.

    The first event stays the first.
    """
    extra = np.zeros(9000, events.dtype)
    extra["t"] = np.linspace(events["t"][0] + 1, events["t"][-1], len(extra)).astype(np.int64)
    extra["x"], extra["y"] = (np.array(HOT)[np.arange(len(extra)) % 3] + corner).T
    both = np.concatenate((events, extra))
    return both[np.argsort(both["t"], kind="stable")]


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """A folder of data sets, `clean`, `hot`, and `large`, of a larger camera; and of masks."""
    folder = tmp_path_factory.mktemp("sets")
    for digit, path in sample_recordings().items():
        name = f"{digit}/a.npz"
        events = open_recording(path).read()
        write(folder / "clean" / name, PixelFilter(SIZE, mask=hot_mask(SIZE))(events), sensor=SIZE)
        write(folder / "hot" / name, with_hot_pixels(events), sensor=SIZE)
        events["x"] += CORNER[0]
        events["y"] += CORNER[1]
        write(folder / "large" / name, with_hot_pixels(events, CORNER), sensor=CAMERA)
    save_mask(folder / "hot.npy", hot_mask(SIZE))
    save_mask(folder / "large.npy", hot_mask(CAMERA, CORNER))
    return folder


def words_for(command, folder, model, tmp_path):
    """The words of a command on all recordings of a set."""
    if command == "view":
        pytest.importorskip("rerun", reason="the view needs Rerun (extra `view`)")
    files = sorted(folder.glob("*/*"))
    return {
        "run": ("run", *files, "--model", model, "--json"),
        "evaluate": ("evaluate", model, folder, "--json"),
        "view": ("view", *files, "--model", model, "--out", tmp_path / "a.rrd"),
    }[command]


def result_of(command, folder, tmp_path, program, *options):
    """What a command decides, without what differs from file to file."""
    code, printed, message = program(*words_for(command, folder, "digits", tmp_path), *options)
    assert code == 0 and (command == "run" or message == "")
    if command == "evaluate":
        return {name: value for name, value in json.loads(printed).items() if name != "pixels"}
    decisions = [json.loads(line) for line in printed.splitlines()]
    for decision in decisions:
        del decision["recording"]
    return decisions


@pytest.mark.parametrize("command", ["run", "evaluate"])
@pytest.mark.parametrize(("name", "region"), [("hot", ()), ("large", REGION)])
def test_what_is_left_out_is_as_if_it_had_never_been_recorded(
    command, name, region, sets, tmp_path, program
):
    clean = result_of(command, sets / "clean", tmp_path, program)
    found = result_of(
        command, sets / name, tmp_path, program, *region, "--mask", sets / f"{name}.npy"
    )
    assert found == clean
    disturbed = result_of(command, sets / name, tmp_path, program, *region)
    assert disturbed != clean
    if command == "evaluate":
        assert disturbed["accuracy"] < clean["accuracy"]


def test_counts_and_report_say_what_was_left_out(sets, program):
    mask = ("--mask", sets / "large.npy")
    _, _, message = program("run", sets / "large" / "3" / "a.npz", *REGION, *mask)
    n = 9000 + hot_mask(SIZE)[EVENTS["y"], EVENTS["x"]].sum()
    assert message == f"async-tnt: left out: 0 outside of the region, {n:,} of masked pixels\n"
    words = "evaluate", "digits", sets / "large", "--json", *REGION, "--mask", sets / "large.npy"
    mask = Pixels(mask=hot_mask(CAMERA, CORNER)).about["mask"]
    assert mask.startswith("100x80 ")
    assert json.loads(program(*words)[1])["pixels"] == {
        "roi": "40,20,34,34",
        "crop": True,
        "mask": mask,
    }


@pytest.mark.parametrize("command", ["run", "evaluate", "view"])
def test_a_recording_of_which_nothing_is_left_says_why(command, tmp_path, program):
    events = np.array([(1, 3, 3, 1), (2, 30, 30, 1), (3, 4, 3, 1)], EVENTS.dtype)
    path = write(tmp_path / "set" / "0" / "a.npz", events, sensor=SIZE)
    save_mask(tmp_path / "mask.npy", np.fromfunction(lambda y, x: y == 3, (34, 34)))
    words = words_for(command, tmp_path / "set", "digits", tmp_path)
    code, _, message = program(*words, "--roi", "0,0,20,20", "--mask", tmp_path / "mask.npy")
    name = "0/a.npz" if command == "evaluate" else path
    assert code == 2 and f"{name}: no events at the selected pixels" in message


def test_a_map_model_reads_a_camera_of_any_size_that_is_known(sets, tmp_path, program):
    large = sets / "large" / "3" / "a.npz"
    words = "run", "--model", "digits-everywhere", "--json"
    code, _, message = program(*words, sets / "hot" / "3" / "a.npz", large)
    assert code == 2
    assert (
        "a sensor of 100x80 pixels, but the model is for 34x34; give --sensor 100x80\n" in message
    )
    hot = sets / "hot" / "3" / "a.npz"
    code, printed, message = program(*words, tmp_path / "gone.npy", hot)
    first, second = message.splitlines()  # each is told, though the first gives no size
    assert (code, printed) == (2, "") and "gone.npy: No such file" in first
    assert second.endswith("; give --sensor 34x34")
    mask = ("--mask", sets / "large.npy")
    assert program(*words, large, *REGION, *mask)[0] == 0  # the region counts more than the mask
    np.save(tmp_path / "a.npy", open_recording(large).read())
    assert program(*words, tmp_path / "a.npy", "--mask", sets / "large.npy")[0] == 0
