"""Made scenes of eight kinds of drawn objects, and their boxes."""

import ast
from pathlib import Path

import numpy as np
import pytest

from experiments.objects import hands, kinds, mistakes, pairs, scenes
from experiments.pictures import drawn

SENSOR = (240, 180)


def imports(module) -> set[str]:
    tree = ast.parse(Path(module.__file__).read_text())
    names = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    assert names
    return names


@pytest.mark.parametrize("module", [kinds, scenes, hands, pairs])
def test_the_renderer_shares_no_code_with_the_training(module):
    for name in imports(module):
        assert not name.startswith(("async_tnt", "experiments.pictures"))


def test_the_pictures_of_training_share_no_code_with_the_scenes():
    assert not [name for name in imports(drawn) if name.startswith(("async_tnt", "experiments"))]
    assert list(drawn.DRAWERS) == list(kinds.KINDS)


@pytest.mark.parametrize("kind", kinds.KINDS)
def test_an_outline_is_one_long_and_differs_from_object_to_object(kind):
    outlines = [kinds.outline(kind, np.random.default_rng(k)) for k in range(2)]
    for lines in outlines:
        assert np.ptp(lines[0], axis=0).max() == pytest.approx(1)
        np.testing.assert_allclose(lines[0].min(axis=0) + lines[0].max(axis=0), 0, atol=1e-12)
        for hole in lines[1:]:
            assert (hole.min(axis=0) > lines[0].min(axis=0)).all()
            assert (hole.max(axis=0) < lines[0].max(axis=0)).all()
    assert not np.allclose(outlines[0][0], outlines[1][0])


def test_distances_of_a_square_with_a_hole():
    square = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    x = np.array([0.7, 0.45, 0.0, 0.0, 0.8])
    y = np.array([0.0, 0.0, 0.0, 0.35, 0.9])
    found = kinds.distances([square, 0.5 * square], x, y)
    # right of it, inside, in the hole, inside below the hole, and away from a corner
    np.testing.assert_allclose(found, [0.2, -0.05, 0.25, -0.1, 0.5])


def test_a_box_is_that_of_what_is_drawn():
    for number in range(3):
        for thing in scenes.made_scene(7, SENSOR, number).objects:
            for u in (0.0, 0.3, 1.0):
                light = np.zeros(SENSOR[::-1])
                scenes._draw(light, thing, u)
                rows, columns = np.nonzero(np.abs(light) > abs(thing.grey) / 2)
                drawn = [columns.min(), rows.min(), columns.max(), rows.max()]
                # thin tips are fainter than half of the contrast
                np.testing.assert_allclose(thing.box(u), drawn, atol=2.5)


def test_a_nearer_object_covers_the_one_behind_it():
    near, far = scenes.made_scene(7, SENSOR, 0).objects[:2]
    light = np.zeros(SENSOR[::-1])
    scenes._draw(light, far, 0.5)
    alone = light.copy()
    moved = scenes.replace(near, place=far.place, way=0 * near.way)
    scenes._draw(light, moved, 0.5)
    own = np.zeros(SENSOR[::-1])
    scenes._draw(own, moved, 0.5)
    inner = np.abs(own) > 0.99 * abs(moved.grey)
    assert inner.any()
    np.testing.assert_allclose(light[inner], own[inner], atol=0.02)
    np.testing.assert_array_equal(light[own == 0], alone[own == 0])


@pytest.mark.parametrize("sensor", scenes.SENSORS)
def test_scenes_keep_the_stated_rules(sensor):
    sizes = []
    for number in range(4):
        scene = scenes.made_scene(11, sensor, number)
        assert 1 <= len(scene.objects) <= scenes.OBJECTS[1]
        assert set(scene.labels) <= set(kinds.KINDS)
        for t_us in (0, 40_000, 100_000):
            boxes = scene.boxes(t_us)
            assert (boxes[:, :2] >= 0).all()
            assert (boxes[:, 2:] <= np.array(sensor) - 1).all()
            for k, box in enumerate(boxes):
                later = boxes[k + 1 :]
                shared = scenes._shared(np.tile(box, (len(later), 1)), later)
                assert shared.sum() <= scenes.MOST_COVERED + 0.05  # between the compared moments
        sizes += [thing.size / min(sensor) for thing in scene.objects]
        columns = scene.columns
        assert (np.diff(columns["t"]) >= 0).all()
        assert columns["t"][0] >= 0 and columns["t"][-1] < scenes.WINDOW_US
        assert columns["x"].max() < sensor[0] and columns["y"].max() < sensor[1]
        assert columns["x"].min() >= 0 and columns["y"].min() >= 0
    assert min(sizes) >= scenes.SIZES[0] and max(sizes) <= scenes.SIZES[1]
    assert max(sizes) > 2 * min(sizes)


