"""Training on recordings with tables of boxes: what is read, the scenes, the command."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from made import events_of
from training.gestures import write_set as write_class_folders
from training.table_sets import (
    CLASSES,
    SENSOR,
    STEP_US,
    Row,
    recording,
    write_boxes,
    write_csv,
    write_sequence,
    write_set,
)

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt import TNTConfig, load_model
from async_tnt.evaluation.object_tables import find_tables
from async_tnt.kernels.training.window_batches import PATCH
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training import Split, VolumeChoice, dataset_data, fit, settings_for
from async_tnt.training import table_windows as module
from async_tnt.training.augment import Augmentation, unchanged
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.plan import Plan
from async_tnt.training.recordings import BOX_DTYPE, Recordings
from async_tnt.training.run_folder import windows_checksum
from async_tnt.training.scenes import Scales
from async_tnt.training.table_scenes import TableScenes, maker_of, more_than_noise
from async_tnt.training.table_windows import windows_before
from async_tnt.training.windows import Windows

CHOICE = VolumeChoice.of(window_us=STEP_US)
CONFIG = TNTConfig(
    sensor=(40, 32),
    grid=(40, 32),
    representation="count",
    polarity="split",
    transform="none",
    landmark="center",
    window_us=1000,
)


# -- what is read ----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_windows_have_the_events_before_their_ends_however_packets_are_cut(seed):
    rng = np.random.default_rng(seed)
    n = 400
    # two gaps, in one of which a window lies; and times that run back a little, as in some files
    t = np.sort(np.concatenate([rng.integers(0, 3000, n), rng.integers(9000, 9900, n)]))
    t = np.maximum(t + rng.integers(-20, 20, len(t)), 0)
    events = events_of(t, np.arange(len(t)) % 50, t % 40, t % 2)
    ends_us = [400, 1000, 1400, 3100, 5000, 9700, 12_000]
    cuts = np.sort(rng.integers(0, len(t), 30))
    packets = [packet for packet in np.split(events, cuts) if len(packet)]
    found = dict(windows_before(packets, ends_us, 1000))
    assert list(found) == list(range(len(ends_us)))
    for k, end_us in enumerate(ends_us):
        expected = events[(t >= end_us - 1000) & (t < end_us)].copy()
        expected["t"] -= end_us - 1000
        expected = expected[np.argsort(expected["t"], kind="stable")]
        assert (found[k] == expected).all(), k
    assert len(found[4]) == 0 and len(found[1]) > 20


def test_only_packets_of_windows_that_are_not_complete_are_held():
    held = []

    def packets():
        for k in range(200):
            alive.add(k)
            t = 1000 * k + np.arange(10)
            packet = events_of(t, t % 9, t % 9, t % 2).view(Watched)
            packet.number = k
            yield packet
            del packet
            held.append(len(alive))

    alive = set()

    class Watched(np.ndarray):
        number = None

        def __del__(self):
            alive.discard(self.number)

    found = dict(windows_before(packets(), [3000, 100_000, 150_000], 5000))
    assert [len(events) for events in found.values()] == [30, 50, 50]
    assert max(held) < 15


def test_a_packet_is_searched_a_few_times_however_many_are_held():
    """Not once for each of the packets that are held after it: a window may have thousands."""
    n_reads = 0

    class Counted(np.ndarray):
        def __getitem__(self, key):
            nonlocal n_reads
            n_reads += 1
            return super().__getitem__(key)

    t = np.arange(30_000)
    packets = np.split(events_of(t, t % 9, t % 9, t % 2).view(Counted), 300)
    found = dict(windows_before(packets, [12_000, 25_000], 10_000))
    assert [len(events) for events in found.values()] == [10_000, 10_000]
    assert n_reads < 6 * len(packets)


def test_all_tables_of_the_same_boxes_give_the_same_windows(tmp_path):
    pytest.importorskip("h5py", reason="needs the extra `files`")
    made = [recording((3, k)) for k in range(3)]
    for k, (events, rows) in enumerate(made):
        write_csv(tmp_path / "csv", f"r{k}", events, rows)
        write_boxes(tmp_path / "npy/Train", f"r{k}", events, rows)
        write_boxes(tmp_path / "numbered/train", f"r{k}", events, rows, names=False)
        # of DSEC's classes, car and train
        write_sequence(tmp_path / f"dsec/r{k}", events, rows)
    read = {}
    for name in ("csv", "npy", "numbered", "dsec"):
        pixels = Pixels(sensor=SENSOR)  # which the sequences do not state
        data = dataset_data(tmp_path / name, CHOICE, pixels=pixels, split=Split(validation=0))
        read[name] = data
    assert read["csv"].classes == read["npy"].classes == CLASSES
    assert read["numbered"].classes == ("0", "1") and read["dsec"].classes == ("car", "train")
    expected = read["csv"].training.recordings
    assert len(expected) > 20 and len(expected.boxes) > 30
    for data in read.values():
        found = data.training.recordings
        for column in ("t", "x", "y", "p", "offsets", "boxes", "labels"):
            assert (getattr(found, column) == getattr(expected, column)).all(), column
        assert data.config == read["csv"].config
    # the boxes of the first window are those of the first moment
    events, rows = made[0]
    first = [row for row in rows if row.t == 2 * STEP_US]
    boxes = expected.boxes[expected.boxes["recording"] == 0]
    np.testing.assert_allclose(boxes["size"], [(row.w, row.h) for row in first])
    np.testing.assert_allclose(
        boxes["middle"], [(row.x + row.w / 2, row.y + row.h / 2) for row in first]
    )
    assert boxes["label"].tolist() == [CLASSES.index(row.name) for row in first]
    n = int(((events["t"] >= STEP_US) & (events["t"] < 2 * STEP_US)).sum())
    assert expected.offsets[1] == n


def test_what_is_left_out_is_counted(tmp_path, monkeypatch):
    events, rows = recording(5)
    (_, name, x, y, w, h) = rows[0]
    others = [
        Row(rows[0].t, name, x, y, 0, 5),  # without area
        Row(rows[0].t, name, -9, 5, 8, 8),  # its middle is off the sensor
        Row(rows[0].t + 100, name, x, y, w, h),  # too near the one before
        Row(STEP_US * 90, name, x, y, w, h),  # after the last event
    ]
    write_csv(tmp_path / "a", "one", events, sorted([*rows, *others]))
    data = dataset_data(tmp_path / "a", CHOICE)
    assert data.record["boxes_left_out"] == {
        "without area": 1,
        "off the sensor": 1,
        "with too few events": 1,
    }
    assert data.record["moments_left_out"] == {
        "near others, or too many": 1,
        "without a box that is left": 1,
    }
    assert data.record["boxes"] + data.record["held_out_boxes"] <= len(rows)
    assert any(line.startswith("boxes left out: 1 without area, 1 off") for line in data.notes)
    # evenly spread, if there are more moments than are wanted
    monkeypatch.setattr(module, "MOST_MOMENTS", 3)
    few = dataset_data(tmp_path / "a", CHOICE, split=Split(validation=0))
    ends = [int(name.split(" at ")[1].split()[0]) for name in few.training.recordings.names]
    assert ends == [2 * STEP_US, 7 * STEP_US]  # the third one shows nothing
    assert few.record["moments_left_out"]["near others, or too many"] > 5


def test_a_recording_that_is_damaged_is_noted(tmp_path):
    write_set(tmp_path / "a", 3)
    events, rows = recording(9)
    # two blocks of events behind the first half, and then the damage
    first = events[events["t"] < 6 * STEP_US]
    t = 6 * STEP_US + np.arange(140_000) // 100
    more = events_of(t, t % 64, t % 48, t % 2)
    lines = [f"{t},{x},{y},{p}" for t, x, y, p in [*first.tolist(), *more.tolist()]]
    (tmp_path / "a/z.csv").write_text("t,x,y,p\n" + "\n".join(lines) + "\nnonsense\n")
    write_csv(tmp_path / "a", "z", events, rows)
    (tmp_path / "a/z.npz").unlink()
    (tmp_path / "a/y.npz").write_bytes(b"nothing")
    shutil.copy(tmp_path / "a/r00_objects.csv", tmp_path / "a/y_objects.csv")
    (tmp_path / "a/x.npz").symlink_to(tmp_path / "nowhere.npz")
    shutil.copy(tmp_path / "a/r00_objects.csv", tmp_path / "a/x_objects.csv")
    write_csv(tmp_path / "a", "w", events, rows)
    (tmp_path / "a/w_objects.csv").write_text("t,class,x,y\n100000,frame,3,4\n")
    data = dataset_data(tmp_path / "a", CHOICE)
    assert [line.split(":")[0] for line in data.left_out] == [
        "w.npz",
        "x.npz",
        "y.npz",
        "z.csv",
    ]
    assert data.left_out[0] == "w.npz: w_objects.csv: no boxes to learn from: w and h are needed"
    assert data.left_out[1] == "x.npz: No such file or directory"
    n_windows = sum(name.startswith("z.csv at") for name in data.training.recordings.names)
    assert "got 'nonsense'" in data.left_out[3] and n_windows > 0
    assert data.left_out[3].endswith(f"; its {n_windows} windows before that are learned from")
    assert not any(str(tmp_path) in line for line in data.left_out)


def test_a_recording_with_many_events_off_the_sensor_is_noted_and_few_are_counted(tmp_path):
    """As in class folders, one damaged recording does not end the reading of the others."""
    write_set(tmp_path / "a", 3)
    events, rows = recording(9)
    off = events.copy()
    off["x"] += 100
    write_csv(tmp_path / "a", "w", off, rows)
    few = events.copy()
    few["x"][len(few) // 2 : len(few) // 2 + 7] = 100
    write_csv(tmp_path / "a", "x", few, rows)
    data = dataset_data(tmp_path / "a", CHOICE)
    (line,) = data.left_out
    assert line.startswith("w.npz: ") and "the recording is of another sensor, or damaged" in line
    assert data.record["left_out_off_sensor"] == 7
    assert "events left out: 7 off the sensor" in data.notes


def test_events_that_come_late_are_noted(tmp_path):
    """Within a window's length they are in their windows. Later ones may not be."""
    events, rows = recording(5)
    blocks = np.array_split(events, 24)  # half a window each
    swapped = np.concatenate([blocks[k ^ 1] for k in range(24)])
    write_csv(tmp_path / "a", "r", swapped, rows)
    write_csv(tmp_path / "b", "r", events, rows)
    write_csv(tmp_path / "c", "r", events[::-1], rows)
    late, ordered, reversed_ = [dataset_data(tmp_path / name, CHOICE) for name in "abc"]
    assert late.record == ordered.record and "late_events" not in late.record
    assert reversed_.record["late_events"] > len(events) / 2
    assert any("so sort the recordings by time" in line for line in reversed_.notes)


