"""Scenes of several recordings, and map models that learn from them."""

import json
import re

import numpy as np
import pytest
from made import events_of
from training.gestures import bar, write_set

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

import torch
from tnt_reference import event_volume

from async_tnt import Model, Processor, TNTConfig, load_model
from async_tnt.training import objectives
from async_tnt.training import scenes as module
from async_tnt.training.augment import KINDS, Augmentation, unchanged
from async_tnt.training.objectives import SceneScores
from async_tnt.training.pipeline import Pipeline
from async_tnt.training.recordings import Recordings, RecordingsWriter
from async_tnt.training.scenes import Scales, SceneMaker, Scenes
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Windows, make_windows

CONFIG = TNTConfig(
    sensor=(20, 16),
    grid=(20, 16),
    bins=3,
    polarity="split",
    transform="none",
    landmark="center",
    window_us=1000,
)


def recordings(n, n_events=60, seed=0, window_us=1000):
    """Each within a rectangle of its own, whose middle is not the sensor's."""
    rng = np.random.default_rng(seed)
    events = []
    for k in range(n):
        t = np.sort(rng.integers(0, window_us, n_events))
        x = rng.integers(2 + k % 3, 14 + k % 4, n_events)
        y = rng.integers(1, 12 + k % 3, n_events)
        events.append(events_of(t, x, y, rng.integers(0, 2, n_events)))
    whole = []
    for one in events:  # another window before it, of events that must not be seen
        before = one.copy()
        before["x"] = 19
        shown = one.copy()
        shown["t"] += window_us
        whole.append(np.concatenate([before, shown]))
    made = Recordings.from_events(whole, np.arange(n) % 3)
    return events, Windows(made, np.arange(n), np.full(n, window_us))


@pytest.fixture
def no_noise(monkeypatch):
    monkeypatch.setattr(module, "NOISE_HZ", (0.0, 0.0))
    monkeypatch.setattr(module, "HOT_EVENTS", (0, 1))


@pytest.mark.parametrize("grid", [(20, 16), (10, 8)])
def test_a_scene_has_the_volume_of_its_recordings_events_on_the_larger_sensor(grid, no_noise):
    """The reference computes it from recordings that are moved to their places by whole cells.

    Events beyond the border are left out.
    """
    config = CONFIG.replace(grid=grid)
    maker = SceneMaker(config)
    assert (maker.config.sensor, maker.config.grid) == ((60, 48), (3 * grid[0], 3 * grid[1]))
    events, windows = recordings(12, 200)
    draws = unchanged(12, config)
    draws.until_us[:] = 700
    scenes = maker(windows, draws, np.random.default_rng(5))
    expected = np.zeros(scenes.volumes.shape)
    again = np.random.default_rng(5)  # the draws of starts, as the maker makes them
    again.integers(max(1, round(12 / module.OBJECTS)), size=12)
    again.integers(12, size=len(scenes.volumes))
    later = np.where(again.random(12) < 0.5, again.integers(0, 500, 12), 0)
    assert (scenes.label == windows.labels).all()  # none is left out
    for i, (scene, place) in enumerate(zip(scenes.scene, scenes.position, strict=True)):
        one = events[i][events[i]["t"] + later[i] < 700]
        cells_a_pixel = (3 * np.array(grid) - 1) / (np.array([60, 48]) - 1)
        # the middle of what the scene shows
        middle = np.mean([np.percentile(one[c], (2, 98)) for c in "xy"], 1)
        in_crop = middle * (np.array(grid) - 1) / (np.array([20, 16]) - 1)
        cells = np.rint(place * cells_a_pixel - in_crop).astype(int)
        assert np.allclose((cells + in_crop) / cells_a_pixel, place)
        settings = {"start_us": 0, "window_us": 1000, "bins": 3, "polarity": "split"}
        small = event_volume(
            one["t"] + later[i],
            one["x"],
            one["y"],
            one["p"],
            sensor=config.sensor,
            grid=config.grid,
            **settings,
        ).numpy()
        canvas = np.zeros((6, 5 * grid[1], 5 * grid[0]))
        top = grid[1] + cells[1]
        left = grid[0] + cells[0]
        canvas[:, top : top + grid[1], left : left + grid[0]] = small
        expected[scene] += canvas[:, grid[1] : 4 * grid[1], grid[0] : 4 * grid[0]]
    assert np.abs(scenes.volumes - expected).max() < 1e-5
    assert expected.any()


def test_scenes_are_drawn_anew_but_the_same_from_the_same_seed():
    maker = SceneMaker(CONFIG)
    _, windows = recordings(40)
    draws = Augmentation.for_sensor(CONFIG, nothing=0.3).draw(
        windows, CONFIG, np.random.default_rng(1)
    )
    first = maker(windows, draws, np.random.default_rng(2))
    same = maker(windows, draws, np.random.default_rng(2))
    other = maker(windows, draws, np.random.default_rng(3))
    assert first.volumes.tobytes() == same.volumes.tobytes()
    assert (first.position == same.position).all()
    assert first.volumes.tobytes() != other.volumes.tobytes()
    assert len(first.label) < 36  # what shows nothing is no object
    assert (first.position > -2).all() and (first.position < (62, 50)).all()
    for scene in range(len(first.volumes)):
        there = first.position[first.scene == scene]
        away = np.hypot(*(there[:, None] - there[None]).transpose(2, 0, 1))
        # moved to whole cells since
        assert away[~np.eye(len(there), dtype=bool)].min(initial=99) > 0.4 * 16 - 1.5


