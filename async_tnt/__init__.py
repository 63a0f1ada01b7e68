"""Classify what an event camera sees, event by event, with the Temporal Normalization Transform
(TNT).

    import async_tnt

    for decision in async_tnt.stream(source, "digits", every_us=5_000):
        print(decision.label, decision.probability)

Start with `Processor` (events in, decisions out), `TNTVolume` (the representation alone) and
`TNTConfig` (what it holds). The batch reference is the package `tnt_reference`.
"""

from async_tnt.package import __version__ as __version__

# type checkers assume True, as for `typing.TYPE_CHECKING`, whose import takes milliseconds
TYPE_CHECKING = False
if TYPE_CHECKING:  # for type checkers and editors
    from async_tnt.compile_ahead import warmup
    from async_tnt.config import TNTConfig
    from async_tnt.decision import Counts, Decision, Object
    from async_tnt.event_forms import event_columns
    from async_tnt.events import EVENT_DTYPE
    from async_tnt.networks.compiled import CompiledClassifier, CompiledRegressor
    from async_tnt.networks.loading import bundled_models, load_model
    from async_tnt.networks.model import Model
    from async_tnt.processor import Processor
    from async_tnt.sources.background_reader import BackgroundReader
    from async_tnt.sources.files.recording import open_recording
    from async_tnt.sources.pixel_filter import PixelFilter
    from async_tnt.sources.playback import replay
    from async_tnt.sources.queue import PacketQueue
    from async_tnt.streams import WindowVolume, astream, stream, volumes
    from async_tnt.volume import TNTVolume
else:  # type checkers use the imports above; __getattr__ would let every name pass
    from async_tnt.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "compile_ahead": "warmup",
            "config": "TNTConfig",
            "decision": "Counts Decision Object",
            "event_forms": "event_columns",
            "events": "EVENT_DTYPE",
            "networks.compiled": "CompiledClassifier CompiledRegressor",
            "networks.loading": "bundled_models load_model",
            "networks.model": "Model",
            "processor": "Processor",
            "sources.background_reader": "BackgroundReader",
            "sources.files.recording": "open_recording",
            "sources.pixel_filter": "PixelFilter",
            "sources.playback": "replay",
            "sources.queue": "PacketQueue",
            "streams": "WindowVolume astream stream volumes",
            "volume": "TNTVolume",
        },
    )

__all__ = [
    "EVENT_DTYPE", "BackgroundReader", "CompiledClassifier", "CompiledRegressor", "Counts", "Decision",
    "Model", "Object", "PacketQueue", "PixelFilter", "Processor", "TNTConfig",
    "TNTVolume", "WindowVolume", "astream", "bundled_models", "event_columns", "load_model", "open_recording", "replay",
    "stream", "volumes", "warmup",
]  # fmt: skip