# -- what is held out ------------------------------------------------------------------------------


def test_whole_recordings_are_held_out_and_each_class_is_learned(tmp_path):
    write_set(tmp_path / "a", 8)
    seen = set()
    for seed in range(6):
        data = dataset_data(tmp_path / "a", CHOICE, split=Split(validation=0.3, seed=seed))
        sides = []
        for windows in (data.training, data.validation):
            names = np.array(windows.recordings.names)[windows.recording]
            sides.append({name.split(" at ")[0] for name in names})
            _, boxes = windows.recordings.boxes_of(windows.recording)
            assert set(boxes["label"]) == {0, 1}
        assert not sides[0] & sides[1] and len(sides[0] | sides[1]) == 8
        assert sorted(sides[1]) == list(data.held_out)
        assert data.record["held_out_recordings"] == len(sides[1])
        seen.add(data.held_out)
    assert len(seen) > 3
    grouped = dataset_data(tmp_path / "a", CHOICE, split=Split(groups=r"r0([01])|r0[2-7]"))
    assert len(grouped.held_out) > 0 and "held out by group" in grouped.record["source"]


def test_of_a_single_recording_the_last_moments_are_held_out(tmp_path):
    write_csv(tmp_path / "a", "one", *recording(5, n_steps=30))
    data = dataset_data(tmp_path / "a", CHOICE)
    names = np.array(data.training.recordings.names)
    learned = [int(name.split()[-2]) for name in names[data.training.recording]]
    held_out = [int(name.split()[-2]) for name in names[data.validation.recording]]
    assert len(held_out) == 6 and max(learned) <= min(held_out) - STEP_US
    assert data.record["held_out_in_time"] == list(CLASSES)
    assert any("held out in time" in line for line in data.notes)


