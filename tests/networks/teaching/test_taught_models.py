"""Models with taught classes are models like any other, and keep what they knew."""

import copy
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from deciding import key
from made import random_model, raw_model
from networks.random_spiking import random_spiking_model
from networks.teaching.lessons import CLASSES, CONFIG, of_classes, recording
from safetensors import safe_open
from torch import nn

from async_tnt import CompiledClassifier, Model, Processor, load_model
from async_tnt.networks import OnnxClassifier, to_onnx
from async_tnt.networks.models.torch_modules import exact_outputs, torch_classifier
from async_tnt.networks.teaching import teach
from async_tnt.networks.teaching.closed_form import MARGIN
from async_tnt.networks.teaching.statistics import log_sum_exp, n_components_for
from async_tnt.networks.teaching.teach import spread_order
from async_tnt.networks.teaching.window_readings import edges


def same(a: Model, b: Model) -> None:
    """Both models are the same, with all of their statistics."""
    assert (a.config, a.classes, a.network, a.record) == (b.config, b.classes, b.network, b.record)
    assert a.weights.keys() == b.weights.keys()
    assert all(a.weights[name].tobytes() == b.weights[name].tobytes() for name in a.weights)
    ours, theirs = a.statistics, b.statistics
    assert ours.margins == theirs.margins
    assert ours.moments.keys() == theirs.moments.keys()
    for name, moments in ours.moments.items():
        assert moments.count == theirs.moments[name].count
        assert moments.mean.tobytes() == theirs.moments[name].mean.tobytes()
        assert moments.scatter.tobytes() == theirs.moments[name].scatter.tobytes()


def test_it_knows_the_class_and_keeps_the_bits_of_the_other_logits(model, taught):
    assert taught.classes == ("a", "b", "c", "d")
    processor = Processor(taught, start_us=0)
    before = Processor(model, start_us=0)
    n_right = 0
    for k in range(4):
        for i in range(50, 60):
            for new, old in zip(
                (*processor.push(recording(k, i)), processor.fire()),
                (*before.push(recording(k, i)), before.fire()),
                strict=True,
            ):
                assert new.logits[:3].tobytes() == old.logits.tobytes()
                if k == 3:
                    n_right += new.label == "d"
            processor.reset()
            before.reset()
    assert n_right >= 29


def test_statistics_change_no_decision(model):
    without = replace(model, statistics=None)
    volume = np.random.default_rng(0).normal(size=CONFIG.shape).astype(np.float32)
    expected = CompiledClassifier(without)(volume)
    assert CompiledClassifier(model)(volume).tobytes() == expected.tobytes()


def test_its_logit_is_that_of_the_closed_form(model, taught):
    """r . (P^T (f - f0), 1), with features from the model itself; it lies near s +- M."""
    statistics = taught.statistics
    rows = model.features(statistics.layer)
    volume = Processor(model, start_us=0)
    volume.push(recording(3, 77)[:100])
    features = Processor(rows, start_us=0)
    features.push(recording(3, 77)[:100])
    decision = volume.fire()
    f = features.fire()["features"].reshape(1, -1)
    u = statistics.readings(f, decision.logits[None])
    from async_tnt.networks.teaching.closed_form import rows_of

    expected = float(rows_of(statistics)[0] @ np.append(u[0, :-1], 1.0))
    logit = CompiledClassifier(taught)(volume.volume())[3]
    assert logit == pytest.approx(expected, abs=1e-3)
    margin = statistics.margins["d"]
    assert logit == pytest.approx(log_sum_exp(decision.logits[None])[0] + margin, abs=margin)


def test_the_stream_equals_the_reference_at_every_event(taught):
    reference = torch_classifier(taught)
    exact = exact_outputs(taught)
    processor = Processor(taught, start_us=0)
    for event in recording(3, 5)[:60].tolist():
        processor.push(event)
        logits = processor.fire().logits
        volume = processor.volume().copy()
        with torch.inference_mode():
            expected = reference(torch.from_numpy(volume)[None])[0].numpy()
        np.testing.assert_allclose(logits, expected, atol=1e-4)
        np.testing.assert_allclose(logits, exact(volume)[0], atol=1e-4)
        assert logits.tobytes() == CompiledClassifier(taught)(volume).tobytes()


