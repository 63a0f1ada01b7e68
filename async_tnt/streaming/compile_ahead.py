"""Compile the kernels of a stream before its first event.

Each object compiles, or loads, the kernels that it calls as soon as it is made. So does a copy of
the object in another process. No event then waits for the compiler.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterTypeError
from async_tnt.base.messages import short
from async_tnt.kernels.entry_points import ENTRY_POINTS, prepare
from async_tnt.kernels.volume.absorb import absorb
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.compiled_network import compiled_network_of
from async_tnt.networks.models.model import Model
from async_tnt.streaming.processor import Processor
from async_tnt.volume.config import TNTConfig


def warmup(model: Model | TNTConfig | str | Path | None = None) -> float:
    """Compile everything that a stream may call, or load it.

    This takes a fraction of a second, or some seconds where neither the package nor Numba's cache
    has the code. After it, no event waits for the compiler.

    Parameters
    ----------
    model : the model of the streams, or its name or path, or a configuration for streams with other
        classifiers; by default everything is compiled, for any stream.

    Returns
    -------
    float : how many seconds the compilation, or the loading, took.
    """
    started_s = time.perf_counter()
    if isinstance(model, (str, Path)):
        model = load_model(model)
    if model is None:
        prepare(*ENTRY_POINTS)
    elif isinstance(model, Model):
        _make_stream(model.config)
        Processor(model, every_events=1, late="drop")
        if not model.is_spiking:
            compiled_network_of(model)(np.zeros(model.config.shape, np.float32))
    elif isinstance(model, TNTConfig):
        _make_stream(model)
    else:
        rule = "must be a Model, the name or path of one, or a TNTConfig"
        raise ParameterTypeError("model", rule, short(model))
    return time.perf_counter() - started_s


def _make_stream(config: TNTConfig) -> None:
    """Make a stream with a foreign classifier, which compiles its kernels.

    `len` takes the place of the classifier. It is never called.
    """
    settings: dict[str, Any] = {"regressor": len} if config.needs_regressor else {}
    Processor(config, classifier=len, every_events=1, late="drop", **settings)


def must_compile() -> bool:
    """Whether a stream has to wait until its kernels are compiled, for some seconds.

    Every stream needs `absorb`, so this kernel stands for all that a stream needs.
    """
    return not absorb.is_quick
