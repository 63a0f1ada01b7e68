"""Classify what an event camera sees, event by event, with the Temporal Normalization Transform (TNT).

    import async_tnt

    for decision in async_tnt.stream(source, "digits", every_us=5_000):
        print(decision.label, decision.probability)

Start with `Processor` (events in, decisions out), `TNTVolume` (the representation alone) and `TNTConfig`
(what it holds). The batch reference is the package `tnt_reference`.
"""

TYPE_CHECKING = False  # what type checkers take for `typing.TYPE_CHECKING`; importing `typing` takes milliseconds
if TYPE_CHECKING:
    from async_tnt.compile_ahead import warmup
    from async_tnt.config import TNTConfig
    from async_tnt.decision import Counts, Decision
    from async_tnt.deferred_landmark import ReplayBufferFull
    from async_tnt.events import EVENT_DTYPE
    from async_tnt.networks.classifier import CompiledClassifier
    from async_tnt.networks.model import Model, bundled_models, load_model
    from async_tnt.networks.regressor import CompiledRegressor
    from async_tnt.processor import Processor
    from async_tnt.sources.background_reader import BackgroundReader
    from async_tnt.sources.files.recording import open_recording
    from async_tnt.sources.pixel_filter import PixelFilter
    from async_tnt.sources.playback import replay
    from async_tnt.sources.queue import PacketQueue
    from async_tnt.streams import astream, stream
    from async_tnt.triggers import LeakyIntegrator
    from async_tnt.volume import TNTVolume

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
    "replay",
    "stream",
    "warmup",
]

_MODULES = {
    "EVENT_DTYPE": "events",
    "BackgroundReader": "sources.background_reader",
    "CompiledClassifier": "networks.classifier",
    "CompiledRegressor": "networks.regressor",
    "Counts": "decision",
    "Decision": "decision",
    "LeakyIntegrator": "triggers",
    "Model": "networks.model",
    "PacketQueue": "sources.queue",
    "PixelFilter": "sources.pixel_filter",
    "Processor": "processor",
    "ReplayBufferFull": "deferred_landmark",
    "TNTConfig": "config",
    "TNTVolume": "volume",
    "astream": "streams",
    "bundled_models": "networks.model",
    "load_model": "networks.model",
    "open_recording": "sources.files.recording",
    "replay": "sources.playback",
    "stream": "streams",
    "warmup": "compile_ahead",
}
"""Name -> the module that has it. Each is imported when it is first used, so that a program starts at once."""


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # a type checker would take it that every name is there

    def __getattr__(name):
        import importlib

        module = _MODULES.get(name, name)  # async_tnt.sources.files and other modules are themselves
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