def test_an_object_may_stand_anywhere_on_the_scene_and_nowhere_beyond():
    """On 60 x 48 pixels, as likely at one place as at another."""
    maker = SceneMaker(CONFIG)
    rng = np.random.default_rng(0)
    places = np.array([maker._place(np.empty((0, 2)), np.empty(0), rng) for _ in range(1_000)])
    for axis, last in enumerate((59, 47)):
        counts, _ = np.histogram(places[:, axis], bins=5, range=(0, last))
        assert counts.sum() == 1_000  # none is beyond
        np.testing.assert_allclose(counts, 200, rtol=0.25)
    # one beside another object does not stand beyond the border either
    corner = np.array([[59.0, 0.0]])
    tried = [maker._place(corner, np.array([16.0]), rng) for _ in range(200)]
    beside = np.array([place for place in tried if place is not None])
    assert len(beside) > 100 and (beside >= 0).all() and (beside <= (59, 47)).all()
    # and is away from it by a share of a recording's shorter side, 16 pixels, or more
    nearest = np.hypot(*(beside - corner).T).min()
    assert module.APART * 16 <= nearest < module.APART * 16 + 1


def test_half_of_the_objects_stand_beside_another_one(monkeypatch):
    """Within its extent of 8 pixels in x and in y, as few of the other half do on 60 x 48."""
    monkeypatch.setattr(module, "APART", 0.0)
    maker = SceneMaker(CONFIG)
    rng = np.random.default_rng(0)
    there = np.array([[30.0, 24.0]])
    places = np.array([maker._place(there, np.array([8.0]), rng) for _ in range(1_000)])
    is_beside = (np.abs(places - there) <= 8).all(axis=1)
    by_chance = 16 * 16 / (59 * 47)
    assert is_beside.mean() == pytest.approx(0.5 + 0.5 * by_chance, abs=0.05)
    # as often at one place around it as at another
    np.testing.assert_allclose(places[is_beside].mean(axis=0), there[0], atol=0.8)


def test_volumes_that_are_no_sums_are_refused():
    for config in (
        CONFIG.replace(transform="tnt"),
        CONFIG.replace(representation="time_surface", bins=1),
    ):
        with pytest.raises(ValueError, match="a scene is a sum of volumes"):
            SceneMaker(config)


def test_a_network_that_computes_no_numbers_finds_nothing():
    """It does not find what an earlier map has left."""
    net = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 4, 1))
    _, windows = recordings(30)
    scores = SceneScores(
        CONFIG, Model.from_torch(net, SceneMaker(CONFIG).config, tuple("abc")), windows
    )
    pipeline = Pipeline(CONFIG, net)
    assert scores.after(pipeline).n_present.sum() > 20
    with torch.no_grad():
        net[0].bias.fill_(np.nan)
    found = scores.after(pipeline)
    assert (found.n_found.sum(), found.f1, pipeline.training) == (0, 0.0, True)


def test_the_nearest_place_of_a_coarse_map_names_an_object(monkeypatch):
    """The nearest place is further away than `REACH` of the shorter side, 2.4 pixels.

    Places are 16 pixels apart.
    """
    coarse = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 4, 16, 16))
    monkeypatch.setattr(objectives, "build_network", lambda *_: coarse)
    _, windows = recordings(1)
    objects = objectives.ObjectsInScenes(
        CONFIG, windows[:0], TrainSettings(epochs=1), ("a", "b", "c")
    )
    scenes = Scenes(
        np.zeros((1, 6, 48, 60)),
        np.array([0]),
        np.array([2]),
        np.array([[20.0, 20.0]]),
        np.array([[9.0, 5.0]]),
    )
    assert objects._targets(scenes)[0].tolist() == [[[3, 3, 3], [3, 2, 3], [3, 3, 3]]]