@pytest.mark.parametrize("settings", [{}, {"every_events": 7}, {"confidence": 0.5}])
def test_how_the_stream_is_cut_does_not_matter(taught, settings):
    events = np.concatenate([recording(k, 3) for k in (3, 0)])
    events["t"] = np.sort(events["t"])
    whole = [key(decision) for decision in Processor(taught, **settings).push(events)]
    rng = np.random.default_rng(0)
    for n in (1, 2, 13, 97):
        processor = Processor(taught, **settings)
        found = []
        for packet in np.split(events, range(n, len(events), n)):
            found += [key(decision) for decision in processor.push(packet)]
            if rng.random() < 0.02:
                processor = pickle.loads(pickle.dumps(processor))
            if rng.random() < 0.02:
                processor = copy.copy(processor)
        assert found == whole
    assert len(whole) >= 2


def test_a_file_keeps_everything(tmp_path, model, taught):
    for one in (model, taught, taught.without_class("b")):
        path = one.save(tmp_path / "m.safetensors")
        with safe_open(path, "numpy") as file:
            assert file.metadata()["format"] == "async_tnt 5"
        loaded = load_model(path)
        same(loaded, one)
        # and what is taught to it is the same, too
        lesson = [recording(4, i) for i in range(5)]
        same(loaded.with_class("e", lesson), one.with_class("e", lesson))
        twin = pickle.loads(pickle.dumps(one))
        same(twin, one)
    assert model.statistics.n_bytes < (tmp_path / "m.safetensors").stat().st_size


def test_a_pickle_has_no_matrices_that_can_be_computed(taught):
    without = replace(load_model("digits"), statistics=None)
    small = len(pickle.dumps(without)) + taught.statistics.n_bytes
    moments = pickle.loads(pickle.dumps(taught.statistics.moments["a"]))
    assert taught.statistics.moments["a"].second.nbytes > 0
    assert set(vars(moments)) == {"count", "mean", "scatter"}
    np.testing.assert_array_equal(moments.covariance, taught.statistics.moments["a"].covariance)
    assert len(pickle.dumps(taught)) < small


def test_a_taught_class_costs_one_product_for_each_feature(model, taught):
    n_features = len(model.statistics.center)
    assert taught.multiplications == model.multiplications + n_features
    twice = taught.with_class("e", [recording(4, i) for i in range(5)])
    assert twice.multiplications == model.multiplications + 2 * n_features


def test_a_taught_model_is_exported(taught):
    classifier = OnnxClassifier(to_onnx(taught))
    volume = np.random.default_rng(3).normal(size=CONFIG.shape).astype(np.float32)
    np.testing.assert_allclose(
        classifier(volume), CompiledClassifier(taught)(volume), rtol=1e-4, atol=1e-4
    )
    assert classifier.exported.classes == taught.classes


def test_forgetting_is_the_inverse_of_teaching_bit_for_bit(model, taught):
    same(taught.without_class("d"), model)
    lessons = {name: [recording(k, i) for i in range(5)] for k, name in ((3, "d"), (4, "e"))}
    both = model.with_class("d", lessons["d"]).with_class("e", lessons["e"])
    other = model.with_class("e", lessons["e"])
    assert both.classes == ("a", "b", "c", "d", "e")
    # the class that was taught second was told apart from the first: its record and margin differ
    forgotten = both.without_class("d")
    assert forgotten.classes == other.classes
    margin = other.statistics.margins["e"]
    assert forgotten.statistics.margins["e"] == pytest.approx(margin, rel=0.5)
    np.testing.assert_array_equal(
        forgotten.statistics.moments["e"].mean, other.statistics.moments["e"].mean
    )


def test_a_trained_class_is_forgotten(model, taught):
    fewer = taught.without_class("b")
    assert fewer.classes == ("a", "c", "d")
    assert fewer.record["forgotten"] == ["b"]
    volume = np.random.default_rng(1).normal(size=CONFIG.shape).astype(np.float32)
    logits = CompiledClassifier(fewer)(volume)
    assert logits[:2].tobytes() == CompiledClassifier(model)(volume)[[0, 2]].tobytes()
    # what was forgotten may be taught as a class of its own
    again = fewer.with_class("b", [recording(1, i) for i in range(5)])
    assert again.classes == ("a", "c", "d", "b")
    assert again.statistics.margins.keys() == {"d", "b"}
    decision, *_ = Processor(again).push(recording(1, 99))
    assert decision.label == "b"
    alone = model.without_class("a").without_class("b")
    assert alone.classes == ("c",)
    assert alone.record["forgotten"] == ["a", "b"]
    with pytest.raises(ValueError, match="`name` must not be the model's only class, got 'c'"):
        alone.without_class("c")


