"""Map models that say how large objects are: their boxes are those of the reference."""

import os
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from deciding import key
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made import random_events
from tnt_reference import ObjectNumbers, box_overlap, boxes_on_map, objects_on_map
from torch import nn

from async_tnt import CompiledClassifier, Model, Processor, TNTConfig, load_model

CONFIG = TNTConfig(
    sensor=(70, 40),
    grid=(70, 40),
    representation="count",
    polarity="split",
    window_us=4000,
)

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "30"))
"""Number of random networks. ASYNC_TNT_FUZZ_CASES makes it a long run."""


def box_model(
    config=CONFIG,
    n_classes=3,
    seed=0,
    *,
    channels=8,
    kernel=5,
    stride=2,
    of_boxes=2,
    two_levels=False,
):
    """A network of a few convolutions, a head of classes and one of boxes.

    of_boxes : 2 for sizes, 4 for sizes and middles.
    two_levels : whether a map of half the size is spread and added, as in a feature pyramid. The
        sides of the map must be even.
    """

    class Net(nn.Module):
        def __init__(self):
            super().__init__()
            self.stem = nn.Sequential(
                nn.Conv2d(config.channels, channels, kernel, stride, kernel // 2),
                nn.ReLU(),
                nn.Conv2d(channels, channels, 3, padding=1),
            )
            self.coarse = nn.Sequential(
                nn.MaxPool2d(2),
                nn.Conv2d(channels, 4 * channels, 3, padding=1),
                nn.PixelShuffle(2),
            )
            self.logits = nn.Conv2d(channels, n_classes + 1, 1)
            self.boxes = nn.Conv2d(channels, of_boxes, 1)

        def forward(self, volume):
            x = self.stem(volume)
            if two_levels:
                x = x + self.coarse(torch.relu(x))
            x = torch.relu(x)
            return torch.cat([self.logits(x), self.boxes(x)], 1)

    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = Net()
        with torch.no_grad():
            net.logits.bias[-1] += 0.15
            net.logits.weight.mul_(8)
            net.boxes.weight.mul_(8)
    return Model.from_torch(net, config, [f"class {k}" for k in range(n_classes)])


def as_rows(objects):
    return [(o.index, o.probability, o.x, o.y, o.width, o.height) for o in objects]


def expected_rows(maps, places, has_places):
    scale = (places.dx, places.dy)
    found = boxes_on_map(torch.from_numpy(maps), scale, has_places=has_places)
    return [
        (
            o.label,
            o.probability,
            places.x0 + places.dx * o.column,
            places.y0 + places.dy * o.row,
            places.dx * o.width,
            places.dy * o.height,
        )
        for o in found
    ]


def assert_rows(rows, expected):
    """In the same order, also where objects are equally likely."""
    assert len(rows) == len(expected)
    if rows:
        np.testing.assert_allclose(rows, expected, rtol=1e-9, atol=1e-9)


def test_boxes_by_hand():
    """Two classes on 3 x 8 places of a sensor of 32 x 12: places are 4 pixels wide and high."""
    maps = np.zeros((5, 3, 8), np.float32)
    maps[2] = 1.0  # nothing
    maps[0, 1, 1] = 4.0
    maps[3, 1, 1] = np.log(2.0)
    maps[4, 1, 1] = np.log(0.5)
    maps[1, 1, 6] = 3.0
    maps[3, 1, 6] = 99.0  # limited
    maps[4, 1, 6] = -99.0
    config = CONFIG.replace(sensor=(32, 12), grid=(32, 12))
    decision = Processor(config, classifier=lambda volume: maps, classes=["a", "b"]).fire()
    a, b = decision.objects
    assert (a.label, a.x, a.y) == ("a", 5.5, 5.5)
    assert (a.width, a.height) == pytest.approx((8.0, 2.0))
    assert a.box == pytest.approx((1.5, 4.5, 9.5, 6.5))
    assert a.to_dict()["box"] == [1.5, 4.5, 9.5, 6.5]
    assert (b.width, b.height) == pytest.approx((4 * np.exp(10), 4 * np.exp(-10)))
    assert decision.probabilities.shape == (2, 3)
    without = Processor(config, classifier=lambda volume: maps[:3], classes=["a", "b"]).fire()
    assert [thing.box for thing in without.objects] == [None, None]
    assert "box" not in without.objects[0].to_dict()
    assert [(o.x, o.y, o.id) for o in without.objects] == [(o.x, o.y, o.id) for o in (a, b)]


@pytest.mark.parametrize(
    "second, apart, n_listed",
    [
        # boxes of 4 x 4 places, whose middles are so many columns apart: (4 - d) / (4 + d) overlap
        (0, 2, 2),
        (0, 1, 1),
        (1, 1, 2),
    ],
)
def test_an_object_that_overlaps_a_likelier_one_of_its_class_is_left_out(second, apart, n_listed):
    maps = np.zeros((5, 9, 9), np.float32)
    maps[2] = 1.0
    maps[3:] = np.log(4.0)
    # a row between them, so that both are peaks; they are 2 rows apart
    maps[0, 3, 3] = 5.0
    maps[second, 3, 3 + 2 * apart] = 3.0
    maps[3:, 3, :] = np.log(4.0 * 2)
    config = CONFIG.replace(sensor=(36, 36), grid=(36, 36))
    decision = Processor(config, classifier=lambda volume: maps, classes=["a", "b"]).fire()
    sides = torch.tensor([8.0, 8.0])
    overlap = box_overlap(torch.zeros(2), sides, torch.tensor([2.0 * apart, 0.0]), sides)
    assert bool(overlap > 0.5) is (apart == 1)
    assert len(decision.objects) == n_listed


def test_the_middle_of_a_box_by_hand():
    """Places are 4 pixels wide and high; that of the peak, (1, 1), is at (5.5, 5.5)."""
    maps = np.zeros((7, 3, 8), np.float32)
    maps[2] = 1.0  # nothing
    maps[0, 1, 1] = 4.0
    maps[0, 1, 2] = 3.0  # without the last two channels the object would lie between both
    maps[3:, 1, 1] = np.log(2.0), np.log(0.5), 0.75, -0.25
    maps[3:, 1, 2] = 1.0
    maps[1, 1, 6] = 3.0
    maps[5:, 1, 6] = 99.0, -99.0  # limited
    config = CONFIG.replace(sensor=(32, 12), grid=(32, 12))
    decision = Processor(config, classifier=lambda volume: maps, classes=["a", "b"]).fire()
    a, b = decision.objects
    assert (a.label, a.x, a.y) == ("a", 5.5 + 3.0, 5.5 - 1.0)
    assert a.box == pytest.approx((4.5, 3.5, 12.5, 5.5))
    assert (b.label, b.x, b.y) == ("b", 25.5 + 40.0, 5.5 - 40.0)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("channel", [2, 3, 4, 5, 6])
def test_sizes_that_are_not_finite_are_refused_until_they_are(wrong, channel):
    maps = np.zeros((5 if channel < 5 else 7, 4, 5), np.float32)
    maps[channel, 0, 0] = wrong
    maps[1, 2, 3] = 2.0
    processor = Processor(CONFIG, classifier=lambda volume: maps, classes=["a", "b"])
    with pytest.raises(ValueError, match="must return finite logits"):
        processor.fire()
    maps[channel, 0, 0] = 0.0
    assert len(processor.fire().objects) == 1


numbers = st.one_of(st.sampled_from([-1.0, 0.0, 0.5, 1.0, 2.0]), st.floats(-99.0, 99.0, width=32))


@pytest.mark.parametrize("of_boxes", [2, 4])
@settings(max_examples=2 * settings.default.max_examples)
@given(
    maps=st.tuples(st.integers(6, 8), st.integers(1, 9), st.sampled_from([2, 5, 66])).flatmap(
        lambda shape: arrays(np.float32, shape, elements=numbers)
    )
)
def test_boxes_of_any_map_are_those_of_the_reference(maps, of_boxes):
    classes = [str(k) for k in range(len(maps) - 1 - of_boxes)]
    decision = Processor(CONFIG, classifier=lambda volume: maps, classes=classes).fire()
    dy = 40 / maps.shape[1]
    dx = 70 / maps.shape[2]
    found = boxes_on_map(torch.from_numpy(maps), (dx, dy), has_places=of_boxes == 4)
    probabilities = [thing.probability for thing in decision.objects]
    assert probabilities == sorted(probabilities, reverse=True)
    expected = [
        (
            o.label,
            o.probability,
            dx * (o.column + 0.5) - 0.5,
            dy * (o.row + 0.5) - 0.5,
            dx * o.width,
            dy * o.height,
        )
        for o in found
    ]
    assert_rows(as_rows(decision.objects), expected)


class Whole:
    """A classifier that computes a model's whole map each time."""

    def __init__(self, model):
        self.places = model.places
        self._dense = CompiledClassifier(model)

    def __call__(self, volume):
        return self._dense(volume)


def assert_stream_equals_whole_maps(model, events, size):
    """To the bit, and on each map those of the reference. Returns how many objects there were."""
    processor = Processor(model, every_events=50)
    whole = Processor(model.config, classifier=Whole(model), classes=model.classes, every_events=50)
    expected = whole.push(events) + whole.finish()
    decisions = []
    for first in range(0, len(events), size):
        decisions += processor.push(events[first : first + size])
    decisions += processor.finish()
    assert len(decisions) == len(expected)
    n_found = 0
    of_boxes = model.logits_shape[0] - len(model.classes) - 1
    for ours, theirs in zip(decisions, expected, strict=True):
        assert key(ours)[:5] == key(theirs)[:5]
        assert ours.objects == theirs.objects
        assert ours.probabilities.tobytes() == theirs.probabilities.tobytes()
        if not has_near_ties(theirs.logits[:-of_boxes]):
            rows = expected_rows(theirs.logits, model.places, of_boxes == 4)
            assert_rows(as_rows(ours.objects), rows)
        n_found += len(ours.objects)
    return n_found


def has_near_ties(logits):
    """Whether two objects are so nearly as likely that rounding decides which comes first."""
    found = objects_on_map(torch.from_numpy(logits))
    apart = -np.diff([thing.probability for thing in found])
    return bool(((apart > 0) & (apart < 1e-12)).any())


@pytest.mark.parametrize("of_boxes", [2, 4])
@pytest.mark.parametrize("size", [1, 7, 300, 5000])
def test_decisions_are_those_of_the_whole_map_however_the_stream_is_cut(size, of_boxes):
    events = random_events(2500, seed=size, sensor=CONFIG.sensor, duration_us=9500)
    assert assert_stream_equals_whole_maps(box_model(of_boxes=of_boxes), events, size) > 150


def random_box_model(rng, seed):
    """A network with boxes on random windows of counts or bins, perhaps on a coarser grid."""
    sensor = (8 * int(rng.integers(2, 12)), 8 * int(rng.integers(2, 8)))
    two_levels = bool(rng.random() < 0.5)
    if not two_levels:
        sensor = (sensor[0] - int(rng.integers(0, 5)), sensor[1] - int(rng.integers(0, 5)))
    length_us = 60 * int(rng.integers(8, 84))  # a multiple of any number of bins
    windows = {"representation": "count", "window_us": length_us}
    kind = rng.integers(4)
    if kind == 1:
        windows = {"representation": "count", "last_us": length_us}
    if kind == 2:
        windows = {"representation": "volume", "transform": "none", "window_us": length_us}
    if kind == 3:
        windows = {"representation": "volume", "transform": "none", "last_us": length_us}
    if kind >= 2:
        windows["bins"] = int(rng.integers(1, 6))
    grid = sensor
    if "window_us" in windows and rng.random() < 0.3:
        grid = (8 * max(2, sensor[0] // 16), 8 * max(2, sensor[1] // 16))
    polarity = str(rng.choice(["split", "unsigned"]))
    config = TNTConfig(sensor=sensor, grid=grid, polarity=polarity, **windows)
    model = box_model(
        config,
        int(rng.integers(1, 6)),
        seed,
        channels=int(rng.choice([2, 4, 9])),
        kernel=int(rng.choice([3, 5])),
        stride=int(rng.choice([1, 2, 4])),
        of_boxes=int(rng.choice([2, 4])),
        two_levels=two_levels,
    )
    if "window_us" in windows and rng.random() < 0.3:
        larger = (2 * sensor[0], 2 * sensor[1])
        model = replace(model, by_share=True).for_sensor(larger)
    return model


def test_random_networks():
    """Bits, however the stream is cut: with one level or two, on a sensor of another size."""
    n_found = 0
    for seed in range(CASES):
        rng = np.random.default_rng(seed)
        model = random_box_model(rng, seed)
        assert model.places is not None
        n = int(rng.integers(1, 400))
        sensor = model.config.sensor
        events = random_events(n, seed=seed, sensor=sensor, duration_us=6_000)
        size = int(rng.integers(1, 120))
        n_found += assert_stream_equals_whole_maps(model, events, size)
    assert n_found > 10 * CASES


class Scene:
    """A classifier whose map shows single places of one class, each with a score and a size."""

    def __init__(self):
        self.map = np.zeros((4, 300, 300), np.float32)

    def __call__(self, volume):
        return self.map

    def show(self, rows, columns, scores, widths, heights):
        self.map[0] = 0
        self.map[1] = 1
        self.map[0, rows, columns] = 1 + np.asarray(scores, np.float32)
        self.map[2, rows, columns] = np.log(widths)
        self.map[3, rows, columns] = np.log(heights)


@pytest.mark.parametrize("seed", [0, 1])
def test_ids_follow_boxes_as_in_the_reference(seed):
    """Few and many objects of all sizes, which move by more than points may, and after pauses."""
    rng = np.random.default_rng(seed)
    scene = Scene()
    config = CONFIG.replace(sensor=(600, 300), grid=(600, 300), window_us=50_000)
    processor = Processor(config, classifier=scene, classes=["a"], every_events=1)
    numbers = ObjectNumbers((8.0, 4.0), memory_us=50_000, most=256, room=512)
    still = rng.integers(0, 300, (2, 30))
    sides = rng.uniform(1, 40, (2, 30))
    t_us = 0
    n_far = 0
    for _ in range(100):
        t_us += int(rng.choice([1, 3_000, 30_000, 200_000], p=[0.5, 0.4, 0.07, 0.03]))
        n = int(rng.choice([0, 3, 40, 300]))
        some = rng.random(still.shape[1]) < 0.8
        rows, columns = np.concatenate(
            [still[:, some] + rng.integers(-6, 7, (2, 1)), rng.integers(0, 300, (2, n))], 1
        ).clip(0, 299)
        widths, heights = np.concatenate([sides[:, some], rng.uniform(0.1, 20, (2, n))], 1)
        scene.show(rows, columns, rng.uniform(0.5, 2.0, len(rows)), widths, heights)
        for decision in processor.push(([t_us], [5], [5], [1])):
            objects = decision.objects
            before = {known.number: known for known in numbers.known}
            expected = numbers.follow(
                decision.time_us,
                [(found.x, found.y) for found in objects],
                [(found.width, found.height) for found in objects],
            )
            assert [found.id for found in objects] == expected
            for found in objects:
                known = before.get(found.id)
                if known is not None:
                    n_far += abs(known.x - found.x) > 8 or abs(known.y - found.y) > 4
    assert n_far > 100  # points alone would have lost these


def test_a_model_with_boxes_is_kept_in_a_file_copied_and_moved_to_another_sensor(tmp_path):
    model = box_model()
    assert model.logits_shape[0] == 6
    loaded = load_model(model.save(tmp_path / "m.safetensors"))
    larger = loaded.for_sensor((140, 40))
    assert larger.logits_shape[0] == 6 and larger.places.dx == model.places.dx
    events = random_events(900, sensor=CONFIG.sensor, duration_us=3_900)
    expected = Processor(model)
    expected.push(events)
    found = Processor(loaded)
    found.push(events[:400])
    found = pickle.loads(pickle.dumps(found))
    found.push(events[400:])
    assert found.fire().objects == expected.fire().objects != ()


@pytest.mark.parametrize("of_boxes", [2, 4])
def test_an_exported_model_with_boxes(tmp_path, of_boxes):
    onnx = pytest.importorskip("onnx", reason="needs the extra `onnx`")
    pytest.importorskip("onnxruntime", reason="needs the extra `onnx`")
    from async_tnt.networks import OnnxClassifier, to_onnx

    model = box_model(of_boxes=of_boxes)
    onnx.save(to_onnx(model), tmp_path / "m.onnx")
    classifier = OnnxClassifier(tmp_path / "m.onnx")
    assert classifier.n_classes == 3 and classifier.classes == model.classes
    processor = Processor(model.config, classifier=classifier, classes=classifier.classes)
    expected = Processor(model)
    events = random_events(900, sensor=CONFIG.sensor, duration_us=3_900)
    processor.push(events)
    expected.push(events)
    found = processor.fire().objects
    assert len(found) > 2
    np.testing.assert_allclose(
        as_rows(found), as_rows(expected.fire().objects), rtol=1e-3, atol=1e-3
    )


def test_what_is_refused():
    model = box_model()
    with pytest.raises(ValueError, match="or of 5, with two more for the width and height of obj"):
        replace(model, classes=("a", "b"))
