"""Classify what an event camera sees, event by event, with the Temporal Normalization Transform (TNT).

    import async_tnt

    for decision in async_tnt.stream(source, "digits", every_us=5_000):
        print(decision.label, decision.probability)

Start with `Processor` (events in, decisions out), `TNTVolume` (the representation alone) and `TNTConfig`
(what it holds). The batch reference is the package `tnt_reference`.
"""

from . import recordings
from .classifier import CompiledClassifier
from .config import TNTConfig
from .counts import Counts
from .decision import Decision
from .events import EVENT_DTYPE
from .fresh import BackgroundReader, PacketQueue
from .model import Model, bundled_models, load_model
from .pixels import PixelFilter
from .processor import Processor
from .recordings import open_recording
from .regressor import CompiledRegressor
from .sources import replay
from .streams import astream, stream
from .triggers import LeakyIntegrator
from .volume import TNTVolume
from .warmup import warmup
from .window_replay import ReplayBufferFull

__version__ = "0.1.0"

__all__ = [
    "EVENT_DTYPE",
    "BackgroundReader",
    "CompiledClassifier",
    "CompiledRegressor",
    "Counts",
    "Decision",
    "LeakyIntegrator",
    "Model",
    "PacketQueue",
    "PixelFilter",
    "Processor",
    "ReplayBufferFull",
    "TNTConfig",
    "TNTVolume",
    "astream",
    "bundled_models",
    "load_model",
    "open_recording",
    "recordings",
    "replay",
    "stream",
    "warmup",
]