def test_a_class_without_a_box_to_learn_from_is_refused_with_the_reason(tmp_path):
    events, rows = recording(5, n_steps=30)
    last = [row._replace(name="late") if row.t > 28 * STEP_US else row for row in rows]
    write_csv(tmp_path / "a", "one", events, last)
    rule = "`validation` must leave boxes of each class to learn from: all boxes of class late"
    with pytest.raises(ValueError, match=f"{rule} .*got 0.2"):
        dataset_data(tmp_path / "a", CHOICE)
    data = dataset_data(tmp_path / "a", CHOICE, split=Split(validation=0))
    assert data.classes == (*CLASSES, "late")
    # or it is in a recording that is left out
    write_csv(tmp_path / "a", "one", events, rows)
    ghost = rows[0]._replace(name="ghost")
    write_csv(tmp_path / "a", "two", events, [ghost, ghost._replace(x="nan")])
    reason = r"no box of class ghost is left .* \(left out: two.npz: two_objects.csv: x, y, w and h"
    with pytest.raises(ValueError, match=reason):
        dataset_data(tmp_path / "a", CHOICE)


# -- scenes ----------------------------------------------------------------------------------------


def windows_with_boxes(events, boxes, config=CONFIG):
    """Windows of these events, each with boxes (label, x, y, w, h); (x, y) is the middle."""
    made = Recordings.from_events(events, [0] * len(events))
    rows = []
    for r, of_window in enumerate(boxes):
        rows += [(r, label, (x, y), (w, h)) for label, x, y, w, h in of_window]
    made = replace(made, boxes=np.array(rows, BOX_DTYPE))
    n = len(events)
    return Windows(made, np.arange(n), np.zeros(n, np.int64))


