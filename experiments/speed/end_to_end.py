"""The time from a packet of new events to the decision.

Our stream is compared with programs that compute the window's volume again for each decision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt import Model, Processor
from experiments.speed.backends import ENGINES, Network
from experiments.speed.interleaved import Backend, compare
from experiments.speed.moments import Moment, Moments
from experiments.speed.timing import is_installed

WORK = {
    "ours": (
        "push(packet), fire(): checks, transform and volume of the new events, what changed of "
        "the network, softmax, a Decision"
    ),
    "ours_onnxruntime": (
        "the same with onnxruntime as the Processor's classifier: the volume is incremental, the "
        "network is not"
    ),
    "torch": (
        "the window's volume from all its events so far with the transform, one scatter_add_, "
        "then torch's network, argmax; the events are in tensors beforehand"
    ),
    "eventcv_onnxruntime": (
        "eventcv's voxel grid of all events so far (2 cells an event, whole pixels, no "
        "transform), as an array, then onnxruntime's network on it, argmax; the events are in its "
        "stream beforehand. Its volume is another one, so that its answers mean nothing here"
    ),
}
"""Way from a packet to a decision -> what it does."""

NEEDS = {
    "ours_onnxruntime": ("onnx", "onnxruntime"),
    "torch": ("torch", "tnt_reference"),
    "eventcv_onnxruntime": ("eventcv", "onnx", "onnxruntime"),
}
"""Row of `WORK` -> packages that it needs."""


class Stream:
    """Our stream: a Processor, which already has the window's earlier events."""

    def __init__(self, model: Model, classifier: Network | None = None) -> None:
        self._processor = Processor(model, classifier=classifier, start_us=0)
        self._start_us = -1
        self._n = 0

    def prepare(self, moment: Moment) -> None:
        if moment.start_us != self._start_us:
            self._start_us = moment.start_us
            self._n = 0
        n_old = len(moment.events) - moment.n_new
        if n_old > self._n:
            self._processor.push(moment.events[self._n : n_old])
        # a camera's driver hands over new memory each time, too
        self._packet = moment.events[n_old:].copy()
        self._n = len(moment.events)

    def decide(self) -> np.ndarray:
        self._processor.push(self._packet)
        return self._processor.fire().logits


class TorchRebuild:
    """Batch processing in torch, as fast as we can write it."""

    def __init__(self, model: Model) -> None:
        import torch

        from async_tnt.networks.models.torch_modules import torch_classifier
        from experiments.speed.torch_batch import TorchBatch

        self._torch = torch
        self._network = torch_classifier(model)
        self._batch = TorchBatch(model.config)

    def prepare(self, moment: Moment) -> None:
        from experiments.speed.torch_batch import as_tensors

        self._columns = as_tensors(moment.events, moment.start_us)

    def decide(self) -> np.ndarray:
        with self._torch.inference_mode():
            logits = self._network(self._batch.volume(*self._columns)[None])[0]
            int(logits.argmax())
        logits_array: np.ndarray = logits.numpy()
        return logits_array


class EventcvRebuild:
    """eventcv's voxel grid of the window so far, and a network on it.

    The grid has the sensor's size and is signed, as the volume of `digits`.
    """

    def __init__(self, model: Model, network: Network) -> None:
        self._config = model.config
        self._network = network

    def prepare(self, moment: Moment) -> None:
        import eventcv

        events = moment.events
        table = np.stack([events["t"], events["x"], events["y"], events["p"]], axis=1).astype(
            np.int64
        )
        self._stream = eventcv.from_numpy(
            table, order="txyp", sensor_size=self._config.sensor, time_unit="us"
        )
        self._age_ms = max(1, int(table[-1, 0] - table[0, 0])) / 1000

    def decide(self) -> None:
        volume = self._stream.voxel(bins=self._config.bins, window_ms=self._age_ms).numpy()
        int(self._network(volume).argmax())


def bench_end_to_end(
    model: Model,
    onnxruntime: str | None,
    windows: list[np.ndarray],
    n_new: int,
    *,
    blocks: int,
    size: int,
) -> dict[str, Any]:
    """Times of decisions, from the call with a packet of `n_new` events to the decision.

    Parameters
    ----------
    onnxruntime : the faster way to call onnxruntime, of `backends.ONNXRUNTIME`; None if it is not
        installed. Each row that uses onnxruntime has a network of its own.

    The other parameters, the result and the errors are those of `bench_network`. Ratios are to the
    time of `ours`.
    """

    def backends(alternating: bool) -> dict[str, Backend]:
        new_backends: dict[str, Backend] = {"ours": Stream(model)}
        if onnxruntime is not None:
            new_backends["ours_onnxruntime"] = Stream(model, ENGINES[onnxruntime].make(model))
        if is_installed(*NEEDS["torch"]):
            new_backends["torch"] = TorchRebuild(model)
        if onnxruntime is not None and is_installed("eventcv"):
            new_backends["eventcv_onnxruntime"] = EventcvRebuild(
                model, ENGINES[onnxruntime].make(model)
            )
        return new_backends

    return compare(backends, Moments(windows, model.config.window_us, n_new).blocks, blocks, size)
