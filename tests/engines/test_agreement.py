"""All engines give the compiled network's logits and landmarks."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made import nasty_streams, random_events, random_model, random_regressor_model

from async_tnt import CompiledClassifier, CompiledRegressor, Model, Processor, TNTConfig, TNTVolume, load_model
from async_tnt.checking.equality import closed_volumes
from async_tnt.engines import choose_engine
from async_tnt.networks.onnx_export import regressor_to_onnx, to_onnx
from async_tnt.networks.onnx_network import OnnxClassifier, OnnxRegressor
from async_tnt.networks.torch_modules import torch_classifier
from async_tnt.networks.torch_network import TorchClassifier
from async_tnt.sources.files.recording import open_recording, sample_recordings

pytest.importorskip("onnx", reason="onnx is not installed (extra `onnx`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `onnx`)")

CASES = [  # grid, bins, polarity, widths, classes
    ((34, 34), 9, "signed", (16, 32, 64), 10),
    ((34, 34), 9, "split", (16, 32, 64), 10),
    ((32, 48), 5, "signed", (8, 12, 20), 2),
    ((35, 33), 3, "unsigned", (5, 7, 3), 4),
    ((4, 4), 1, "signed", (1, 1, 1), 1),
    ((7, 5), 2, "signed", (3, 2, 9), 101),
]


def made(grid, bins, polarity, widths, classes, seed=3):
    config = TNTConfig(sensor=grid, grid=grid, bins=bins, polarity=polarity, t_max=2.0)
    return random_model(config, classes=classes, widths=widths, seed=seed)


def assert_same_logits(logits, expected):
    assert logits.dtype == np.float32 and logits.shape == expected.shape
    assert np.abs(logits - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
    assert logits.argmax() == expected.argmax()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_logits_of_all_engines_are_the_same(case):
    model = made(*case)
    compiled, others = (
        CompiledClassifier(model),
        [OnnxClassifier(to_onnx(model)), TorchClassifier(torch_classifier(model))],
    )
    volume = TNTVolume(model.config)
    volume.open(0)
    for packet in [None, *np.split(random_events(1200, sensor=model.config.sensor, seed=4), 4)]:
        volume.update(packet)
        for engine in others:
            assert_same_logits(engine(volume.array), compiled(volume.array))
    assert volume.array.any()


NASTY = made((9, 7), 3, "split", (3, 4, 6), 3)
NASTY_ENGINES = (CompiledClassifier(NASTY), OnnxClassifier(to_onnx(NASTY)), TorchClassifier(torch_classifier(NASTY)))


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.differing_executors])
@given(events=nasty_streams((9, 7), 1000, 5_000_000))
def test_logits_are_the_same_on_nasty_streams(events):
    volume = TNTVolume(NASTY.config.replace(window_us=1000))
    volume.open(5_000_000)
    volume.update(events)
    compiled, *others = NASTY_ENGINES
    for engine in others:
        assert_same_logits(engine(volume.array), compiled(volume.array))


@pytest.mark.parametrize("engine", ["onnx", "torch"])
def test_decisions_on_the_samples_are_the_same(engine):
    expected, got = (choose_engine("digits", name).processor(every_us=20_000) for name in ("compiled", engine))
    n = 0
    for path in sample_recordings().values():
        packets = np.array_split(open_recording(path).read(), 7)
        for ours, theirs in zip(_decisions(expected, packets), _decisions(got, packets), strict=True):
            assert (ours.label, ours.time_us, ours.events, ours.trigger) == (
                theirs.label,
                theirs.time_us,
                theirs.events,
                theirs.trigger,
            )
            assert np.abs(ours.logits - theirs.logits).max() <= 1e-4
            n += 1
    assert n > 100


def test_logits_on_real_recordings_are_the_same(data):
    model = load_model("digits")
    compiled, others = (
        CompiledClassifier(model),
        [OnnxClassifier(to_onnx(model)), TorchClassifier(torch_classifier(model))],
    )
    n = 0
    for path in sorted((data / "nmnist" / "Test").glob("*/*.bin"))[::25]:
        for _, volume in closed_volumes(open_recording(path).read(), model.config, 0, None):
            for engine in others:
                assert_same_logits(engine(volume), compiled(volume))
            n += 1
    assert n >= 120


def _decisions(processor, packets):
    processor.reset()
    return [decision for packet in packets for decision in processor.push(packet)] + processor.finish()


@pytest.mark.parametrize(
    "grid, bins, polarity, widths",
    [
        ((34, 34), 9, "signed", (20, 20, 20)),
        ((34, 34), 9, "split", (20, 20, 20)),
        ((48, 31), 2, "unsigned", (3, 5, 9)),
        ((5, 4), 1, "signed", (1, 1, 1)),
    ],
)
def test_landmarks_are_the_same(grid, bins, polarity, widths):
    config = TNTConfig(sensor=grid, grid=grid, bins=bins, polarity=polarity, landmark="regressor")
    model = random_regressor_model(config, regressor_widths=widths, widths=(1, 1, 1), seed=7)
    compiled, by_onnx = CompiledRegressor(model), OnnxRegressor(regressor_to_onnx(model))
    raw = TNTVolume(config.replace(transform="none", landmark="center"))
    raw.open(0)
    moved = 0.0
    for packet in [None, *np.split(random_events(1200, sensor=grid, seed=4), 4)]:
        raw.update(packet)
        x, y = by_onnx(raw.array)
        assert type(x) is float and np.abs(np.subtract((x, y), compiled(raw.array))).max() <= 1e-4
        moved = max(moved, abs(x - (grid[0] - 1) / 2))
    assert moved > 0.01


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.differing_executors])
@given(events=nasty_streams((9, 7), 1000, 0), sharpness=st.sampled_from([0.1, 2.0, 20.0]))
def test_landmarks_are_the_same_on_nasty_streams(events, sharpness):
    config = TNTConfig(sensor=(9, 7), grid=(9, 7), bins=3, window_us=1000, landmark="regressor")
    model = random_regressor_model(config, regressor_widths=(3, 4, 5), widths=(1, 1, 1), sharpness=sharpness)
    raw = TNTVolume(config.replace(transform="none", landmark="center"))
    raw.open(0)
    raw.update(events)
    expected = CompiledRegressor(model)(raw.array)
    assert np.abs(np.subtract(OnnxRegressor(regressor_to_onnx(model))(raw.array), expected)).max() <= 1e-4


def test_an_even_heatmap_gives_the_middle_exactly():
    """As an untrained landmark network does; grids of odd and even sides."""
    for grid in ((34, 34), (9, 7), (8, 5)):
        config = TNTConfig(sensor=grid, grid=grid, bins=2, landmark="regressor")
        model = random_regressor_model(config, regressor_widths=(2, 2, 2), widths=(1, 1, 1))
        weights = {**model.weights, "regressor.heatmap.weight": np.zeros((1, 2, 1, 1))}
        network = OnnxRegressor(regressor_to_onnx(Model(config, weights, model.classes)))
        volume = np.random.default_rng(0).normal(size=config.shape).astype(np.float32)
        landmark = network(volume)
        assert np.abs(np.subtract(landmark, ((grid[0] - 1) / 2, (grid[1] - 1) / 2))).max() < 1e-13


@pytest.mark.parametrize("engine", ["onnx", "torch"])
def test_a_model_with_a_regressor_runs_by_every_engine(engine, tmp_path):
    config = TNTConfig(landmark="regressor", window_us=1000, t_max=2.0)
    path = random_regressor_model(config, seed=5).save(tmp_path / "m.safetensors")
    events = random_events(900, seed=3, duration_us=3500)
    networks = choose_engine(path, engine).networks
    assert not any(isinstance(network, (CompiledClassifier, CompiledRegressor)) for network in networks.values())
    assert networks.keys() == {"classifier", "regressor"}
    expected, got = (choose_engine(path, name).processor(every_us=300) for name in ("compiled", engine))
    ours, theirs = (_decisions(processor, [events]) for processor in (expected, got))
    assert [d.time_us for d in ours] == [d.time_us for d in theirs] and len(ours) > 8
    for a, b in zip(ours, theirs, strict=True):
        # a landmark at its bound of 1e-4 px moves an event by 1e-4 / tau: see `equality.REGRESSED_VOLUME_BOUND`
        assert np.abs(a.logits - b.logits).max() <= 1e-2 and a.label == b.label


def test_the_bundled_model_as_a_processor_of_another_engine():
    model = load_model("digits")
    network = OnnxClassifier(to_onnx(model))
    processor = Processor(network.config, classifier=network, classes=network.classes)
    processor.push(open_recording(sample_recordings()[3]).read())
    assert processor.fire().label == "3"