def test_the_places_near_an_object_name_its_class_and_those_around_it_nothing_at_all(monkeypatch):
    """A map with a place a pixel. Within .15 of a recording's shorter side, 2.4 pixels, a place
    names the object; up to .2, 3.2 pixels, it may say anything; all others say that nothing is
    there. Of two objects the nearer one is named."""
    fine = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 4, 1))
    monkeypatch.setattr(objectives, "build_network", lambda *_: fine)
    _, windows = recordings(1)
    objects = objectives.ObjectsInScenes(
        CONFIG, windows[:0], TrainSettings(epochs=1), ("a", "b", "c")
    )
    scenes = Scenes(
        np.zeros((2, 6, 48, 60)),
        np.array([1, 1]),
        np.array([2, 0]),
        np.array([[20.0, 20.0], [23.0, 20.0]]),
        np.array([[9.0, 5.0], [0.2, 4.0]]),
    )
    target, weight, sizes = objects._targets(scenes)
    assert (target[0] == 3).all() and (weight[0] == 1).all()
    assert target[1, 20, 16:28].tolist() == [3, 3, 2, 2, 2, 2, 0, 0, 0, 0, 3, 3]
    assert weight[1, 20, 16:28].tolist() == [1, 0, 4, 4, 4, 4, 4, 4, 4, 4, 0, 1]
    assert target[1, 16:25, 20].tolist() == [3, 3, 2, 2, 2, 2, 2, 3, 3]
    assert weight[1, 16:25, 20].tolist() == [1, 0, 4, 4, 4, 4, 4, 0, 1]
    assert (weight[1] == 4).sum() == 5 * 8 and (weight[1] == 0).sum() == 7 * 10 - 5 * 8
    # the logarithms of width and height in places, of at least a pixel
    shown = sizes[1][target[1] == 2][:, :2]
    np.testing.assert_allclose(shown, np.tile(np.log([9.0, 5.0]), (len(shown), 1)), rtol=1e-6)
    shown = sizes[1][target[1] == 0][:, :2]
    np.testing.assert_allclose(shown, np.tile(np.log([1.0, 4.0]), (len(shown), 1)), atol=1e-6)


def test_the_loss_of_scenes_is_a_weighted_mean_over_places(monkeypatch):
    """A network that gives all places the same logits, and names class 1 everywhere."""
    net = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 4, 1))
    with torch.no_grad():
        net[0].weight.zero_()
        net[0].bias.copy_(torch.tensor([0.5, 2.0, -1.0, 1.0]))
    monkeypatch.setattr(objectives, "build_network", lambda *_: net)
    _, windows = recordings(9)
    objects = objectives.ObjectsInScenes(
        CONFIG, windows[:0], TrainSettings(epochs=1), ("a", "b", "c")
    )
    seen = []
    targets_of = objects._targets
    monkeypatch.setattr(objects, "_targets", lambda some: seen.append(targets_of(some)) or seen[-1])
    draws = unchanged(9, CONFIG)
    draws.seed[:] = 3
    found = objects.loss(Pipeline(CONFIG, net), windows, draws)
    ((target, weight, _),) = seen
    logits = np.array([0.5, 2.0, -1.0, 1.0])
    losses = np.log(np.exp(logits).sum()) - logits
    assert set(np.unique(target)) == {0, 1, 2, 3} and set(np.unique(weight)) == {0, 1, 4}
    expected = (losses[target] * weight).sum() / weight.sum()
    assert found.loss.item() == pytest.approx(expected, rel=1e-5)
    assert found.n == (target < 3).sum() and found.n_right == (target == 1).sum()


def test_the_loss_of_sizes_is_a_mean_over_the_places_of_objects(monkeypatch):
    """A network that says 4 x 2 places everywhere."""
    net = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 6, 1))
    logits = [0.5, 2.0, -1.0, 1.0]
    with torch.no_grad():
        net[0].weight.zero_()
        net[0].bias.copy_(torch.tensor([*logits, np.log(4.0), np.log(2.0)]))
    monkeypatch.setattr(objectives, "build_network", lambda *_: net)
    _, windows = recordings(9)
    objects = objectives.ObjectsInScenes(
        CONFIG, windows[:0], TrainSettings(epochs=1), ("a", "b", "c")
    )
    seen = []
    targets_of = objects._targets
    monkeypatch.setattr(objects, "_targets", lambda some: seen.append(targets_of(some)) or seen[-1])
    found = objects.loss(Pipeline(CONFIG, net), windows, unchanged(9, CONFIG))
    ((target, weight, boxes),) = seen
    sizes = boxes[..., :2]
    losses = np.log(np.exp(logits).sum()) - np.array(logits)
    of_classes = (losses[target] * weight).sum() / weight.sum()
    away = np.abs(np.log([4.0, 2.0]) - sizes[target < 3])
    of_sizes = np.where(away < 0.1, away**2 / 0.2, away - 0.05).mean()
    expected = of_classes + objectives.SIZE_WEIGHT * of_sizes
    assert found.loss.item() == pytest.approx(expected, rel=1e-5)
    assert sizes[target < 3].max() > 1.0  # objects are several pixels large