def test_the_record_says_what_was_taught(model, taught, monkeypatch):
    entry = taught.record["taught"]["d"]
    assert (entry["recordings"], entry["windows"]) == (6, 18)
    assert entry["margin"] == pytest.approx(taught.statistics.margins["d"], abs=1e-3)
    assert set(entry["taken"]) == set(CLASSES)
    assert all(0 <= share < 0.2 for share in entry["taken"].values())
    assert entry["left_out_right"] > 0.7
    # of a class that is harder to tell apart: so many of the nine readings of seven recordings
    hard = model.with_class("e", [recording(4, i) for i in range(20, 27)])
    entry = hard.record["taught"]["e"]
    share = entry["left_out_right"]
    assert share == pytest.approx(round(63 * share) / 63, abs=1e-5)
    assert 0 < share < 1
    # what it takes is computed for the margin that was chosen
    monkeypatch.setattr(teach, "taken", lambda row, margin, moments: margin / 1000)
    lesson = model.with_class("e", [recording(4, i) for i in range(20, 27)])
    (margin,) = lesson.statistics.margins.values()
    assert margin != MARGIN
    shares = set(lesson.record["taught"]["e"]["taken"].values())
    assert shares == {round(margin / 1000, 5)}
    assert 0 <= entry["taken_of_nothing"] <= 1


def test_the_share_that_is_taken_is_that_of_the_readings(model):
    """Told by a normal distribution, and counted in new windows; classes lie near each other."""
    base = replace(model, statistics=None).with_statistics(of_classes(n=40))
    taught = base.with_class("d", [recording(0, i) for i in range(100, 140)])
    told = taught.record["taught"]["d"]["taken"]["a"]
    classifier = CompiledClassifier(taught)
    processor = Processor(taught)
    counted = []
    for i in range(200, 260):
        decisions = processor.push(recording(0, i))
        counted += [d.logits[3] > log_sum_exp(d.logits[None, :3])[0] for d in decisions]
        processor.reset()
    assert classifier.n_classes == 4
    assert told == pytest.approx(np.mean(counted), abs=0.15)
    assert 0.1 < told < 0.9


@pytest.mark.parametrize(
    "settings",
    [
        {"transform": "tnt", "landmark": "running", "t_max": 2.0},
        {"transform": "tnt", "landmark": "regressor"},
        {"transform": "tnt", "landmark": "window"},
        {"window_events": 90, "window_us": None},
        {"representation": "count", "bins": None, "last_events": 90},
        {"representation": "count", "bins": None, "last_us": 700},
        {"last_us": 700, "bins": 4},
        {"representation": "time_surface", "bins": None},
    ],
)
def test_every_kind_of_window_is_taught(settings):
    config = CONFIG.replace(**settings)
    base = replace(random_model(config, classes=3), classes=CLASSES)
    model = base.with_statistics(of_classes(config))
    taught = model.with_class("d", [recording(3, i, config=config) for i in range(5)])
    decisions = [
        decision
        for i in range(80, 85)
        for decision in Processor(taught).push(recording(3, i, config=config))
    ] or [Processor(taught)]
    if config.slides:
        processor = Processor(taught)
        processor.push(recording(3, 80, config=config))
        decisions = [processor.fire()]
    # of four classes, by a network with random weights
    assert np.mean([decision.label == "d" for decision in decisions]) > 0.4


class OfOnePlace(nn.Module):
    """Logits of shape (3, 1, 1), by a 1x1 convolution behind a mean over all places."""

    def __init__(self):
        super().__init__()
        self.first = nn.Conv2d(2, 12, 3, 2, 1)
        self.mean = nn.AdaptiveAvgPool2d(1)
        self.last = nn.Conv2d(12, 3, 1)

    def forward(self, volume):
        return self.last(self.mean(torch.relu(self.first(volume))))


class Flat(nn.Module):
    """No map is small enough for features, and flat maps are no outputs: the hidden layer is."""

    def __init__(self):
        super().__init__()
        self.first = nn.Conv2d(2, 20, 3, padding=1)
        self.hidden = nn.Linear(20 * 16 * 20, 9)
        self.last = nn.Linear(9, 3)

    def forward(self, volume):
        x = torch.relu(self.first(volume).flatten(1))
        return self.last(torch.relu(self.hidden(x)))


