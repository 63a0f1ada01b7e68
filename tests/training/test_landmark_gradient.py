"""The landmark regressor learns through the kernels' volumes.

Their gradient is the reference's, and reaches the regressor.
"""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import tnt_reference  # noqa: E402
from made import events_of, random_events  # noqa: E402

from async_tnt.networks.models.torch_modules import torch_regressor  # noqa: E402
from async_tnt.training.augment import Augmentation  # noqa: E402
from async_tnt.training.batches import BatchVolumes  # noqa: E402
from async_tnt.training.pipeline import (  # noqa: E402
    export,
    new_pipeline,
    pipeline_before_export,
    pipeline_of,
)
from async_tnt.training.recordings import Recordings  # noqa: E402
from async_tnt.training.windows import make_windows  # noqa: E402
from async_tnt.volume.config import TNTConfig  # noqa: E402

CONFIG = TNTConfig(landmark="regressor", t_max=2.0)
NOTHING = Augmentation(start_ms=0, shift_px=0, rotation_deg=0, scale=0, shear=0, drop=0, partial=0)
LANDMARKS = np.array([[15.2, 17.9], [3.1, 30.2], [16.5, 16.5]])


def windows_of(config, n=600, seed=0):
    events = [random_events(n, seed=seed + k, sensor=config.sensor) for k in range(3)]
    return make_windows(
        Recordings.from_events(events, [0, 1, 2]), config.window_us, duration_us=config.window_us
    )


def columns(windows, i):
    r = windows.recordings
    where = slice(r.offsets[windows.recording[i]], r.offsets[windows.recording[i] + 1])
    return [getattr(r, name)[where].astype(np.int64) for name in "txyp"]


def reference_settings(config):
    return {
        name: getattr(config, name)
        for name in ("window_us", "sensor", "grid", "bins", "t_max", "polarity")
    }


@pytest.mark.parametrize(
    "changes",
    [{}, {"polarity": "split", "grid": (20, 28)}, {"sensor": (64, 40), "bins": 1, "t_max": 8.0}],
    ids=str,
)
def test_gradient_of_the_kernels_equals_the_references(changes):
    config = CONFIG.replace(**changes)
    windows = windows_of(config)
    batches = BatchVolumes(config)
    at = torch.tensor(LANDMARKS, requires_grad=True)
    expected = torch.stack(
        [
            tnt_reference.tnt_volume(
                *columns(windows, i),
                start_us=0,
                **reference_settings(config),
                landmark=at[i],
                dtype=torch.float64,
            )
            for i in range(3)
        ]
    )
    slope = np.random.default_rng(1).standard_normal(expected.shape).astype(np.float32)
    (expected * torch.from_numpy(slope).double()).sum().backward()
    assert at.grad.abs().min() > 0.1
    np.testing.assert_allclose(batches(windows, None, LANDMARKS), expected.detach(), atol=1e-5)
    with pytest.raises(
        ValueError, match="`landmarks` must be given with landmark 'regressor', and with no other"
    ):
        batches(windows)
    # augmentation has a finer sensor
    fine = NOTHING.draw(windows, config, np.random.default_rng(0))
    assert fine.sensor != config.sensor
    for draws in (None, fine):
        got = batches.landmark_gradient(windows, draws, LANDMARKS, slope)
        np.testing.assert_allclose(got, at.grad, rtol=1e-9, atol=1e-9)


def test_beyond_the_last_row_and_column_the_gradient_is_zero():
    """An event on the last column, or row, would leave the volume; the next one's is not read.

    At TNT time 1 it is at its own pixel, if the landmark is the centre.
    """
    middle_us = CONFIG.window_us // 2
    slope = np.ones((1, *CONFIG.shape), np.float32)
    centre = np.array([[16.5, 16.5]])
    for x, y, expected in ((33, 10, (1.0, 0.0)), (12, 33, (0.0, 1.0)), (12, 10, (0.0, 0.0))):
        events = events_of([0, middle_us], [5, x], [5, y], [1, 1])
        windows = make_windows(Recordings.from_events([events], [0]), CONFIG.window_us)[:1]
        found = BatchVolumes(CONFIG).landmark_gradient(windows, None, centre, slope)
        np.testing.assert_allclose(found, [expected], atol=1e-9)


def test_the_loss_reaches_every_layer_and_the_exported_pipeline_equals_the_references():
    """Scales are folded into the weights of a model, which becomes a pipeline again.

    The logits are those of the torch pipeline on the events.
    """
    windows = windows_of(CONFIG)
    pipeline = new_pipeline(CONFIG, 3, 0, windows)
    # the first landmark is the centre
    assert pipeline.landmarks(windows).tolist() == [[16.5, 16.5]] * 3
    optimizer = torch.optim.Adam(pipeline.parameters(), lr=0.03)
    for _ in range(3):
        loss = torch.nn.functional.cross_entropy(
            pipeline(windows), torch.from_numpy(windows.labels)
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert min(float(w.grad.abs().max()) for w in pipeline.regressor.parameters()) > 0
    assert (pipeline.landmarks(windows) - 16.5).abs().max() > 0.05
    model = export(pipeline, ("a", "b", "c"))
    reference = tnt_reference.Pipeline(
        pipeline_of(model).classifier,
        **reference_settings(CONFIG),
        landmark="regressor",
        regressor=torch_regressor(model),
    )
    with torch.no_grad():
        expected = pipeline(windows)
        batch = reference.batch([(*columns(windows, i), 0) for i in range(3)])
        for got in (
            pipeline_of(model)(windows),
            pipeline_before_export(model, windows)(windows),
            batch,
        ):
            torch.testing.assert_close(got, expected, atol=1e-4, rtol=1e-4)
