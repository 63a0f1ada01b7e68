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
    from async_tnt.events import EVENT_DTYPE as EVENT_DTYPE
    from async_tnt.networks.compiled import CompiledClassifier as CompiledClassifier
    from async_tnt.networks.compiled import CompiledRegressor as CompiledRegressor
    from async_tnt.networks.loading import bundled_models as bundled_models
    from async_tnt.networks.loading import load_model as load_model
    from async_tnt.networks.model import Model as Model
    from async_tnt.processor import Processor as Processor
    from async_tnt.replay_buffer import ReplayBufferFull as ReplayBufferFull
    from async_tnt.sources.background_reader import BackgroundReader as BackgroundReader
    from async_tnt.sources.files.recording import open_recording as open_recording
    from async_tnt.sources.pixel_filter import PixelFilter as PixelFilter
    from async_tnt.sources.playback import replay as replay
    from async_tnt.sources.queue import PacketQueue as PacketQueue
    from async_tnt.streams import astream as astream
    from async_tnt.streams import stream as stream
    from async_tnt.triggers import LeakyIntegrator as LeakyIntegrator
    from async_tnt.volume import TNTVolume as TNTVolume

from async_tnt.version import __version__ as __version__  # noqa: E402

if not TYPE_CHECKING:  # type checkers use the imports above; __getattr__ would let every name pass
    from async_tnt.lazy_names import lazy_names

    __all__, __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "compile_ahead": "warmup",
            "config": "TNTConfig",
            "decision": "Counts Decision",
            "replay_buffer": "ReplayBufferFull",
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
            "streams": "astream stream",
            "triggers": "LeakyIntegrator",
            "volume": "TNTVolume",
        },
    )