@pytest.mark.parametrize("net", [OfOnePlace, Flat])
def test_other_networks_are_taught(net):
    torch.manual_seed(2)
    base = Model.from_torch(net().eval(), CONFIG, CLASSES)
    model = base.with_statistics(of_classes())
    taught = model.with_class("d", [recording(3, i) for i in range(5)]).without_class("a")
    assert taught.classes == ("b", "c", "d")
    same(taught.without_class("d"), model.without_class("a"))
    labels = [
        decision.label
        for i in range(9)
        for decision in Processor(taught).push(recording(3, 90 + i))
    ]
    assert labels.count("d") > 0.8 * len(labels)


def test_names_that_a_network_has_already_are_no_obstacle():
    net = nn.Sequential()
    net.add_module("taught", nn.Sequential(nn.Conv2d(2, 8, 3, 2, 1), nn.ReLU(), nn.Flatten()))
    net.add_module("dense", nn.Linear(8 * 8 * 10, 3))
    torch.manual_seed(0)
    model = Model.from_torch(net.eval(), CONFIG, CLASSES).with_statistics(of_classes())
    taught = model.with_class("d", [recording(3, i) for i in range(5)])
    assert taught.classes[-1] == "d"
    same(taught.without_class("d"), model)


def test_what_cannot_be_taught(model, taught):
    events = [recording(3, 0)]
    without = replace(model, statistics=None)
    with pytest.raises(ValueError, match=r"^the model has no statistics of its classes: train it"):
        without.with_class("d", events)
    with pytest.raises(ValueError, match=r"^the model has no statistics"):
        without.without_class("a")
    with pytest.raises(ValueError, match=r"^`name` must be a new class: forget the class of this"):
        taught.with_class("d", events)
    for name in ("", "\n", 3, None):
        with pytest.raises(ValueError, match=r"^`name` must be a text that can be printed"):
            model.with_class(name, events)
    with pytest.raises(ValueError, match=r"^`recordings` must have events: .*got 2 without events"):
        model.with_class("d", [None, []])
    with pytest.raises(ValueError, match=r"must have events: .*, got 0 without events$"):
        model.with_class("d", [])
    with pytest.raises(ValueError, match=r"`x` must be in \[0, 20\), got 33 at event 0"):
        model.with_class("d", [([1], [33], [3], [1])])
    with pytest.raises(ValueError, match=r"`name` must be one of the classes a, b, c, got 'e'"):
        model.without_class("e")
    with pytest.raises(
        ValueError, match=r"^statistics are of the classes a network was trained on"
    ):
        taught.with_statistics(of_classes())


def test_models_that_no_class_is_taught_to():
    for other, reason in (
        (random_spiking_model(0), "this one is of neurons"),
        (raw_model(), "this one has raw outputs, and no classes"),
        (load_model("digits-everywhere"), "this one finds objects, and a taught class has no"),
    ):
        for call in (
            lambda other=other: other.with_class("d", []),
            lambda other=other: other.without_class("d"),
            lambda other=other: other.with_statistics({}),
        ):
            with pytest.raises(NotImplementedError, match=f"^classes are taught to .*; {reason}"):
                call()


def test_recordings_for_statistics_are_of_each_class():
    base = replace(random_model(CONFIG, classes=3), classes=CLASSES)
    given = of_classes(n=1)
    with pytest.raises(ValueError, match=r"`recordings` must be of the classes a, b, c, got a, b$"):
        base.with_statistics({name: given[name] for name in "ab"})
    with pytest.raises(ValueError, match="must have events of every class, got none of c"):
        base.with_statistics({**given, "c": [None]})


class Noted:
    """A recording that notes when it is read."""

    def __init__(self, kind, number, noted):
        self.kind = kind
        self.number = number
        self.noted = noted

    def read(self):
        self.noted.append(self.number)
        return recording(self.kind, self.number)


