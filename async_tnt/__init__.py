"""Classify what an event camera sees, event by event, with the Temporal Normalization Transform (TNT).

    import async_tnt

    for decision in async_tnt.stream(source, "digits", every_us=5_000):
        print(decision.label, decision.probability)

Start with `Processor` (events in, decisions out), `TNTVolume` (the representation alone) and `TNTConfig`
(what it holds). The batch reference is the package `tnt_reference`.
"""

TYPE_CHECKING = False  # what type checkers take for `typing.TYPE_CHECKING`; importing `typing` takes milliseconds
if TYPE_CHECKING:
    from . import recordings
    from .classifier import CompiledClassifier
    from .compile_ahead import warmup
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

_MODULES = {
    "EVENT_DTYPE": "events",
    "BackgroundReader": "fresh",
    "CompiledClassifier": "classifier",
    "CompiledRegressor": "regressor",
    "Counts": "counts",
    "Decision": "decision",
    "LeakyIntegrator": "triggers",
    "Model": "model",
    "PacketQueue": "fresh",
    "PixelFilter": "pixels",
    "Processor": "processor",
    "ReplayBufferFull": "window_replay",
    "TNTConfig": "config",
    "TNTVolume": "volume",
    "astream": "streams",
    "bundled_models": "model",
    "load_model": "model",
    "open_recording": "recordings",
    "replay": "sources",
    "stream": "streams",
    "warmup": "compile_ahead",
}
"""Name -> the module that has it. Each is imported when it is first used, so that a program starts at once."""


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # a type checker would take it that every name is there

    def __getattr__(name):
        import importlib

        module = _MODULES.get(name, name)  # async_tnt.recordings and other modules are themselves
        try:
            value = importlib.import_module(f".{module}", __name__)
        except ModuleNotFoundError as error:
            if error.name != f"{__name__}.{module}":  # what is missing is another package
                raise
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
        if name in _MODULES:
            value = getattr(value, name)
        globals()[name] = value
        return value