def test_a_box_is_that_of_most_of_an_objects_events():
    """An event far away does not change it. Augmentation turns and scales it."""
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.integers(5, 12, 400), [19]])
    y = np.concatenate([rng.integers(3, 7, 400), [15]])
    events = events_of(np.arange(401), x, y, np.ones(401, int))
    windows = make_windows(Recordings.from_events([events], [0]), 1000)
    as_it_is = np.eye(2, 3)[None]
    middles, sizes = module._boxes_of_events(windows, np.array([1000]), as_it_is)
    assert middles.tolist() == [[8.0, 4.5]] and sizes.tolist() == [[7.0, 4.0]]
    middles, sizes = module._boxes_of_events(windows, np.array([0]), as_it_is)
    assert middles.tolist() == [[0.0, 0.0]] and sizes.tolist() == [[1.0, 1.0]]

    maker = SceneMaker(CONFIG)
    draws = unchanged(1, CONFIG)
    scenes = maker(windows, draws, np.random.default_rng(0))
    assert scenes.size.tolist() == [[7.0, 4.0]]
    draws.matrix[0, :, :2] = [[0.0, -2.0], [1.5, 0.0]]  # turned by 90 degrees
    draws.matrix[0, :, 2] = [16.0, 0.0]
    scenes = maker(windows, draws, np.random.default_rng(0))
    assert scenes.size.tolist() == [[8.0, 10.5]]


def test_the_noise_of_a_scene_is_everywhere_in_its_time_and_a_hot_pixel_is_one(monkeypatch):
    """At a rate a pixel, up to the scene's end, in both polarities; the first half of a window has
    half of it."""
    config = CONFIG.replace(representation="count", bins=1, window_us=1_000_000)
    maker = SceneMaker(config)
    monkeypatch.setattr(module, "NOISE_HZ", (2.0, 2.0))
    monkeypatch.setattr(module, "HOT_EVENTS", (1_000, 1_001))
    until_us = np.full(60, 500_000)
    scenes = maker._noise(60, until_us, np.random.default_rng(0))
    assert scenes.shape == (60, 2, 48, 60)
    totals = scenes.sum((1, 2, 3))
    # 2 events a second and pixel, for half a second
    is_hot = totals > 3_500
    np.testing.assert_allclose(totals[~is_hot], 48 * 60, rtol=0.1)
    np.testing.assert_allclose(totals[is_hot], 48 * 60 + 1_000, rtol=0.1)
    assert 10 <= is_hot.sum() <= 30
    assert ((scenes.sum(1) > 500).sum((1, 2)) == is_hot).all()
    cold = scenes[~is_hot].sum(0)
    np.testing.assert_allclose(cold.sum((1, 2)) / cold.sum(), 0.5, atol=0.02)
    for axis in (0, 1):
        along = cold.sum(0).sum(axis)
        np.testing.assert_allclose(along / along.mean(), 1, atol=0.15)
    # in time: bins that are as full
    binned = SceneMaker(CONFIG.replace(bins=5, window_us=1_000_000))
    monkeypatch.setattr(module, "HOT_EVENTS", (0, 1))
    volumes = binned._noise(20, np.full(20, 1_000_000), np.random.default_rng(0))
    bins = volumes.reshape(20, 2, 5, -1).sum((0, 1, 3))
    np.testing.assert_allclose(bins / bins.sum(), [0.125, 0.25, 0.25, 0.25, 0.125], atol=0.01)
    monkeypatch.setattr(module, "MOST_NOISE", 300)
    assert (binned._noise(3, until_us[:3], np.random.default_rng(0)).sum((1, 2, 3)) < 301).all()


@pytest.mark.parametrize(("n_events", "n_objects"), [(9, 0), (10, 1)])
def test_an_object_of_few_events_is_not_there_yet(n_events, n_objects, no_noise):
    config = CONFIG.replace(representation="count", bins=1)
    events = events_of([0] * n_events, range(n_events), [5] * n_events, [1] * n_events)
    windows = Windows(Recordings.from_events([events], [2]), np.zeros(1, int), np.zeros(1, int))
    scenes = SceneMaker(config)(windows, unchanged(1, config), np.random.default_rng(0))
    assert len(scenes.label) == len(scenes.position) == n_objects
    assert scenes.volumes.sum() <= n_events


def test_early_in_a_window_few_objects_are_there():
    config = CONFIG.replace(window_us=40_000)
    net = torch.nn.Sequential(torch.nn.Conv2d(config.channels, 4, 1))
    _, windows = recordings(30, window_us=40_000)
    model = Model.from_torch(net, SceneMaker(config).config, tuple("abc"))
    scores = SceneScores(config, model, windows)
    pipeline = Pipeline(config, net)
    there = [scores.after(pipeline, us).n_present.sum() for us in (2_000, 20_000, 40_000)]
    assert there[0] == 0 and 5 < there[1] < there[2]
    words = scores.evaluate(pipeline)
    assert words["objects"] == there[2] == scores.after(pipeline).n_present.sum()
    # the moments of `async-tnt evaluate` before the end
    assert words["f1_against_time_ms"] == {
        f"{ms}": round(scores.after(pipeline, 1000 * ms).f1, 5) for ms in (10, 30)
    }


def map_model(maker, channels=4):
    """A map model of three classes with a place for each cell, for the scenes of a maker."""
    net = torch.nn.Sequential(torch.nn.Conv2d(maker.config.channels, channels, 1))
    return net, Model.from_torch(net, maker.config, tuple("abc"))