@pytest.mark.parametrize(("most", "n_read"), [(18, 2), (20, 3), (1, 1), (1000, 12)])
def test_of_many_recordings_some_are_read_that_are_spread_evenly(model, monkeypatch, most, n_read):
    """A recording has three windows, which are read at three moments each."""
    monkeypatch.setattr(teach, "MOST_READINGS", most)
    noted = {name: [] for name in (*CLASSES, "nothing")}
    of_kinds = {
        name: [Noted(kind, number, noted[name]) for number in range(12)]
        for kind, name in enumerate(noted)
    }
    nothing = of_kinds.pop("nothing")
    again = replace(model, statistics=None).with_statistics(of_kinds, nothing).statistics
    for name in CLASSES:
        assert noted[name] == spread_order(12)[:n_read].tolist()
    assert noted["nothing"] == list(range(n_read))
    counts = {moments.count for moments in (*again.moments.values(), again.nothing)}
    assert counts == {min(most, 9 * 12)}


def test_the_readings_of_all_classes_fit_into_a_number_of_bytes(model, monkeypatch):
    """Those of three classes and of nothing."""
    n_features = len(model.statistics.center)
    for n_bytes, most in ((4 * n_features * 4 * 7, 7), (4 * n_features * 4 * 7 - 1, 6), (1, 1)):
        monkeypatch.setattr(teach, "MOST_BYTES", n_bytes)
        again = replace(model, statistics=None).with_statistics(of_classes(n=1)).statistics
        assert {moments.count for moments in again.moments.values()} == {most}
        assert again.n_components == n_components_for(n_features, 3, 3 * most)


@pytest.mark.parametrize("start_us", [None, 0])
def test_readings_are_what_a_stream_has_at_these_moments(model, start_us):
    """Bit for bit, also of events that come late, whatever recording was read before."""
    trained = teach.TrainedNetwork(CONFIG, model.network, model.weights)
    reader = trained.reader(model.statistics.layer)
    features = model.features(model.statistics.layer)
    for first_us in (7_130, 140):
        events = recording(1, 5, n=200)
        events["t"] += first_us
        events["t"][[50, 51]] = events["t"][[51, 30]]
        readings = reader.of_events(events, start_us)
        streams = [Processor(one, start_us=start_us) for one in (model, features)]
        first = 0
        for k, (stop, _) in enumerate(edges(events["t"], CONFIG, start_us)):
            for processor in streams:
                processor.push(events[first:stop])
            decision, output = (processor.fire() for processor in streams)
            assert decision.logits.tobytes() == readings.logits[k].tobytes()
            assert output["features"].tobytes() == readings.features[k].tobytes()
            first = stop
        assert first == len(events) and k + 1 == len(readings.is_end) >= 7


def test_a_weight_named_as_a_new_one_is_no_obstacle(model):
    """Although no layer has such a name."""
    old = "fc2.weight"
    new = "taught.dense.weight"
    network = json.loads(json.dumps(model.network).replace(old, new))
    weights = {new if name == old else name: w for name, w in model.weights.items()}
    base = replace(model, network=network, weights=weights)
    taught = base.with_class("d", [recording(3, i) for i in range(5)])
    volume = np.random.default_rng(1).normal(size=CONFIG.shape).astype(np.float32)
    logits = CompiledClassifier(taught)(volume)
    assert logits[:3].tobytes() == CompiledClassifier(model)(volume).tobytes()
    same(taught.without_class("d"), base)


def test_features_and_other_sensors_leave_statistics_behind(model):
    assert model.features().statistics is None
    conv = nn.Sequential(nn.Conv2d(2, 8, 3, 2, 1), nn.AdaptiveAvgPool2d(1), nn.Conv2d(8, 3, 1))
    torch.manual_seed(0)
    base = Model.from_torch(conv.eval(), CONFIG, CLASSES).with_statistics(of_classes())
    assert base.for_sensor((20, 16)).statistics is not None
    assert base.for_sensor((40, 32)).statistics is None
    taught = base.with_class("d", [recording(3, 0)])
    same(taught.for_sensor((20, 16)), taught)
    with pytest.raises(ValueError, match=r"layer 'taught.dense' \(dense\): its weight must have"):
        taught.for_sensor((40, 32))


def test_statistics_of_another_model_are_refused(model):
    statistics = model.statistics
    for wrong, message in (
        (replace(statistics, layer="nose"), "'nose' has 0"),
        (replace(statistics, trained=("a", "b")), "2 logits"),
        (replace(statistics, trained=("a", "b", "x")), "must be of the classes a, b, c, got a, b$"),
        (replace(statistics, margins={"c": -1.0}), "must have positive margins"),
        (replace(statistics, center=statistics.center + np.nan), "must be finite numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(model, statistics=wrong)
