"""Classify what an event camera sees, event by event, with the Temporal Normalization Transform (TNT).

    import async_tnt

    for decision in async_tnt.stream(source, "digits", every_us=5_000):
        print(decision.label, decision.probability)

Start with `Processor` (events in, decisions out), `TNTVolume` (the representation alone) and `TNTConfig`
(what it holds). The batch reference is the package `tnt_reference`.
"""

TYPE_CHECKING = False  # type checkers assume True, as for `typing.TYPE_CHECKING`, whose import takes milliseconds
if TYPE_CHECKING:  # for type checkers and editors; `X as X` re-exports
    from async_tnt.compile_ahead import warmup as warmup
    from async_tnt.config import TNTConfig as TNTConfig
    from async_tnt.decision import Counts as Counts
    from async_tnt.decision import Decision as Decision
    from async_tnt.deferred_landmark import ReplayBufferFull as ReplayBufferFull
    from async_tnt.events import EVENT_DTYPE as EVENT_DTYPE
    from async_tnt.networks.compiled import CompiledClassifier as CompiledClassifier
    from async_tnt.networks.compiled import CompiledRegressor as CompiledRegressor
    from async_tnt.networks.model import Model as Model
    from async_tnt.networks.model import bundled_models as bundled_models
    from async_tnt.networks.model import load_model as load_model
    from async_tnt.processor import Processor as Processor
    from async_tnt.sources.background_reader import BackgroundReader as BackgroundReader
    from async_tnt.sources.files.recording import open_recording as open_recording
    from async_tnt.sources.pixel_filter import PixelFilter as PixelFilter
    from async_tnt.sources.playback import replay as replay
    from async_tnt.sources.queue import PacketQueue as PacketQueue
    from async_tnt.streams import astream as astream
    from async_tnt.streams import stream as stream
    from async_tnt.triggers import LeakyIntegrator as LeakyIntegrator
    from async_tnt.volume import TNTVolume as TNTVolume

__version__ = "0.1.0"

_MODULES = {
    "EVENT_DTYPE": "events",
    "BackgroundReader": "sources.background_reader",
    "CompiledClassifier": "networks.compiled",
    "CompiledRegressor": "networks.compiled",
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
"""Public name -> its module, imported when the name is first used, so that programs start fast."""


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})


if not TYPE_CHECKING:  # type checkers use the imports above; __getattr__ would let every name pass
    __all__ = sorted(_MODULES)

    def __getattr__(name):
        import importlib

        module = _MODULES.get(name, name)  # else a submodule, such as `async_tnt.sources`
        try:
            value = importlib.import_module(f".{module}", __name__)
        except ModuleNotFoundError as error:
            if error.name != f"{__name__}.{module}":  # another package is missing
                raise
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
        if name in _MODULES:
            value = getattr(value, name)
        globals()[name] = value
        return value