def test_about_so_many_scenes_are_scored_as_are_wanted(monkeypatch):
    """Also if they are not made all at once."""
    _, windows = recordings(60)
    net, model = map_model(SceneMaker(CONFIG))
    every = SceneScores(CONFIG, model, windows).after(Pipeline(CONFIG, net)).n_present.sum()
    monkeypatch.setattr(SceneMaker, "at_once", 7)
    parts = SceneScores(CONFIG, model, windows).after(Pipeline(CONFIG, net)).n_present.sum()
    assert 50 < every <= 60 and 50 < parts <= 60
    monkeypatch.setattr(objectives, "N_SCENES", 4)
    few = SceneScores(CONFIG, model, windows).after(Pipeline(CONFIG, net)).n_present.sum()
    assert 5 < few <= 4 * module.OBJECTS


@pytest.mark.parametrize("has_sizes", [False, True])
def test_an_object_is_found_within_a_share_of_its_extent(has_sizes, monkeypatch):
    """.15 of the shorter side of its recording, 16 pixels. If objects have many sizes, .15 of what
    stands for that side: the longer side of the object, divided by .8."""
    seen = []
    score_objects = objectives.score_objects

    def noted(found, labels, positions, within_px, n_classes):
        seen.append(np.broadcast_to(within_px, positions.shape))
        return score_objects(found, labels, positions, within_px, n_classes)

    monkeypatch.setattr(objectives, "score_objects", noted)
    scenes = CONFIG.replace(sensor=(60, 48), grid=(60, 48)) if has_sizes else None
    _, windows = recordings(20, 400)
    maker = SceneMaker(CONFIG, scenes)
    net, model = map_model(maker)
    made = []
    call = SceneMaker.__call__
    monkeypatch.setattr(
        SceneMaker, "__call__", lambda *given: made.append(call(*given)) or made[-1]
    )
    SceneScores(CONFIG, model, windows, scenes).after(Pipeline(CONFIG, net))
    (shown,) = made
    expected = np.full((len(shown.label), 2), 0.15 * 16)
    if has_sizes:
        expected = np.repeat(0.15 / 0.8 * shown.size.max(axis=1, keepdims=True), 2, axis=1)
    expected = expected[np.argsort(shown.scene, kind="stable")]
    assert len(expected) > 5
    np.testing.assert_allclose(np.concatenate(seen), expected)


def test_scenes_without_an_object_have_a_loss_too(monkeypatch):
    """There is no size to learn then. Without draws, the same windows are the same scenes."""
    net, _ = map_model(SceneMaker(CONFIG), channels=8)
    monkeypatch.setattr(objectives, "build_network", lambda *_: net)
    _, windows = recordings(9)
    settings = TrainSettings(epochs=1)
    objects = objectives.ObjectsInScenes(CONFIG, windows[:0], settings, ("a", "b", "c"))
    pipeline = Pipeline(CONFIG, net)
    draws = unchanged(9, CONFIG)
    draws.content[:] = KINDS["scattered"]
    nothing = objects.loss(pipeline, windows, draws)
    assert (nothing.n, nothing.n_right) == (0, 0) and torch.isfinite(nothing.loss)
    some = [objects.loss(pipeline, windows, None) for _ in range(2)]
    assert some[0].n > 0 and some[0].loss == some[1].loss


def test_a_network_without_a_map_learns_no_scenes(monkeypatch):
    _, windows = recordings(1)
    flat = torch.nn.Sequential(
        torch.nn.Conv2d(CONFIG.channels, 3, 1),
        torch.nn.AdaptiveAvgPool2d(1),
        torch.nn.Flatten(),
    )
    monkeypatch.setattr(objectives, "build_network", lambda *_: flat)
    rule = "`network` flat must compute a map of 4 channels, or of 6 .* or of 8 with their middles"
    with pytest.raises(ValueError, match=rule):
        settings = TrainSettings(epochs=1, network="flat")
        objectives.ObjectsInScenes(CONFIG, windows[:0], settings, ("a", "b", "c"))


@pytest.fixture(scope="module")
def finder(tmp_path_factory):
    """A map model of upright and flat bars at 32x32."""
    from async_tnt.cli import main

    folder = tmp_path_factory.mktemp("finder")
    write_set(folder / "bars", {"upright": 60, "flat": 60}, side=32)
    out = folder / "bars.safetensors"
    words = ["train", str(folder / "bars"), "--out", str(out), "--everywhere", "--epochs", "5"]
    assert main(words) == 0
    return out


def test_a_trained_map_model_finds_what_stands_on_a_larger_sensor(finder, capsys):
    model = load_model(finder)
    assert model.config.sensor == (96, 96) and model.places is not None
    found = model.record["validation"]
    assert found["f1"] > 0.8 and found["objects"] > 20
    assert json.loads(finder.with_suffix(".json").read_text())["history"][-1][
        "f1"
    ] == pytest.approx(found["f1"], abs=0.05)
    wide = Processor(model.for_sensor((200, 120)))
    parts = []
    for k, (kind, x, y) in enumerate([("upright", 20, 20), ("flat", 150, 10), ("upright", 90, 70)]):
        events = bar(kind, 900 + k, side=32)
        events["x"] += x
        events["y"] += y
        parts.append(events)
    events = np.concatenate(parts)
    wide.push(events[np.argsort(events["t"], kind="stable")])
    objects = sorted((o.x, o.y, o.label) for o in wide.fire().objects)
    expected = [(36, 36, "upright"), (106, 86, "upright"), (166, 26, "flat")]
    assert [label for *_, label in objects] == [label for *_, label in expected]
    assert np.abs(np.array([o[:2] for o in objects]) - [o[:2] for o in expected]).max() < 6