def test_events_lie_where_things_are(monkeypatch):
    """Without noise and clutter, all events lie in the boxes that objects have on their way."""
    monkeypatch.setattr(scenes, "NOISE_HZ", (1e-9, 1e-8))
    monkeypatch.setattr(scenes, "HOT_PIXELS", 0)
    monkeypatch.setattr(scenes, "CLUTTER", (0, 0))
    scene = scenes.made_scene(5, SENSOR, 0)
    x, y = scene.columns["x"], scene.columns["y"]
    is_near = np.zeros(len(x), bool)
    margin = 12  # an edge is soft, and a pixel may be about to fire
    for thing in scene.objects:
        boxes = np.array([thing.box(u) for u in np.linspace(0, 1, 30)])
        low = boxes[:, :2].min(axis=0) - margin
        high = boxes[:, 2:].max(axis=0) + margin
        is_near |= (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    assert len(x) > 1_000 and is_near.all()


def test_a_scene_depends_on_seed_sensor_and_number_alone():
    first = scenes.made_scene(3, SENSOR, 1)
    again = scenes.made_scene(3, SENSOR, 1)
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, again.columns[name])
    np.testing.assert_array_equal(first.boxes(5e4), again.boxes(5e4))
    for other in (scenes.made_scene(4, SENSOR, 1), scenes.made_scene(3, SENSOR, 2)):
        assert len(other.columns["t"]) != len(first.columns["t"])
    assert scenes.TUNING_SEED != scenes.FINAL_SEED


def test_pictures_of_the_kinds_are_cut_out_and_differ(tmp_path):
    pytest.importorskip("PIL", reason="pictures need Pillow")
    from async_tnt.simulation.pictures import read_picture

    drawn.write_drawn(tmp_path, 2)
    paths = sorted(tmp_path.glob("*/*.png"))
    assert sorted({path.parent.name for path in paths}) == sorted([*kinds.KINDS, drawn.OTHER])
    assert len(paths) == 2 * (len(kinds.KINDS) + 2)
    pictures = [read_picture(path) for path in paths]
    for one, other in zip(pictures[::2], pictures[1::2], strict=True):
        assert one.ground is None  # transparent
        assert 0.03 < one.cover.mean() < 0.95  # a thin line across is the least
        assert one.light[one.cover == 1].std() < 0.01  # one grey
        assert one.cover.shape != other.cover.shape or (one.cover != other.cover).any()
    again = drawn.write_drawn(tmp_path / "again", 2)
    for path in paths:
        assert path.read_bytes() == (again / path.parent.name / path.name).read_bytes()


def test_mistakes_are_counted_by_size():
    """By hand: on a sensor with a shorter side of 100 pixels, parts end at 11.8, 16.7 and 23.6."""
    counts = mistakes.Mistakes()
    boxes = np.array([(0.0, 0, 10, 10), (20, 0, 40, 20), (50, 50, 80, 60), (0, 60, 15, 70)])
    found = np.array([(0.0, 0, 10, 8), (20, 0, 40, 10), (20, 0, 40, 12), (50, 50, 62, 60)])
    labels = ["fish", "key", "star", "cup"]
    counts.add(boxes, labels, found, ["fish", "cup", "arrow", "star"], 100)
    # the fish is right; both boxes on the key are of other kinds; the star's box is too small
    assert counts.to_dict() == {
        "edges": [0.1179, 0.1667, 0.2357],
        "objects": [1, 1, 1, 1],
        "found": [1, 0, 1, 0],
        "right": [1, 0, 0, 0],
        "mistaken": [{"kind": "key", "taken_for": "arrow", "objects": 1}],
    }
    counts.add(boxes, labels, np.empty((0, 4)), [], 100)
    assert counts.to_dict()["objects"] == [2, 2, 2, 2] and counts.to_dict()["found"][0] == 1


def test_scores_of_a_model_that_knows_and_of_one_that_does_not(tmp_path):
    """A made model of one class says the same box everywhere; scenes are read from files again."""
    torch = pytest.importorskip("torch", reason="networks are made with torch")
    pytest.importorskip("pycocotools", reason="scores of boxes need the extra `boxes`")
    from dataclasses import replace

    from async_tnt import Model, TNTConfig
    from experiments import object_scales

    config = TNTConfig(
        sensor=(48, 32), grid=(48, 32), bins=5, polarity="split", transform="none"
    ).replace(window_us=100_000)
    n_classes = len(kinds.KINDS)
    net = torch.nn.Conv2d(config.channels, n_classes + 5, 8, 8)
    with torch.no_grad():
        net.weight.zero_()
        net.bias.zero_()
        net.bias[n_classes] = 9.0
    nothing = replace(Model.from_torch(net, config, list(kinds.KINDS)), by_share=True)
    some = object_scales.Scenes(9, SENSOR, 2, tmp_path / "scenes")
    ticks = []
    found = object_scales.score(nothing, some, lambda: ticks.append(1))
    assert len(ticks) == 2 and list(found) == ["mistakes", "10", "30", "50", "100", "f1_of_kinds"]
    assert found["100"]["map"] == 0.0 and found["100"]["f1"] == 0.0
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").iterdir()}
    assert len(files) == 2
    for (columns, labels, boxes), number in zip(some, range(2), strict=True):
        scene = scenes.made_scene(9, SENSOR, number)
        assert labels == scene.labels
        np.testing.assert_array_equal(boxes[-1], scene.boxes(100_000))
        np.testing.assert_array_equal(columns[1], scene.columns["x"])
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").iterdir()} == files
    # of boxes as they are, every score is 1
    table = object_scales._table(boxes[-1], [list(kinds.KINDS).index(k) for k in labels], 100)
    middle = table.middle
    whole = np.column_stack(
        [middle, np.full(len(middle), 0.9), table.label, np.arange(len(middle)), table.size]
    )
    perfect = object_scales.FoundBoxes()
    perfect.add(table, slice(None), whole)
    assert perfect.scores(list(kinds.KINDS))["map"] == 1.0