def filled(box, n=300, seed=0, last_us=1000):
    """Events within a box (x, y, w, h) of that middle."""
    x, y, w, h = box
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, last_us, n))
    return events_of(
        t,
        rng.integers(round(x - w / 2), round(x + w / 2), n),
        rng.integers(round(y - h / 2), round(y + h / 2), n),
        rng.integers(0, 2, n),
    )


def test_a_scene_is_a_window_with_its_boxes():
    events = [filled((20, 16, 10, 8), seed=k) for k in range(3)]
    windows = windows_with_boxes(events, [[(1, 20, 16, 10, 8)], [], [(0, 20, 16, 10, 8)]])
    maker = maker_of(CONFIG, CONFIG, windows)
    assert isinstance(maker, TableScenes) and (maker.config, maker.crops) == (CONFIG, CONFIG)
    shown = windows[np.array([2, 1, 0])]
    scenes = maker(shown, unchanged(3, CONFIG), np.random.default_rng(0))
    assert (scenes.volumes == BatchVolumes(CONFIG)(shown)).all() and scenes.volumes.any()
    assert (scenes.scene.tolist(), scenes.label.tolist()) == ([0, 2], [0, 1])
    assert scenes.position.tolist() == [[20, 16]] * 2 and scenes.size.tolist() == [[10, 8]] * 2


