"""The networks that can be trained, or one's own.

After training, the compiled network computes what torch computed.
"""

import json
import os

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import tnt_reference  # noqa: E402
from made import events_of, random_events  # noqa: E402
from torch import nn  # noqa: E402
from training.gestures import write_set  # noqa: E402

from async_tnt import CompiledClassifier, TNTConfig  # noqa: E402
from async_tnt.networks.loading import load_model  # noqa: E402
from async_tnt.training import pipeline as pipeline_module  # noqa: E402
from async_tnt.training.batches import BatchVolumes  # noqa: E402
from async_tnt.training.networks import NETWORKS, build_network, landmark_network  # noqa: E402
from async_tnt.training.pipeline import (  # noqa: E402
    export,
    input_scale,
    input_scales,
    new_pipeline,
    pipeline_before_export,
)
from async_tnt.training.recordings import Recordings  # noqa: E402
from async_tnt.training.windows import make_windows  # noqa: E402

CONFIG = TNTConfig(sensor=(20, 18), grid=(20, 18), bins=3)
MAPS = {"map": (1, 6, 2, 2), "boxes": (1, 8, 2, 2)}
"""Network that computes a map -> the shape of the map of the smallest grid, with three classes."""
OWN = """
from torch import nn

def linear(channels, grid, n_classes):
    return nn.Sequential(nn.Flatten(), nn.Linear(channels * grid[0] * grid[1], n_classes))

def normed(channels, grid, n_classes):
    return nn.Sequential(
        nn.BatchNorm2d(channels),
        nn.Conv2d(channels, 4, 3, stride=2),  # few features, whose statistics take no seconds
        nn.ReLU(),
        nn.AdaptiveAvgPool2d(1),
        nn.Conv2d(4, n_classes, 1),  # logits (n_classes, 1, 1)
    )

def twice(channels, grid, n_classes):
    conv = nn.Conv2d(channels, channels, 3, padding=1)  # its weights are used twice
    head = [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(channels, n_classes)]
    return nn.Sequential(conv, nn.ReLU(), conv, *head)

def mish(channels, grid, n_classes):
    conv = nn.Conv2d(channels, 4, 3)
    return nn.Sequential(conv, nn.Mish(), nn.Flatten(), nn.Linear(4096, n_classes))

def double(channels, grid, n_classes):
    return linear(channels, grid, n_classes).double()

def number(channels, grid, n_classes):
    return 5

def broken(channels, grid, n_classes):
    return 1 / 0

def deep(channels, grid, n_classes):
    halves = [nn.MaxPool2d(2) for _ in range(6)]
    head = [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(channels, n_classes)]
    return nn.Sequential(*halves, *head)
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "mine.py"
    path.write_text(OWN)
    return path


@pytest.fixture(scope="module")
def windows():
    events = [random_events(300, seed=k, sensor=CONFIG.sensor) for k in range(6)]
    return make_windows(
        Recordings.from_events(events, [0, 1, 2] * 2),
        CONFIG.window_us,
        duration_us=CONFIG.window_us,
    )


@pytest.mark.parametrize("name", [*NETWORKS, "linear", "normed", "twice"])
def test_a_trained_network_computes_the_same_compiled(name, own, windows, tmp_path):
    """Batch norms and the input scale are folded.

    The pipeline that continues from the model computes the same.
    """
    config = CONFIG
    if name in MAPS:  # they read no transformed volume
        config = CONFIG.replace(transform="none", sensor=(24, 24), grid=(24, 24))
    pipeline = new_pipeline(config, 3, 0, windows, name if name in NETWORKS else f"{own}:{name}")
    optimizer = torch.optim.Adam(pipeline.parameters(), lr=0.01)
    for _ in range(3):
        optimizer.zero_grad()
        logits = pipeline(windows)
        # of a map: at all places
        labels = torch.from_numpy(windows.labels).reshape(-1, *[1] * (logits.ndim - 2))
        nn.functional.cross_entropy(
            logits, labels.expand(len(logits), *logits.shape[2:])
        ).backward()
        optimizer.step()
    pipeline.eval()
    with torch.no_grad():
        expected = pipeline(windows).numpy()
        model = load_model(export(pipeline, ("a", "b", "c")).save(tmp_path / "m.safetensors"))
        again = pipeline_before_export(model, windows)(windows).numpy()
    compiled = CompiledClassifier(model)
    found = np.array([compiled(volume) for volume in BatchVolumes(config)(windows)])
    assert np.ptp(expected) > 0.01
    np.testing.assert_allclose(found, expected, atol=1e-4 * max(1, np.abs(expected).max()))
    np.testing.assert_allclose(again, expected, atol=1e-4 * max(1, np.abs(expected).max()))


def test_the_first_two_are_the_references_with_the_same_initial_weights():
    builds = [
        (
            lambda: build_network("thesis", 3, (20, 18), 5),
            lambda: tnt_reference.Classifier(3, (20, 18), 5),
        ),
        (lambda: landmark_network(3), lambda: tnt_reference.LandmarkRegressor(3, (20, 18))),
    ]
    volume = torch.randn(2, 3, 18, 20, generator=torch.Generator().manual_seed(1))
    for pair in builds:
        networks = []
        for build in pair:
            torch.manual_seed(7)
            networks.append(build())
        ours, reference = networks
        torch.testing.assert_close(
            dict(ours.state_dict()), dict(reference.state_dict()), rtol=0, atol=0
        )
        torch.testing.assert_close(ours(volume), reference(volume))


@pytest.mark.parametrize("name", NETWORKS)
def test_the_smallest_grid(name):
    side = NETWORKS[name][1]
    answer = build_network(name, 2, (side, side), 3).eval()(torch.zeros(1, 2, side, side))
    assert answer.shape == MAPS.get(name, (1, 3))
    message = rf"^network '{name}' needs a grid of at least {side}x{side}, got \(40, {side - 1}\)$"
    with pytest.raises(ValueError, match=message):
        build_network(name, 2, (40, side - 1), 3)


def test_the_input_is_scaled_to_a_root_mean_square_of_one(monkeypatch):
    """Over all cells, also empty ones. By hand: eight events in four cells, two in each."""
    config = TNTConfig(
        sensor=(4, 4),
        grid=(4, 4),
        representation="count",
        bins=1,
        polarity="unsigned",
        transform="none",
        landmark="center",
        window_us=100,
    )
    four = events_of(range(8), [0, 1, 2, 3] * 2, [0, 1, 2, 3] * 2, [1] * 8)
    none_else = make_windows(Recordings.from_events([four], [0]), 100)
    # 16 cells, of which four hold 2
    assert input_scale(config, none_else) == pytest.approx(1 / np.sqrt(4 * 4 / 16))
    one = events_of([0], [0], [0], [1])
    both = make_windows(Recordings.from_events([four, one], [0, 1]), 100)
    assert input_scale(config, both) == pytest.approx(1 / np.sqrt((1 + 1 / 16) / 2))
    # of many windows some are measured, spread over all
    monkeypatch.setattr(pipeline_module, "N_MEASURED", 2)
    three = make_windows(Recordings.from_events([four, four, one], [0, 0, 1]), 100)
    assert input_scale(config, three) == pytest.approx(1 / np.sqrt((1 + 1 / 16) / 2))
    # volumes in which all events cancel out have a scale, too
    signed = config.replace(polarity="signed", representation="volume")
    cancelled = events_of([5, 5], [1, 1], [2, 2], [0, 1])
    nothing = make_windows(Recordings.from_events([cancelled], [0]), 100)
    assert input_scale(signed, nothing) == pytest.approx(1e6)


def test_both_inputs_of_a_regressor_are_measured_with_the_landmark_at_the_centre(windows):
    """The input of the landmark network is the volume without the transform."""
    config = CONFIG.replace(landmark="regressor", t_max=2.0)
    found = input_scales(config, windows)
    centered = CONFIG.replace(landmark="center", t_max=2.0)
    assert found == {
        "scale": input_scale(centered, windows),
        "raw_scale": input_scale(centered.replace(transform="none"), windows),
    }
    assert found["scale"] != found["raw_scale"]


def test_the_network_sees_the_logarithm_of_one_more_than_its_volume():
    config = CONFIG.replace(transform="none", polarity="split")
    events = [random_events(300, seed=k, sensor=CONFIG.sensor) for k in range(3)]
    windows = make_windows(Recordings.from_events(events, [0, 1, 2]), config.window_us)
    pipeline = new_pipeline(config, 3, 0, windows, "conv4", logarithm=True).eval()
    plain = new_pipeline(config, 3, 0, windows, "conv4").eval()
    assert float(pipeline.scale) == 1 != float(plain.scale)
    volumes = pipeline.volumes(windows)
    with torch.no_grad():
        expected = plain.classifier(torch.log(1 + volumes))
        torch.testing.assert_close(pipeline(windows), expected, rtol=1e-4, atol=1e-5)


def test_initial_weights_depend_on_the_seed_alone_and_others_draw_as_before(windows):
    state = torch.get_rng_state()
    first = new_pipeline(CONFIG, 3, 1 << 64, windows).state_dict()
    assert torch.equal(torch.get_rng_state(), state)
    torch.rand(3)
    same = new_pipeline(CONFIG, 3, 1 << 64, windows).state_dict()
    other = new_pipeline(CONFIG, 3, 5, windows).state_dict()
    torch.testing.assert_close(dict(same), dict(first), rtol=0, atol=0)
    assert not torch.equal(other["classifier.conv1.weight"], first["classifier.conv1.weight"])


@pytest.mark.parametrize(("side", "n_pools"), [(64, 3), (65, 4)])
def test_a_large_grid_has_one_pooling_more(side, n_pools):
    """By its shorter side."""
    for grid in ((side, 100), (100, side)):
        network = build_network("residual", 2, grid, 3)
        pools = [layer for layer in network.modules() if isinstance(layer, nn.MaxPool2d)]
        assert len(pools) == n_pools


@pytest.mark.parametrize(
    "function, message",
    [
        ("mish", "layer '1' (Mish) has no compiled form; a network of logits runs whole at"),
        ("double", "must have the same dtype"),
        ("broken", "ZeroDivisionError: division by zero"),
        ("absent", ": it has no function 'absent'"),
        ("number", "must return a torch module, got int"),
    ],
)
def test_what_is_wrong_with_ones_own_is_said_before_training(
    function, message, own, tmp_path, program
):
    folder = write_set(tmp_path / "set", {"upright": 1, "flat": 1}, side=34)
    words = (
        "--network",
        f"{own}:{function}",
        "--sensor",
        "34x34",
        "--out",
        tmp_path / "m.safetensors",
    )
    code, _, err = program("train", folder, *words)
    assert code == 2 and f"{own}:{function}" in err and message in err and "windows" not in err
    assert os.listdir(tmp_path) == ["set"]


def test_training_one_from_the_command(own, tmp_path, program, few_steps):
    folder = write_set(tmp_path / "set", {"upright": 2, "flat": 2}, side=34)
    mine = tmp_path / "mine.py"
    out = tmp_path / "m.safetensors"
    mine.write_text(OWN)
    words = ["train", folder, "--network", f"{mine}:normed", "--out", out, "--epochs", 1]
    assert program(*words)[0] == 0
    model = load_model(out)
    assert model.record["network"] == "mine.py:normed"
    assert str(tmp_path) not in json.dumps(dict(model.record))
    mine.write_text(OWN + "# another network, perhaps\n")
    code, _, err = program(*words)
    assert code == 2 and "holds a run with other network_file" in err
    # the smallest grid that it suits
    large = write_set(tmp_path / "large", {"upright": 2, "flat": 2}, side=64)
    words = ["train", large, "--network", f"{mine}:deep", "--epochs", 1]
    assert program(*words, "--out", tmp_path / "d.safetensors")[0] == 0
