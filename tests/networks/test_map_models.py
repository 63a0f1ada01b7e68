"""Map models find what the reference finds on the whole map, after any events and packets."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from deciding import key
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made import events_of, random_events, random_model
from tnt_reference import ObjectNumbers, objects_on_map
from torch import nn

from async_tnt import CompiledClassifier, Model, Processor, TNTConfig, TNTVolume, load_model
from async_tnt.networks import OnnxClassifier, TorchClassifier, to_onnx
from async_tnt.networks.models.torch_modules import torch_classifier

CONFIG = TNTConfig(
    sensor=(70, 40),
    grid=(70, 40),
    bins=2,
    polarity="split",
    transform="none",
    landmark="center",
    window_us=4000,
)


def map_model(config=CONFIG, n_classes=3, seed=0) -> Model:
    """A network of a few convolutions and two heads that are joined.

    At some places a class is likelier than nothing.
    """

    class Net(nn.Module):
        def __init__(self):
            super().__init__()
            self.stem = nn.Sequential(
                nn.Conv2d(config.channels, 8, 5, 2, 2), nn.ReLU(), nn.Conv2d(8, 8, 3, padding=1)
            )
            self.classes = nn.Conv2d(8, n_classes, 1)
            self.nothing = nn.Conv2d(8, 1, 1)

        def forward(self, volume):
            x = torch.relu(self.stem(volume))
            return torch.cat([self.classes(x), self.nothing(x)], 1)

    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = Net()
        with torch.no_grad():
            net.nothing.bias.add_(0.15)
            for part in (net.classes, net.nothing):
                part.weight.mul_(8)
    return Model.from_torch(net, config, [f"class {k}" for k in range(n_classes)])


def as_rows(objects):
    return [(found.index, found.probability, found.x, found.y) for found in objects]


def expected_rows(logits, places):
    """The rows of objects that the reference finds."""
    found = objects_on_map(torch.from_numpy(logits))
    return [
        (o.label, o.probability, places.x0 + places.dx * o.column, places.y0 + places.dy * o.row)
        for o in found
    ]


def assert_rows(rows, expected):
    """In the same order, also where objects are equally likely."""
    assert len(rows) == len(expected)
    if rows:
        np.testing.assert_allclose(rows, expected, rtol=1e-12, atol=1e-9)


# -- on a whole map --------------------------------------------------------------------------------

numbers = st.one_of(
    st.sampled_from([-1.0, 0.0, 0.5, 1.0, 2.0]), st.floats(-(2.0**99), 2.0**99, width=32)
)


@settings(max_examples=3 * settings.default.max_examples)
@given(
    st.tuples(st.integers(2, 4), st.integers(1, 9), st.sampled_from([2, 5, 66])).flatmap(
        lambda shape: arrays(np.float32, shape, elements=numbers)
    )
)
def test_objects_of_any_map_are_those_of_the_reference(logits):
    """The maps have many equal numbers, objects at borders, and objects in one row."""
    classes = [str(k) for k in range(len(logits) - 1)]
    processor = Processor(CONFIG, classifier=lambda volume: logits, classes=classes)
    decision = processor.fire()
    # places that nobody states divide the sensor evenly
    dy = 40 / logits.shape[1]
    dx = 70 / logits.shape[2]
    expected = [
        (o.label, o.probability, dx * (o.column + 0.5) - 0.5, dy * (o.row + 0.5) - 0.5)
        for o in objects_on_map(torch.from_numpy(logits))
    ]
    assert_rows(as_rows(decision.objects), expected)
    assert decision.logits.tobytes() == logits.tobytes()
    probabilities = [found.probability for found in decision.objects]
    assert probabilities == sorted(probabilities, reverse=True)
    assert decision.label == (decision.objects[0].label if decision.objects else None)
    assert decision.probability == (probabilities[0] if probabilities else 0.0)
    assert decision.probabilities.shape == (len(probabilities), len(logits))


def test_objects_by_hand():
    """Two classes on a map of 3 x 8 places of a sensor of 32 x 12: places are 4 pixels wide."""
    logits = np.zeros((3, 3, 8), np.float32)
    logits[2] = 1.0  # nothing
    # 3 and 1 above nothing: 1/4 of a place to the right
    logits[0, 1, 1] = 4.0
    logits[0, 1, 2] = 2.0
    # Two places, one above the other, are as likely as each other: one object, half a row below.
    logits[1, 0, 6] = 2.0
    logits[1, 1, 6] = 2.0
    config = CONFIG.replace(sensor=(32, 12), grid=(32, 12))
    decision = Processor(config, classifier=lambda volume: logits, classes=["a", "b"]).fire()
    a, b = decision.objects
    e = np.exp
    assert (a.label, a.x, a.y, a.id) == ("a", 1.5 + 4 * 1.25, 1.5 + 4, 0)
    assert a.probability == pytest.approx(e(4) / (e(4) + e(0) + e(1)))
    assert (b.label, b.x, b.y, b.id) == ("b", 1.5 + 4 * 6, 1.5 + 2, 1)
    assert decision.to_dict()["objects"][0] == {
        "id": 0,
        "label": "a",
        "probability": 0.93624,
        "x": 6.5,
        "y": 5.5,
    }
    logits[2] = 9.0
    nothing = Processor(config, classifier=lambda volume: logits, classes=["a", "b"]).fire()
    words = nothing.to_dict()
    assert (words["objects"], words["label"], words["probability"]) == ([], None, 0.0)
    assert "probabilities" not in words


def test_a_call_with_an_array_changes_no_later_objects():
    """The array comes before the first volume, and between two.

    One of the models shows objects without any event.
    """
    model = map_model()
    seeing = {**model.weights, "nothing.bias": np.float32([-1.0])}
    for tested in (model, replace(model, weights=seeing)):
        network = CompiledClassifier(tested)
        called = Processor(tested, classifier=network)
        untouched = Processor(tested)
        normal = np.random.default_rng(0).normal(size=network.shape)
        arrays = [np.zeros(network.shape), normal, np.ones(network.shape)]
        for k, array in enumerate(arrays):
            network(array.astype(np.float32))
            assert as_rows(called.fire().objects) == as_rows(untouched.fire().objects)
            events = random_events(200, seed=k, sensor=CONFIG.sensor, duration_us=1500)
            events["t"] += 1500 * k
            for one in (called, untouched):
                one.push(events)
            network(array.astype(np.float32))
            found = called.fire().objects
            assert as_rows(found) == as_rows(untouched.fire().objects) and len(found) > 2


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_map_that_is_not_finite_is_refused_until_it_is(wrong):
    logits = np.zeros((3, 4, 5), np.float32)
    logits[1, 2, 3] = wrong
    processor = Processor(CONFIG, classifier=lambda volume: logits, classes=["a", "b"])
    with pytest.raises(ValueError, match="must return finite logits"):
        processor.fire()
    logits[1, 2, 3] = 1.0
    assert len(processor.fire().objects) == 1


# -- in a stream -----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 7, 300, 5000])
def test_decisions_are_those_of_the_whole_map_however_the_stream_is_cut(size):
    """The same objects and numbers, to the bit; and on each map those of the reference."""
    model = map_model()
    events = random_events(2500, seed=size, sensor=CONFIG.sensor, duration_us=9500)
    dense = CompiledClassifier(model)

    class Whole:
        places = model.places

        def __call__(self, volume):
            return dense(volume)

    processor = Processor(model, every_events=50)
    whole = Processor(CONFIG, classifier=Whole(), classes=model.classes, every_events=50)
    expected = whole.push(events) + whole.finish()
    n_found = 0
    decisions = []
    for first in range(0, len(events), size):
        for decision in processor.push(events[first : first + size]):
            decisions.append(decision)
    decisions += processor.finish()
    assert len(decisions) == len(expected) > 50
    for ours, theirs in zip(decisions, expected, strict=True):
        assert key(ours)[:5] == key(theirs)[:5]
        assert ours.label == theirs.label
        assert ours.objects == theirs.objects
        assert ours.probabilities.tobytes() == theirs.probabilities.tobytes()
        assert_rows(as_rows(ours.objects), expected_rows(theirs.logits, model.places))
        n_found += len(ours.objects)
    assert n_found > 3 * len(decisions)


@settings(max_examples=settings.default.max_examples)
@given(
    st.integers(0, 3),
    st.lists(st.sampled_from([1, 2, 40, "array", "copy", "other"]), min_size=3, max_size=25),
)
def test_scores_and_peaks_follow_the_map(seed, script):
    """They are checked after single events, packets, whole passes, copies and another volume."""
    model = map_model(seed=seed)
    classifier = CompiledClassifier(model)
    dense = CompiledClassifier(model)
    volumes = [TNTVolume(CONFIG), TNTVolume(CONFIG)]
    tracks = Processor(model)._classifier._tracks
    for k, step in enumerate(script):
        volume = volumes[0]
        if step == "array":
            array = np.random.default_rng(k).poisson(0.05, CONFIG.shape).astype(np.float32)
            assert classifier(array).tobytes() == dense(array).tobytes()
        elif step == "copy":
            classifier = (
                pickle.loads(pickle.dumps(classifier)) if k % 2 else copy.deepcopy(classifier)
            )
        elif step == "other":
            volumes.reverse()
        else:
            volume.update(
                random_events(step, seed=k, sensor=CONFIG.sensor, duration_us=1, start_us=k)
            )
        n = classifier.locate(volumes[0], tracks, 0, False)
        logits = dense(volumes[0].array)
        assert classifier.map.tobytes() == logits.tobytes()
        rows = [(int(c), p, x, y) for x, y, p, c, *_ in classifier.reader.found[:n].tolist()]
        assert_rows(rows, expected_rows(logits, model.places))


@pytest.mark.parametrize("x", [10, 63, 64, 127, 128])
def test_a_peak_ends_where_a_larger_score_comes_beside_it(x):
    """Peaks are stored in words of 64 columns, and the places beside each other may lie in two.

    The score of a place is its number of events. One event makes a peak. Two events beside it make
    a larger one, and then the first is none. The position is the mean of both.
    """
    config = TNTConfig(sensor=(140, 5), grid=(140, 5), representation="count", polarity="unsigned")
    net = nn.Conv2d(1, 2, 1, bias=False)
    with torch.no_grad():
        net.weight[:, 0, 0, 0] = torch.tensor([1.0, 0.0])
    processor = Processor(Model.from_torch(net, config, ["a"]))
    for dx, dy in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)]:
        processor.reset()
        processor.push((10, x, 2, 1))
        (first,) = processor.fire().objects
        assert (first.x, first.y) == (x, 2)
        processor.push(([20, 30], [x + dx] * 2, [2 + dy] * 2, [1, 1]))
        (second,) = processor.fire().objects
        assert (second.x, second.y) == pytest.approx((x + dx * 2 / 3, 2 + dy * 2 / 3))


def test_fire_and_copies_leave_the_stream_as_it_is():
    model = map_model()
    events = random_events(1500, seed=3, sensor=CONFIG.sensor, duration_us=9000)
    plain = Processor(model, every_us=500)
    disturbed = Processor(model, every_us=500)
    expected = plain.push(events) + plain.finish()
    found = []
    for first in range(0, len(events), 100):
        found += disturbed.push(events[first : first + 100])
        disturbed.fire()
        disturbed = pickle.loads(pickle.dumps(disturbed)) if first % 200 else copy.copy(disturbed)
    found += disturbed.finish()
    assert [d.objects for d in found] == [d.objects for d in expected]
    plain.reset()
    assert [d.objects for d in plain.push(events) + plain.finish()] == [d.objects for d in expected]


def test_an_object_keeps_its_number_while_it_moves():
    """Two objects approach each other.

    One of them changes its class, and vanishes for less than a window.
    """
    config = CONFIG.replace(sensor=(80, 80), grid=(80, 80))
    shown = np.zeros((3, 20, 20), np.float32)  # places of 4 pixels
    processor = Processor(
        config, classifier=lambda volume: shown, classes=["a", "b"], every_events=1
    )

    def show(t, *objects):
        shown[:] = 0
        shown[2] = 1
        for label, column in objects:
            shown[label, 10, column] = 3
        (decision,) = processor.push(([t], [5], [5], [1]))
        return {round((found.x - 1.5) / 4): (found.label, found.id) for found in decision.objects}

    assert show(0, (0, 2), (1, 15)) == {2: ("a", 0), 15: ("b", 1)}
    assert show(100, (0, 5), (1, 12)) == {5: ("a", 0), 12: ("b", 1)}
    # An object of another class appears where only the first one can be.
    assert show(200, (1, 6)) == {6: ("b", 0)}
    assert show(300, (0, 7), (1, 11)) == {7: ("a", 0), 11: ("b", 1)}
    assert show(400, (0, 12)) == {12: ("a", 1)}
    assert show(500, (0, 19)) == {19: ("a", 2)}  # further than four places
    assert show(3999) == {}
    processor.push(([4600], [5], [5], [1]))  # a window and more after all but the last were seen
    assert show(4601, (0, 7)) == {7: ("a", 3)}
    processor.reset()
    assert show(0, (0, 7)) == {7: ("a", 0)}


@pytest.mark.parametrize("late_us", [0, 1])
def test_an_object_is_known_for_as_long_as_a_window_and_no_longer(late_us):
    """The reference has the same rule."""
    numbers = ObjectNumbers((4.0, 4.0), memory_us=1000, most=2, room=4)
    assert numbers.follow(10, [(10.0, 10.0)]) == [0]
    assert numbers.follow(1010 + late_us, [(10.0, 10.0)]) == [late_us]

    shown = np.zeros((2, 10, 10), np.float32)
    config = CONFIG.replace(sensor=(40, 40), grid=(40, 40), window_us=1000)
    processor = Processor(
        config, classifier=lambda volume: shown, classes=["a"], every_events=1, start_us=0
    )

    def ids(t, score):
        shown[0, 5, 5] = score
        return [
            found.id
            for decision in processor.push(([t], [5], [5], [1]))
            for found in decision.objects
        ]

    assert ids(10, 3) == [0]
    assert ids(1005, -3) == []  # at the end of the first window, and here
    assert ids(1010 + late_us, 3) == [late_us]


class OneObject:
    """A classifier that always shows one object, and says what its maps look like."""

    logits_shape = 2, 10, 10

    def __call__(self, volume):
        shown = np.zeros(self.logits_shape, np.float32)
        shown[0, 5, 5] = 3
        return shown


def test_no_number_is_given_again_by_another_classifier():
    config = CONFIG.replace(sensor=(40, 40), grid=(40, 40))
    processor = Processor(config, classifier=OneObject(), classes=["a"], every_events=1)
    ids = []
    for t in (0, 1, 2):
        (decision,) = processor.push(([t], [5], [5], [1]))
        ids += [found.id for found in decision.objects]
        if t == 1:
            processor.classifier = OneObject()
    assert ids == [0, 0, 1]


def test_maps_may_change_their_shape_from_decision_to_decision():
    config = CONFIG.replace(sensor=(40, 40), grid=(40, 40))
    finder = OneObject()
    processor = Processor(config, classifier=finder, classes=["a"])
    for side, place in ((10, 21.5), (20, 10.5), (10, 21.5)):
        finder.logits_shape = 2, side, side
        (found,) = processor.fire().objects
        assert (found.x, found.y) == pytest.approx((place, place))


WIDE = CONFIG.replace(sensor=(300, 300), grid=(300, 300), bins=1, polarity="unsigned")


class Scene:
    """A classifier whose map shows single places of one class, each with a score.

    The map has a place for each pixel.
    """

    def __init__(self):
        self.map = np.zeros((2, 300, 300), np.float32)

    def __call__(self, volume):
        return self.map

    def show(self, rows, columns, scores):
        self.map[0] = 0
        self.map[1] = 1
        self.map[0, rows, columns] = 1 + np.asarray(scores, np.float32)


@pytest.mark.parametrize("likelier", [True, False], ids=["likelier", "less likely"])
def test_a_still_object_keeps_its_number_in_noise(likelier):
    """Each decision has ten false objects, always at other places.

    Soon there were far more objects than can be remembered.
    """
    rng = np.random.default_rng(5)
    scene = Scene()
    processor = Processor(
        WIDE.replace(window_us=10**6), classifier=scene, classes=["a"], every_events=1
    )
    numbers = set()
    for k in range(300):
        rows, columns = rng.integers(0, 290, (2, 10))
        columns[abs(columns - 150) < 8] = 4  # noise is not near the object
        scene.show([150, *rows], [150, *columns], [2.0 if likelier else 0.5] + [1.0] * 10)
        (decision,) = processor.push(([1000 * k], [5], [5], [1]))
        numbers |= {
            found.id
            for found in decision.objects
            if abs(found.x - 150) < 2 and abs(found.y - 150) < 2
        }
    # Objects of noise have taken more than 1000 numbers.
    assert max(found.id for found in decision.objects) > 1000
    assert len(numbers) == 1


@pytest.mark.parametrize(("seed", "sensor"), [(0, (300, 300)), (1, (600, 300)), (2, (300, 600))])
def test_numbers_are_those_of_the_reference(seed, sensor):
    """Few objects and many, more than may be remembered, at equal distances, and after pauses.

    The map has 300 x 300 places, so that places may be twice as wide as high, or as high as wide.
    """
    rng = np.random.default_rng(seed)
    scene = Scene()
    config = WIDE.replace(sensor=sensor, grid=sensor, window_us=50_000)
    processor = Processor(config, classifier=scene, classes=["a"], every_events=1)
    reach_px = (4 * sensor[0] / 300, 4 * sensor[1] / 300)
    numbers = ObjectNumbers(reach_px, memory_us=config.window_us, most=256, room=512)
    still = rng.integers(0, 300, (2, 30))
    t_us = 0
    n_most = 0
    n_known = 0
    n_kept = 0
    for _ in range(120):
        t_us += int(rng.choice([1, 200, 3_000, 30_000, 200_000], p=[0.4, 0.3, 0.2, 0.07, 0.03]))
        n = int(rng.choice([0, 3, 40, 400]))
        some = still[:, rng.random(still.shape[1]) < 0.8] + rng.integers(-1, 2, (2, 1))
        rows, columns = np.concatenate([some, rng.integers(0, 300, (2, n))], 1).clip(0, 299)
        scene.show(rows, columns, rng.uniform(0.5, 2.0, len(rows)))
        # There is a decision on a window that closes, and one after this event.
        for decision in processor.push(([t_us], [5], [5], [1])):
            objects = decision.objects
            first = numbers.next_number
            expected = numbers.follow(decision.time_us, [(found.x, found.y) for found in objects])
            assert [found.id for found in objects] == expected
        fired = processor.fire().objects
        assert [(found.x, found.y) for found in fired] == [(found.x, found.y) for found in objects]
        n_most = max(n_most, len(objects))
        n_known = max(n_known, len(numbers.known))
        n_kept += sum(number < first for number in expected)
    assert n_most > 256 and n_known == 512 and n_kept > 1000


# -- the model -------------------------------------------------------------------------------------


def test_places_lie_in_the_middle_of_what_they_depend_on():
    """A pixel that a place depends on symmetrically.

    Only at such a pixel an impulse gives a symmetric map.
    """
    net = nn.Sequential(
        nn.Conv2d(1, 1, 5, 2, 2),
        nn.MaxPool2d(2),
        nn.Conv2d(1, 1, 3, dilation=2),
        nn.Conv2d(1, 2, 1),
    )
    config = TNTConfig(
        sensor=(120, 60),
        grid=(60, 60),
        bins=1,
        polarity="unsigned",
        transform="none",
        landmark="center",
    )
    model = Model.from_torch(net, config, ["a"])
    # rows in grid pixels: stride 2 from 0; pairs of them, 1 + 4 k; without the two at the border, 9
    # + 4 k
    places = model.places
    assert (places.y0, places.dy) == pytest.approx((9, 4))
    assert (places.x0, places.dx) == pytest.approx((9 * 119 / 59, 4 * 119 / 59))
    assert model.logits_shape == (2, 11, 11)
    # four places about each pixel 4 k
    blocks = nn.Sequential(nn.Conv2d(1, 8, 3, 4, 1), nn.PixelShuffle(2))
    model = Model.from_torch(blocks, config, ["a"])
    assert (model.places.y0, model.places.dy) == (-1, 2) and model.logits_shape == (2, 30, 30)
    # a place for each cell of a grid that is no square
    cells = Model.from_torch(nn.Conv2d(1, 2, 1), config.replace(grid=(60, 30)), ["a"])
    assert cells.places == pytest.approx((0, 119 / 59, 0, 59 / 29))
    assert load_model("digits").places is None


PIXELS = CONFIG.replace(sensor=(60, 60), grid=(60, 60), bins=1, polarity="unsigned")
"""A place of a network without stride is a pixel."""


@pytest.mark.parametrize(
    ("padding", "rows", "columns"),
    [
        # (first pixel, number of pixels) that are divided, beyond the sensor where they are padded
        ([1, 1, 1, 1], (0, 60), (0, 60)),
        ([3, 0, 0, 1], (-2, 61), (1, 59)),
    ],
)
def test_places_of_an_adaptive_pooling_divide_the_map_before_it(padding, rows, columns):
    """By 7 and by 10. Before it, a convolution of 3 x 3 keeps the middle of what it reads."""
    window = {"kernel": [3, 3], "stride": [1, 1], "padding": padding, "dilation": [1, 1]}
    conv = {"op": "conv", "name": "conv", "inputs": ["volume"], **window, "groups": 1}
    pool = {"op": "adaptive_average_pool", "name": "pool", "inputs": ["conv"], "size": [7, 10]}
    layers = [conv | {"weights": {"weight": "w"}}, pool]
    weights = {"w": np.ones((2, 1, 3, 3), np.float32)}
    places = Model(PIXELS, weights, ["a"], network={"classifier": layers}).places
    # the middle of the pixels first, ..., first + size - 1
    for (first, n), parts, found in (
        (rows, 7, (places.y0, places.dy)),
        (columns, 10, (places.x0, places.dx)),
    ):
        size = n / parts
        assert found == pytest.approx((first + (size - 1) / 2, size))


PADDING = {"padding": [1, 2, 3, 4]}
"""Above, to the left, below, and to the right."""


@pytest.mark.parametrize(
    ("op", "parameters", "rows", "columns"),
    [
        ("zero_pad", PADDING, (-1, 64), (-2, 66)),
        ("edge_pad", PADDING, (-1, 64), (-2, 66)),
        ("depth_to_space", {"block": 2}, (0, 60), (0, 60)),
        ("bilinear_corners", {"block": 2}, (0, 60), (0, 60)),
        ("relu", {}, (0, 60), (0, 60)),
    ],
)
def test_places_behind_a_layer_that_makes_a_map_larger(op, parameters, rows, columns):
    """An adaptive pooling to 4 x 6 places divides it; (first pixel, number of pixels) are told."""
    one_place = {"kernel": [1, 1], "stride": [1, 1], "padding": [0] * 4, "dilation": [1, 1]}
    conv = {"op": "conv", "name": "conv", "inputs": ["volume"], **one_place, "groups": 1}
    layers = [
        conv | {"weights": {"weight": "w"}},
        {"op": op, "name": "larger", "inputs": ["conv"], **parameters},
        {"op": "adaptive_average_pool", "name": "pool", "inputs": ["larger"], "size": [4, 6]},
    ]
    n_filters = 8 if op == "depth_to_space" else 2
    weights = {"w": np.ones((n_filters, 1, 1, 1), np.float32)}
    places = Model(PIXELS, weights, ["a"], network={"classifier": layers}).places
    assert (places.dy, places.dx) == pytest.approx((rows[1] / 4, columns[1] / 6))
    assert places.y0 == pytest.approx(rows[0] + (places.dy - 1) / 2)
    assert places.x0 == pytest.approx(columns[0] + (places.dx - 1) / 2)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_places_are_those_of_the_first_input(order):
    """The rows of one lie at 0, 2, ..., those of the other at 1/2, 5/2, ..."""

    class Two(nn.Module):
        def __init__(self):
            super().__init__()
            self.a = nn.Conv2d(1, 1, 3, 2, 1)
            self.b = nn.Conv2d(1, 1, 2, 2)

        def forward(self, volume):
            maps = self.a(volume), self.b(volume)
            return torch.cat([maps[k] for k in order], 1)

    places = Model.from_torch(Two(), PIXELS, ["a"]).places
    assert (places.y0, places.dy) == (order[0] / 2, 2)


def test_places_of_another_network_divide_the_sensor_evenly():
    """6 columns of 10 pixels, 3 rows of 12: the third column begins at 20, the second row at 12."""
    logits = np.full((2, 3, 6), -5.0, np.float32)
    logits[1] = 0.0
    logits[0, 1, 2] = 5.0
    config = PIXELS.replace(sensor=(60, 36), grid=(60, 36))
    processor = Processor(config, classifier=lambda volume: logits, classes=["a"])
    (found,) = processor.fire().objects
    assert (found.x, found.y) == pytest.approx((20 + 4.5, 12 + 5.5))


@pytest.mark.parametrize("by", ["array", "refresh"])
def test_a_map_that_was_answered_is_not_changed_by_the_next_call(by):
    classifier = CompiledClassifier(map_model())
    volumes = [TNTVolume(CONFIG), TNTVolume(CONFIG)]
    volumes[1].update(random_events(900, sensor=CONFIG.sensor, duration_us=3000))

    def answer(volume):
        return classifier(volume.array) if by == "array" else classifier.refresh(volume)

    first = answer(volumes[0])
    before = first.copy()
    second = answer(volumes[1])
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(first, before)
    first[:] = 0  # it is the caller's
    np.testing.assert_array_equal(answer(volumes[0]), before)


def test_a_file_a_torch_module_and_onnx_find_the_same(tmp_path):
    model = map_model()
    volume = TNTVolume(CONFIG)
    volume.update(random_events(900, seed=4, sensor=CONFIG.sensor, duration_us=3000))
    saved = load_model(model.save(tmp_path / "map.safetensors"))
    expected = CompiledClassifier(model).refresh(volume)
    assert CompiledClassifier(saved).refresh(volume).tobytes() == expected.tobytes()
    events = random_events(900, seed=5, sensor=CONFIG.sensor, duration_us=3000)
    exported = OnnxClassifier(to_onnx(model))
    engines = (
        TorchClassifier(torch_classifier(model), places=model.places),
        exported,
        copy.copy(exported),
    )
    compiled = Processor(model)
    compiled.push(events)
    for engine in engines:
        assert engine(volume.array).shape == model.logits_shape
        other = Processor(CONFIG, classifier=engine, classes=model.classes)
        other.push(events)
        found = other.fire().objects
        same = compiled.fire().objects
        assert len(found) == len(same) > 3
        for a, b in zip(sorted(as_rows(found)), sorted(as_rows(same)), strict=True):
            assert a == pytest.approx(b, abs=1e-3)


def test_a_map_of_another_program_is_a_map_model_or_a_raw_output(tmp_path):
    proto = to_onnx(map_model())
    del proto.metadata_props[:]
    path = tmp_path / "map.onnx"
    path.write_bytes(proto.SerializeToString())
    assert load_model(path, config=CONFIG, classes=["0", "1", "2"]).places == map_model().places
    assert load_model(path, config=CONFIG).output_shapes == {"logits": map_model().logits_shape}
    with pytest.raises(ValueError, match=f"^{path}: the network must compute 2 logits"):
        load_model(path, config=CONFIG, classes=["0", "1"])


def test_the_same_network_for_another_sensor():
    """What it finds near a place does not depend on the sensor, away from the border."""
    model = map_model()
    large = model.for_sensor((140, 90))
    assert large.config.grid == (140, 90) and large.logits_shape == (4, 45, 70)
    events = random_events(500, seed=6, sensor=(30, 30), duration_us=3000)
    moved = events_of(events["t"], events["x"] + 20, events["y"] + 4, events["p"])
    far = events_of(events["t"], events["x"] + 80, events["y"] + 44, events["p"])
    maps = []
    for one, stream in ((model, moved), (large, far)):
        volume = TNTVolume(one.config)
        volume.update(stream)
        maps.append(CompiledClassifier(one).refresh(volume))
    assert maps[0][:, 2:17, 10:25].tobytes() == maps[1][:, 22:37, 40:55].tobytes()
    with pytest.raises(ValueError, match=r"layer 'fc1' \(dense\): its weight must have shape"):
        random_model(CONFIG).for_sensor((64, 64))
    as_large = Model.from_torch(
        nn.Sequential(nn.ReLU(), nn.AdaptiveAvgPool2d((None, None))), CONFIG, ["a", "b", "c"]
    )
    assert as_large.for_sensor((140, 90)).logits_shape == (4, 90, 140)


@pytest.mark.parametrize(
    "sensor, grid",
    [
        ((100, 100), (34, 34)),
        ((52, 103), (18, 35)),  # 17.68 and 35.02 are rounded
        ((50, 53), (17, 18)),
        ((2, 7), (2, 2)),  # never less than two
    ],
)
def test_the_grid_of_another_sensor_has_its_scale(sensor, grid):
    """34 places for 100 pixels."""
    config = PIXELS.replace(sensor=(100, 100), grid=(34, 34))
    pixelwise = nn.Sequential(nn.Conv2d(1, 2, 1))
    model = Model.from_torch(pixelwise, config, ["a"]).for_sensor(sensor)
    assert (model.config.sensor, model.config.grid) == (sensor, grid)
    width, height = grid
    assert model.logits_shape == (2, height, width)


@pytest.fixture
def counting():
    """A model by share whose map is the volume of counts, with a place a cell."""
    config = PIXELS.replace(sensor=(48, 24), grid=(48, 24), polarity="split")
    counts = nn.Conv2d(2, 2, 1, bias=False)
    with torch.no_grad():
        counts.weight.copy_(torch.eye(2)[:, :, None, None])
    return replace(Model.from_torch(counts, config, ["a"]), by_share=True)


def a_turn_of_all_pixels(sensor):
    """An event of each pixel."""
    width, height = sensor
    y, x = (column.ravel() for column in np.mgrid[:height, :width])
    return events_of(np.arange(x.size) // 64, x, y, np.ones(x.size, int))


@pytest.mark.parametrize("sensor", [(96, 48), (640, 320)])
def test_by_share_the_cells_stay_and_count_means_over_pixels(counting, sensor):
    model = counting.for_sensor(sensor)
    assert (model.config.sensor, model.config.grid) == (sensor, (48, 24))
    volume = TNTVolume(model.config)
    volume.update(a_turn_of_all_pixels(sensor))
    on = CompiledClassifier(model).refresh(volume)[0]
    # cells at the border have fewer pixels
    assert on[4:-4, 4:-4].mean() == pytest.approx(1.0, rel=0.01)
    again = model.for_sensor((48, 24))
    assert len(again.network["classifier"]) == len(model.network["classifier"])
    own = TNTVolume(again.config)
    own.update(random_events(300, sensor=(48, 24), duration_us=900))
    found = CompiledClassifier(again).refresh(own)
    np.testing.assert_allclose(found, CompiledClassifier(counting).refresh(own), rtol=1e-6)


@pytest.mark.parametrize(
    "sensor, grid",
    [((48, 24), (48, 24)), ((346, 260), (32, 24)), ((1280, 720), (40, 24)), ((9, 90), (24, 240))],
)
def test_by_share_the_grid_has_as_many_cells_along_the_shorter_side(counting, sensor, grid):
    """Both sides are multiples of 8. For its own sensor it stays the model that it is."""
    model = counting.for_sensor(sensor)
    assert model.config.grid == grid
    assert (model is counting) == (sensor == counting.config.sensor)


@pytest.mark.parametrize(
    "sensor, grid, wide",
    [((48, 24), (44, 22), (48, 24)), ((40, 1), (40, 1), (8, 8)), ((1, 40), (1, 40), (8, 8))],
    ids=str,
)
def test_by_share_any_grid_stays_for_its_own_sensor_and_serves_another(sensor, grid, wide):
    """A grid may have been chosen by hand, or be a line."""
    config = CONFIG.replace(
        sensor=sensor, grid=grid, representation="count", bins=None, polarity="unsigned"
    )
    model = replace(Model.from_torch(nn.Conv2d(1, 2, 1), config, ["a"]), by_share=True)
    assert model.for_sensor(sensor) is model
    assert model.for_sensor((160, 80)).config.grid == wide


def test_a_stream_through_a_model_by_share_has_the_bits_of_whole_maps(counting, tmp_path):
    path = counting.save(tmp_path / "m.safetensors")
    loaded = load_model(path)
    assert loaded.by_share and not load_model(map_model().save(path)).by_share
    model = loaded.for_sensor((100, 60))
    processor = Processor(model)
    volume = TNTVolume(model.config)
    for seed in range(3):
        events = random_events(200, seed=seed, sensor=(100, 60), duration_us=300)
        events["t"] += 300 * seed
        processor.push(events)
        volume.update(events)
        expected = CompiledClassifier(model)(volume.array)
        assert processor.fire().logits.tobytes() == expected.tobytes()


def test_an_exported_model_is_by_share_when_it_is_read_again(counting, tmp_path):
    wide = counting.for_sensor((100, 60))
    path = tmp_path / "m.onnx"
    path.write_bytes(to_onnx(wide).SerializeToString())
    again = load_model(path)
    assert again.by_share
    assert again.for_sensor((48, 24)).config.grid == wide.for_sensor((48, 24)).config.grid


def test_only_a_model_of_objects_knows_them_by_share():
    with pytest.raises(ValueError, match="`by_share` is for a model that finds objects"):
        replace(random_model(CONFIG), by_share=True)
    with pytest.raises(TypeError, match="`by_share` must be a bool, got 1"):
        replace(map_model(), by_share=1)
    assert not replace(map_model(), by_share=True).features().by_share


def test_a_sensor_has_two_sides():
    for by_share in (False, True):
        with pytest.raises(
            ValueError, match=r"`sensor` must be \(width, height\), got \(70, 40, 2"
        ):
            replace(map_model(), by_share=by_share).for_sensor((70, 40, 2))


def test_what_a_map_model_refuses():
    model = map_model()
    with pytest.raises(ValueError, match="needs transform='none'"):
        Model(CONFIG.replace(transform="tnt"), model.weights, model.classes, network=model.network)
    with pytest.raises(
        ValueError, match=r"4 logits, one for each class, or a map of 5 channels.*got \(4, 20, 35\)"
    ):
        Model(CONFIG, model.weights, (*model.classes, "one more"), network=model.network)
    two_places = nn.Sequential(nn.AdaptiveAvgPool2d((1, 2)), nn.Conv2d(4, 3, 1))
    with pytest.raises(ValueError, match=r"or a map of 4 channels.*got \(3, 1, 2\)"):
        Model.from_torch(two_places, CONFIG, ["a", "b", "c"])  # a map without one for nothing
    with pytest.raises(ValueError, match="`confidence` needs one answer for the window"):
        Processor(model, confidence=0.9)
    processor = Processor(model, every_us=100)
    with pytest.raises(ValueError, match="`confidence` needs one answer"):
        processor.confidence = 0.9
    assert processor.confidence is None
    other = Processor(CONFIG, classifier=lambda volume: [1.0, 0.0, 0.0], confidence=0.9)
    with pytest.raises(ValueError, match="`confidence` needs one answer"):
        other.classifier = CompiledClassifier(model)
    assert other.fire().label == "0"
    # known to be one from its first answer on
    other.classifier = TorchClassifier(torch_classifier(model))
    with pytest.raises(ValueError, match="`confidence` needs one answer"):
        other.push_one(0, 3, 3, 1)
    larger = CONFIG.replace(sensor=(140, 80))
    with pytest.raises(
        ValueError, match=r"must be for the sensor \(140, 80\), in whose pixels objects stand"
    ):
        Processor(larger, classifier=CompiledClassifier(model), classes=model.classes)
    with pytest.raises(
        ValueError, match="must return 4 channels, one more than classes, or 6 or 8, got 3"
    ):
        Processor(CONFIG, classifier=lambda volume: np.zeros((3, 2, 2)), classes=list("abc")).fire()
    one_place = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(4, 4, 1))
    with pytest.raises(ValueError, match=r"must compute 3 logits, .* got \(4, 1, 1\)"):
        # This is no map: a name is missing.
        Model.from_torch(one_place, CONFIG, ["a", "b", "c"])
    for classes in ("abcd", {"a", "b", "c", "d"}):
        with pytest.raises(TypeError, match="`classes` must be a tuple or list of names"):
            Model.from_torch(one_place, CONFIG, classes)