def test_a_window_that_ends_early_begins_later_instead():
    """The boxes are those of its end. So does a window that slides, wherever it was slid to."""
    events = filled((20, 16, 10, 8), n=600)
    windows = windows_with_boxes([events], [[(1, 20, 16, 10, 8)]])
    draws = unchanged(1, CONFIG)
    draws.until_us[:] = 300
    draws.start_us[:] = 77
    scenes = TableScenes(CONFIG)(windows, draws, np.random.default_rng(0))
    last = events[events["t"] >= 700].copy()
    last["t"] -= 700
    expected = BatchVolumes(CONFIG)(windows_with_boxes([last], [[]]))
    assert (scenes.volumes == expected).all() and 0 < expected.sum() < 600
    assert scenes.size.tolist() == [[10, 8]]
    sliding = TNTConfig(
        sensor=(40, 32), grid=(40, 32), representation="count", transform="none", last_us=1000
    )
    slid = windows.slid(1000, np.random.default_rng(0))
    assert slid.start_us[0] < -100
    scenes = TableScenes(sliding)(slid, unchanged(1, sliding), np.random.default_rng(0))
    assert (scenes.volumes == BatchVolumes(CONFIG)(windows)).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_boxes_move_as_events_do(sign):
    """Augmentation moves, scales and mirrors; events that fill a box still do so afterwards."""
    box = (18, 15, 10, 8)
    windows = windows_with_boxes([filled(box, n=4000)], [[(1, *box)]])
    draws = Augmentation.for_sensor(CONFIG, shift_px=3, scale=0.3, rotation_deg=0, shear=0).draw(
        windows, CONFIG, np.random.default_rng(4)
    )
    draws.until_us[:] = 1000
    draws.keep[:] = 1
    draws.matrix[:, 0] *= sign
    draws.matrix[:, 0, 2] += (sign < 0) * 40 * draws.sensor[0] / CONFIG.sensor[0]
    scenes = TableScenes(CONFIG)(windows, draws, np.random.default_rng(0))
    of_places = np.abs(scenes.volumes[0]).sum(0)
    y, x = np.nonzero(of_places > 0.2 * of_places.max())
    ((left, top),) = scenes.position - scenes.size / 2
    ((right, bottom),) = scenes.position + scenes.size / 2
    assert abs(left - x.min()) < 1.5 and abs(right - x.max()) < 1.5
    assert abs(top - y.min()) < 1.5 and abs(bottom - y.max()) < 1.5
    assert abs(scenes.size[0, 0] - 10) > 0.1
    # a box covers pixels from their edges on, so its middle is half a pixel beyond their centres
    mean_x = (of_places.sum(0) * np.arange(of_places.shape[1])).sum() / of_places.sum()
    mean_y = (of_places.sum(1) * np.arange(of_places.shape[0])).sum() / of_places.sum()
    np.testing.assert_allclose(scenes.position, [(mean_x + 0.5, mean_y + 0.5)], atol=0.3)


def test_a_box_is_cut_off_at_the_border_and_gone_with_its_middle():
    box = (20, 16, 10, 8)
    windows = windows_with_boxes([filled(box)] * 2, [[(1, *box)]] * 2)
    draws = unchanged(2, CONFIG)
    draws.matrix[:, 0, 2] = -19, -21  # the middle is at 1, and at -1
    scenes = TableScenes(CONFIG)(windows, draws, np.random.default_rng(0))
    assert scenes.scene.tolist() == [0]
    assert scenes.position.tolist() == [[3, 16]] and scenes.size.tolist() == [[6, 8]]


def test_what_shows_nothing_or_has_too_few_events_is_no_object():
    """The noise of a window does not count, however much it is."""
    box = (20, 16, 10, 8)
    rng = np.random.default_rng(0)
    n = 3000
    noise = events_of(
        np.sort(rng.integers(0, 1000, n)), rng.integers(0, 40, n), rng.integers(0, 32, n), [1] * n
    )
    shown = filled(box)
    both = np.concatenate([noise, shown])
    both = both[np.argsort(both["t"], kind="stable")]
    windows = windows_with_boxes([shown, shown, shown[:5], noise, both], [[(1, *box)]] * 5)
    draws = unchanged(5, CONFIG)
    draws.content[1] = PATCH  # a patch that twinkles, just where the box is
    draws.place[1] = 15, 12, 10, 8, 0, 0, 0, 0.5
    scenes = TableScenes(CONFIG)(windows, draws, np.random.default_rng(0))
    assert scenes.scene.tolist() == [0, 4]


@pytest.mark.parametrize("polarity", ["split", "signed", "unsigned"])
def test_events_of_both_signs_in_one_cell_count(polarity):
    """They take each other away in signed volumes."""
    box = (20, 16, 10, 8)
    shown = filled(box)
    shown["p"] = np.arange(len(shown)) % 2
    shown["x"] = shown["x"] // 2 * 2
    shown["x"][1::2] = shown["x"][:-1:2]
    shown["y"][1::2] = shown["y"][:-1:2]
    config = CONFIG.replace(polarity=polarity)
    windows = windows_with_boxes([shown], [[(1, *box)]])
    scenes = TableScenes(config)(windows, unchanged(1, config), np.random.default_rng(0))
    assert scenes.scene.tolist() == [0]