def test_run_prints_objects_and_other_commands_refuse_them(finder, program, tmp_path):
    events = bar("flat", 5, side=32)
    events["x"] += 30
    events["y"] += 40
    path = tmp_path / "scene.npz"
    np.savez(path, events=events, sensor=np.array((150, 100)))  # another sensor than the scenes'
    code, out, err = program("run", path, "--model", finder)
    assert (code, err) == (0, "")
    assert re.search(r"flat \(4\d, \d+, \d+ x \d+\)", out.splitlines()[-1])
    code, out, _ = program("run", path, "--model", finder, "--json")
    (decision,) = map(json.loads, out.splitlines())
    assert code == 0 and decision["label"] == "flat" and decision["objects"][0]["label"] == "flat"
    (found,) = decision["objects"]
    assert set(found) == {"id", "label", "probability", "x", "y", "box"}
    x0, y0, x1, y1 = found["box"]
    # the bar is about 22 pixels long and 4 high
    assert 14 < x1 - x0 < 45 and 3 < y1 - y0 < 20  # after a short training
    assert (x0 + x1) / 2 == pytest.approx(found["x"], abs=0.01)
    pytest.importorskip("matplotlib", reason="figures need matplotlib (extra: plot)")
    assert program("plot", path, "--model", finder, "--out", tmp_path / "a.svg")[0] == 0
    drawn = (tmp_path / "a.svg").read_text()
    assert "objects that" in drawn and "flat" in drawn
    for words in (
        ("evaluate", finder, tmp_path),
        ("plot", path, "--model", finder, "--volume", "bins=3"),
        ("run", path, "--confidence", "0.9"),
    ):
        more = ("--model", finder) if words[0] == "run" else ()
        code, _, err = program(*words, *more)
        assert code == 2 and err.count("\n") == 1 and "objects" in err


def test_options_that_do_not_go_with_everywhere(tmp_path, program):
    write_set(tmp_path / "bars", {"upright": 3, "flat": 3}, side=32)
    for words, message in [
        (("--motions", "resynthesized"), "--motions must come without --everywhere"),
        (("--network", "residual"), "must compute a map"),
        (("--volume", "representation=time_surface"), "a scene is a sum of volumes"),
    ]:
        code, _, err = program(
            "train", tmp_path / "bars", "--everywhere", "--out", tmp_path / "m.safetensors", *words
        )
        assert code == 2 and message in err.splitlines()[-1], err
    code, _, err = program(
        "train", tmp_path / "bars", "--network", "map", "--out", tmp_path / "m.safetensors"
    )
    assert code == 2 and "must compute one logit for each class" in err


