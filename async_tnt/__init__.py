"""Classify what an event camera sees, event by event, with the Temporal Normalization Transform.

    import async_tnt

    for decision in async_tnt.stream(source, "digits", every_us=5_000):
        print(decision.label, decision.probability)

Start with `Processor` (events in, decisions out), `TNTVolume` (the representation alone) and
`TNTConfig` (what it holds). The batch reference is the package `tnt_reference`.
"""

from async_tnt.base.package import __version__ as __version__

# type checkers assume True, as for `typing.TYPE_CHECKING`, whose import takes milliseconds
TYPE_CHECKING = False
if TYPE_CHECKING:  # for type checkers and editors
    from async_tnt.networks.loading import bundled_models, load_model
    from async_tnt.networks.models.compiled import CompiledClassifier, CompiledRegressor
    from async_tnt.networks.models.compiled_network import CompiledNetwork
    from async_tnt.networks.models.model import Model
    from async_tnt.networks.models.spiking_volume import SpikingVolume
    from async_tnt.sources.files.playback import replay
    from async_tnt.sources.files.recording import open_recording
    from async_tnt.sources.pixels.pixel_filter import PixelFilter
    from async_tnt.sources.queues.background_reader import BackgroundReader
    from async_tnt.sources.queues.queue import PacketQueue
    from async_tnt.streaming.compile_ahead import warmup
    from async_tnt.streaming.decision import Decision, Object
    from async_tnt.streaming.output import Output
    from async_tnt.streaming.processor import Processor
    from async_tnt.streaming.streams import WindowVolume, astream, stream, volumes
    from async_tnt.volume.config import TNTConfig
    from async_tnt.volume.counts import Counts
    from async_tnt.volume.event_forms import event_columns
    from async_tnt.volume.events import EVENT_DTYPE
    from async_tnt.volume.volume import TNTVolume
else:  # type checkers use the imports above; __getattr__ would let every name pass
    from async_tnt.base.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "streaming.compile_ahead": "warmup",
            "volume.config": "TNTConfig",
            "streaming.decision": "Decision Object",
            "streaming.output": "Output",
            "volume.counts": "Counts",
            "volume.event_forms": "event_columns",
            "volume.events": "EVENT_DTYPE",
            "networks.models.compiled": "CompiledClassifier CompiledRegressor",
            "networks.models.compiled_network": "CompiledNetwork",
            "networks.loading": "bundled_models load_model",
            "networks.models.model": "Model",
            "networks.models.spiking_volume": "SpikingVolume",
            "streaming.processor": "Processor",
            "sources.queues.background_reader": "BackgroundReader",
            "sources.files.recording": "open_recording",
            "sources.pixels.pixel_filter": "PixelFilter",
            "sources.files.playback": "replay",
            "sources.queues.queue": "PacketQueue",
            "streaming.streams": "WindowVolume astream stream volumes",
            "volume.volume": "TNTVolume",
        },
        instead={"config": "it is `async_tnt.volume.config`"},
    )

__all__ = [
    "EVENT_DTYPE",
    "BackgroundReader",
    "CompiledClassifier",
    "CompiledNetwork",
    "CompiledRegressor",
    "Counts",
    "Decision",
    "Model",
    "Object",
    "Output",
    "PacketQueue",
    "PixelFilter",
    "Processor",
    "SpikingVolume",
    "TNTConfig",
    "TNTVolume",
    "WindowVolume",
    "astream",
    "bundled_models",
    "event_columns",
    "load_model",
    "open_recording",
    "replay",
    "stream",
    "volumes",
    "warmup",
]