def test_more_events_than_noise_by_hand():
    events = np.ones((1, 16, 24))
    events[0, 4:8, 4:12] = 6
    low = np.array([[4.0, 4.0], [3.2, 4.0]])
    high = np.array([[12.0, 8.0], [12.0, 8.0]])
    more = more_than_noise(events, np.zeros(2, np.int64), low, high)
    # a quiet block has one event a cell, and a box covers whole cells
    assert more.tolist() == [4 * 8 * 5, 4 * 8 * 5]
    # a sensor smaller than a block is one block
    small = np.ones((2, 4, 5))
    small[1, 1:3, 2:4] = 6  # a mean of 2
    box = np.array([[2.0, 1.0]] * 2), np.array([[4.0, 3.0]] * 2)
    assert more_than_noise(small, np.arange(2), *box).tolist() == [0, 4 * (6 - 2)]


def test_objects_larger_than_the_sensor_count_as_large_as_it(tmp_path):
    events, rows = recording(5)
    large = [row._replace(x=row.x - 40, y=row.y - 40, w=row.w + 80, h=row.h + 80) for row in rows]
    write_csv(tmp_path / "a", "one", events, large)
    data = dataset_data(tmp_path / "a", CHOICE, split=Split(validation=0))
    assert data.record["sizes"] == [1, 1] and data.config.grid == Scales(1, 1).grid(SENSOR)


def test_recordings_with_boxes_are_for_map_models(tmp_path):
    write_set(tmp_path / "a", 4)
    data = dataset_data(tmp_path / "a", CHOICE)
    settings = settings_for(data.config, len(data.training), epochs=1)
    with pytest.raises(ValueError, match="`everywhere` must be True for windows whose boxes"):
        fit(data, settings, tmp_path / "run")
    plan = Plan(CHOICE, epochs=1, everywhere=True, has_tables=True)
    settings = plan.settings_for(data)
    assert (settings.network, settings.batch) == ("boxes", 16)
    made = data.training.recordings
    other = made.boxes.copy()
    other["size"][0, 0] += 1  # which makes it another run
    changed = replace(data.training, recordings=replace(made, boxes=other))
    assert windows_checksum(changed, changed) != windows_checksum(data.training, data.training)
    with pytest.raises(ValueError, match="`scales` must not be given with tables of boxes"):
        dataset_data(tmp_path / "a", CHOICE, scales=(0.1, 0.3))
    with pytest.raises(ValueError, match="the part `Test` of recordings with tables"):
        dataset_data(tmp_path / "a", CHOICE, split=Split(test=True))
    with pytest.raises(ValueError, match="regions and masks are for class folders"):
        dataset_data(tmp_path / "a", CHOICE, pixels=Pixels(roi=(0, 0, 20, 20)))


# -- the command -----------------------------------------------------------------------------------


def test_a_model_finds_the_boxes_of_other_recordings(tmp_path, program):
    """A short training from the command line, then `evaluate` on the folder's other part."""
    pytest.importorskip("pycocotools", reason="needs the extra `boxes`")
    write_set(tmp_path / "set/Train", 10)
    write_set(tmp_path / "set/test", 4, seed=1)
    found = {}
    for name, epochs in (("short", 1), ("trained", 4)):
        out = tmp_path / f"{name}.safetensors"
        words = ["train", tmp_path / "set", "--everywhere", "--window-us", STEP_US, "--out", out]
        code, _, err = program(*words, "--epochs", epochs)
        assert code == 0, err
        code, printed, err = program("evaluate", out, tmp_path / "set", "--json")
        assert code == 0, err
        found[name] = json.loads(printed)
    assert found["short"]["recordings"] == found["trained"]["recordings"] == 4
    assert found["short"]["coco"]["map_50"] < 0.5
    assert found["trained"]["coco"]["map_50"] > 0.6
    model = load_model(out)
    assert model.by_share and model.has_sizes and model.classes == CLASSES
    # the least boxes have about 10 cells: 42 along the shorter side, in steps of 8
    assert (model.config.sensor, model.config.grid) == (SENSOR, (56, 40))
    record = model.record["data"]
    assert record["real_recordings"] + record["held_out_recordings"] == 10
    assert sum(record["classes"].values()) == record["boxes"] + record["held_out_boxes"] > 100
    assert "r0" not in json.dumps(record) and model.record["validation"]["f1"] > 0.6
    # it resumes from the run folder, and ends with the same weights
    before = out.read_bytes()
    code, _, err = program(*words, "--epochs", 4)
    assert code == 0 and out.read_bytes() == before