def test_scenes_of_objects_of_many_sizes_have_the_boxes_of_their_outlines(no_noise):
    """Two squares of 4 and 12 pixels, which move to the right by 6 pixels in a millisecond."""
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    config = CONFIG.replace(sensor=(40, 40), grid=(20, 20))
    whole = CONFIG.replace(sensor=(120, 80), grid=(60, 40))
    rng = np.random.default_rng(0)
    with RecordingsWriter() as writer:
        for k in range(30):
            side = 4 if k % 2 else 12
            middles = 20 + np.stack([np.linspace(-3, 3, 4), np.zeros(4)], axis=1)
            outline = (side * corners + middles[:, None]).astype(np.float32)
            t = np.sort(rng.integers(0, 400, 200))
            x, y = rng.integers(20 - side // 2, 20 + side // 2, (2, 200))
            writer.add(events_of(t, x, y, t % 2), k % 2, str(k), outline, 1000)
        made = writer.finish()
    windows = Windows(made, np.arange(30), np.zeros(30, np.int64))
    maker = SceneMaker(config, whole)
    assert maker.config == whole
    draws = unchanged(30, config)
    draws.until_us[:] = 500
    scenes = maker(windows, draws, np.random.default_rng(0))
    assert len(scenes.volumes) < 30 / module.OBJECTS
    expected = np.where(scenes.label == 1, 4.0, 12.0)
    np.testing.assert_allclose(scenes.size, np.stack([expected, expected], axis=1), rtol=1e-5)
    for k in range(len(scenes.volumes)):
        there = scenes.position[scenes.scene == k]
        extents = scenes.size[scenes.scene == k].max(axis=1) / module.OF_RECORDING
        away = np.hypot(*(there[:, None] - there[None]).transpose(2, 0, 1))
        least = module.APART * (extents[:, None] + extents) / 2
        np.fill_diagonal(away, np.inf)
        assert (away > least - 2).all()  # places are moved to whole cells
    # half of the scene has passed, or less of what began later: the squares are halfway or behind
    times_us = np.array([500] * 28 + [-900, 2000])
    boxes = module._boxes_of_outlines(windows, times_us, draws.matrix)
    np.testing.assert_allclose(boxes[0, :28], 20, atol=1e-5)
    # it stays where it was first and last
    np.testing.assert_allclose(boxes[0, 28:], [(17, 20), (23, 20)], atol=1e-5)
    turned = draws.matrix.copy()
    turned[:, :, :2] = np.sqrt(0.5) * np.array([[1, -1], [1, 1]])
    boxes = module._boxes_of_outlines(windows, np.full(30, 500), turned)
    np.testing.assert_allclose(boxes[1, 1], 4 * np.sqrt(2), rtol=1e-5)


def test_a_box_is_that_of_the_outline_at_the_moment_when_the_scene_ends(no_noise):
    """A square that grows from 4 to 16 pixels in a millisecond, in windows that begin at 250 us and
    are shown from 300 us on: after 500 us more, its side is 4 + .8 x 12. It is younger where it
    begins later than the scene, by up to half of a window."""
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    outline = (np.linspace(4, 16, 4)[:, None, None] * corners + 20).astype(np.float32)
    rng = np.random.default_rng(0)
    config = CONFIG.replace(sensor=(40, 40), grid=(20, 20))
    with RecordingsWriter() as writer:
        for k in range(40):
            t = np.sort(rng.integers(0, 1000, 2_000))
            x, y = rng.integers(18, 22, (2, 2_000))
            writer.add(events_of(t, x, y, t % 2), 0, str(k), outline, 1000)
        windows = Windows(writer.finish(), np.arange(40), np.full(40, 250))
    draws = unchanged(40, config)
    draws.start_us[:] = 50
    draws.until_us[:] = 500
    whole = CONFIG.replace(sensor=(120, 80), grid=(60, 40))
    sides = SceneMaker(config, whole)(windows, draws, np.random.default_rng(0)).size[:, 0]
    at_once = np.isclose(sides, 4 + 0.8 * 12)
    assert 8 <= at_once.sum() <= len(sides) - 8
    assert (sides[~at_once] < 4 + 0.8 * 12).all() and sides.min() > 4 + 0.3 * 12
    assert sides.min() < 4 + 0.45 * 12


def test_outlines_that_are_not_known_leave_the_boxes_of_events(no_noise):
    t = np.arange(100)
    shown = events_of(t, 5 + t % 4, 3 + t % 2, t % 2)
    other = events_of(t, 9 + t % 4, 3 + t % 2, t % 2)
    square = np.full((2, 4, 2), 10.0, np.float32)
    with RecordingsWriter() as writer:
        writer.extend(Recordings.from_events([shown], [0]))
        writer.add(other, 1, "other", square, 1000)
        made = writer.finish()
    assert made.outlined_us.tolist() == [0, 1000]
    windows = Windows(made, np.arange(2), np.zeros(2, np.int64))
    rng = np.random.default_rng(3)
    sizes = {}
    for _ in range(20):
        scenes = SceneMaker(CONFIG)(windows, unchanged(2, CONFIG), rng)
        sizes |= dict(zip(scenes.label.tolist(), scenes.size.tolist(), strict=True))
    assert sizes == {0: [4.0, 2.0], 1: [0.0, 0.0]}
    with RecordingsWriter() as writer:  # they are kept with the recordings
        writer.extend(made)
        writer.extend(made)
        twice = writer.finish()
    assert twice.outlined_us.tolist() == [0, 1000] * 2
    np.testing.assert_array_equal(twice.outlines, np.tile(made.outlines, (2, 1, 1, 1)))


@pytest.mark.parametrize("wrong", [(0.0, 0.5), (0.5, 0.4), (0.5, 1.5)])
def test_sizes_that_are_no_shares_are_refused(wrong):
    with pytest.raises(ValueError, match=r"`scales` must be a range of shares within \(0, 1\]"):
        Scales(*wrong)


def test_the_sensor_that_is_cut_out_has_the_pixels_a_cell_of_the_whole_one():
    whole = CONFIG.replace(sensor=(240, 180), grid=(160, 120))
    scales = Scales(1 / 12, 1 / 3)
    cut_out = scales.cut_out(whole)
    assert (cut_out.sensor, cut_out.grid) == ((144, 144), (96, 96))
    assert scales.on_cut_out(whole) == pytest.approx((15 / 144, 60 / 144))
    assert scales.grid((240, 180)) == scales.grid((640, 480)) == (160, 120)


def test_targets_reach_as_far_as_the_objects_are_large(monkeypatch):
    """A map with a place a pixel: a small object has its nearest place, a large one has more."""
    fine = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 8, 1))
    monkeypatch.setattr(objectives, "build_network", lambda *_: fine)
    _, windows = recordings(1)
    whole = CONFIG.replace(sensor=(60, 48), grid=(60, 48))
    objects = objectives.ObjectsInScenes(
        CONFIG, windows[:0], TrainSettings(epochs=1), ("a", "b", "c"), whole
    )
    scenes = Scenes(
        np.zeros((1, 6, 48, 60)),
        np.array([0, 0]),
        np.array([2, 0]),
        np.array([[10.3, 20.0], [40.0, 20.0]]),
        np.array([[4.0, 2.0], [16.0, 8.0]]),  # extents of 5 and 20
    )
    target, weight, boxes = objects._targets(scenes)
    assert target[0, 20, 8:13].tolist() == [3, 3, 2, 3, 3]
    assert weight[0, 20, 8:14].tolist() == [1, 1, 16, 0, 1, 1]
    assert target[0, 20, 37:44].tolist() == [3, 0, 0, 0, 0, 0, 3]
    assert weight[0, 20, 34:39].tolist() == [1, 0, 0, 0, 16]
    np.testing.assert_allclose(boxes[0, 20, 10], [np.log(4), np.log(2), 0.3, 0], atol=1e-6)
    np.testing.assert_allclose(boxes[0, 19, 42], [np.log(16), np.log(8), -2, 1], atol=1e-6)


def test_the_loss_of_middles_is_in_sizes_of_the_object(monkeypatch):
    net = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 8, 1))
    monkeypatch.setattr(objectives, "build_network", lambda *_: net)
    _, windows = recordings(1)
    objects = objectives.ObjectsInScenes(
        CONFIG, windows[:0], TrainSettings(epochs=1), ("a", "b", "c")
    )
    wanted = torch.tensor([[np.log(4.0), np.log(2.0), 1.0, 0.0]], dtype=torch.float32)
    found = wanted + torch.tensor([[0.0, 0.0, 2.0, 0.1]])
    # 2 / 4 = .5 of the width is beyond the square's reach of .1, and .1 / 2 = .05 of the height not
    expected = ((0.5 - 0.05) + 0.05**2 / 0.2) / 2
    expected *= objectives.BOX_WEIGHT
    assert objects._of_boxes == 4
    assert float(objects._loss_of_boxes(found, wanted)) == pytest.approx(expected, rel=1e-5)


def test_what_a_box_has_more_than_the_cells_around_it():
    events = np.zeros((3, 20, 30))
    events[:] = 0.5  # noise
    events[1, 8:12, 10:20] += 3
    middles = np.array([[14.5, 9.5], [14.5, 9.5], [0.0, 9.5]])
    sizes = np.array([[9.0, 3.0]] * 3)
    more = module._more_than_around(events, middles, sizes)
    np.testing.assert_allclose(more, [0.0, 3 * 4 * 10, 0.0], atol=1e-9)


def test_an_object_of_any_size_that_does_not_stand_out_of_the_noise_is_not_there(no_noise):
    """Objects with noise around them, and objects with events of their own."""
    rng = np.random.default_rng(0)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    outline = np.tile(10 * corners + 20, (2, 1, 1)).astype(np.float32)
    config = CONFIG.replace(sensor=(40, 40), grid=(40, 40))
    whole = CONFIG.replace(sensor=(120, 80), grid=(120, 80))
    with RecordingsWriter() as writer:
        for k in range(20):
            t = np.sort(rng.integers(0, 1000, 120))
            x, y = rng.integers(5, 35, (2, 120))
            if k % 2:
                x[:60], y[:60] = rng.integers(15, 26, (2, 60))
            writer.add(events_of(t, x, y, t % 2), k % 2, str(k), outline, 1000)
        windows = Windows(writer.finish(), np.arange(20), np.zeros(20, np.int64))
    scenes = SceneMaker(config, whole)(windows, unchanged(20, config), np.random.default_rng(0))
    assert (scenes.label == 1).all() and len(scenes.label) > 5


def test_the_loss_of_objects_of_many_sizes_sees_nothing_less(monkeypatch):
    """A network that gives all places the same logits; by hand from its targets and weights."""
    net = torch.nn.Sequential(torch.nn.Conv2d(CONFIG.channels, 4, 1))
    logits = [0.5, 2.0, -1.0, 1.0]
    with torch.no_grad():
        net[0].weight.zero_()
        net[0].bias.copy_(torch.tensor(logits))
    monkeypatch.setattr(objectives, "build_network", lambda *_: net)
    _, windows = recordings(9)
    whole = CONFIG.replace(sensor=(60, 48), grid=(60, 48))
    objects = objectives.ObjectsInScenes(
        CONFIG, windows[:0], TrainSettings(epochs=1), ("a", "b", "c"), whole
    )
    seen = []
    targets_of = objects._targets
    monkeypatch.setattr(objects, "_targets", lambda some: seen.append(targets_of(some)) or seen[-1])
    found = objects.loss(Pipeline(CONFIG, net), windows, unchanged(9, CONFIG))
    ((target, weight, _),) = seen
    adjusted = np.array(logits) - [0, 0, 0, np.log(16 / 2)]
    losses = np.log(np.exp(adjusted).sum()) - adjusted
    expected = (losses[target] * weight).sum() / weight.sum()
    assert found.loss.item() == pytest.approx(expected, rel=1e-5)