def test_other_windows_and_one_class(tmp_path, program, few_steps):
    for k in range(4):
        events, rows = recording((1, k))
        rows = [row._replace(name="thing") for row in rows]
        write_csv(tmp_path / "a", f"r{k}", events, rows, sensor=None)
    out = tmp_path / "m.safetensors"
    words = ["train", tmp_path / "a", "--everywhere", "--epochs", 1, "--out", out]
    code, _, err = program(*words, "--sensor", "64x48", "--last-us", 30_000, "--mirror")
    assert code == 0, err
    model = load_model(out)
    assert model.classes == ("thing",) and model.config.last_us == 30_000
    assert model.config.grid == model.config.sensor == (64, 48)
    code, _, err = program(*words)
    assert code == 2 and "--sensor must be given: no recording of" in err


def test_what_cannot_be_learned_is_said_in_one_line(tmp_path, program):
    def error(folder, *words, everywhere=True):
        more = ("--everywhere",) if everywhere else ()
        out = tmp_path / "m.safetensors"
        code, _, err = program("train", folder, *more, "--epochs", 1, "--out", out, *words)
        assert code == 2, err
        return err.splitlines()[-1]

    write_set(tmp_path / "a", 3)
    whole = tmp_path / "a"
    assert "give --everywhere to learn from them" in error(whole, everywhere=False)
    refused = ("--scales", "0.1-0.3", "--size", "0.3", "--camera", "a.npz", "--roi", "0,0,20,20")
    refused = (*refused, "--mask", "m.npy")
    assert "--scales, --size, --camera, --roi, --mask cannot be used with tables" in error(
        whole, *refused
    )
    assert "--test is for class folders: give recordings" in error(whole, "--test")
    assert "--sensor must be that of all recordings; " in error(whole, "--sensor", "128x96")
    assert "must compute a map" in error(whole, "--network", "residual")
    assert "windows of a duration" in error(whole, "--last-events", "500")
    assert "a scene is a sum of volumes" in error(whole, "--volume", "representation=time_surface")
    events, rows = recording(5)
    write_csv(tmp_path / "b", "r", events, [])
    (tmp_path / "b/r_objects.csv").write_text("t,class,x,y\n100000,frame,3,4\n")
    assert "(left out: r.npz: r_objects.csv: no boxes to learn from" in error(tmp_path / "b")

    write_csv(tmp_path / "c", "r", events[:20], rows)
    assert "no recording is left (left out: r.npz: no box has enough events" in error(
        tmp_path / "c"
    )
    mixed = tmp_path / "mixed"
    write_set(mixed, 2)
    write_class_folders(mixed, {"upright": 1}, side=32)
    assert "with tables of boxes, or class folders, got both: upright/00.npy" in error(mixed)

    few = tmp_path / "few"
    write_set(few, 3)
    with (few / "r00_objects.csv").open("a") as table:
        table.write("100000,ghost,30,40,0,9\n")
    assert "no box of class ghost is left to learn from" in error(few)

    numbers = tmp_path / "numbers"
    write_boxes(numbers, "r", events, rows, names=False)
    boxes = np.load(numbers / "r_bbox.npy")
    boxes["class_id"] *= 3
    np.save(numbers / "r_bbox.npy", boxes)
    assert "the numbers of classes must be 0, 1, 2 and so on, got" in error(numbers)
    write_csv(numbers, "s", events, rows)
    assert "some tables have names of classes, others only numbers" in error(numbers)


def test_the_parts_of_a_data_set_are_found_in_any_letters(tmp_path):
    write_set(tmp_path / "a/TEST", 1)
    write_set(tmp_path / "a/train", 2)
    assert [path.parent.name for path, _ in find_tables(tmp_path / "a")] == ["TEST"]
    assert [path.parent.name for path, _ in find_tables(tmp_path / "a", "Train")] == ["train"] * 2
