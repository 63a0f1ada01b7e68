"""Where events come from: recordings, cameras, the network, queues; and which pixels of them count.

open_source         any of the next three by name, or events in memory
open_recording      a file of any format that `sources.files` reads; `sample_recordings` are bundled
open_camera         a camera of Prophesee or iniVation (extra `cameras`)
open_udp            datagrams from the network; `encode` makes them
replay              a recording at its own pace
BackgroundReader    reads a source in a background thread; `PacketQueue` is the queue alone, for
                    drivers with callbacks
KeepUp              the same with bounded delay: decides less often, then skips, when events outrun
                    decisions
PixelFilter         a region, a cropped sensor, masked pixels; `learn_mask` finds hot pixels in
                    recordings
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from async_tnt.sources.files.nmnist import read_nmnist
    from async_tnt.sources.files.off_sensor import EventsOffSensor
    from async_tnt.sources.files.playback import replay
    from async_tnt.sources.files.recording import (
        READERS,
        Recording,
        RecordingCounts,
        open_recording,
        sample_recordings,
    )
    from async_tnt.sources.files.source import (
        CorruptData,
        DamagedRecording,
        ReadOptions,
        Source,
        Topic,
    )
    from async_tnt.sources.live.camera_drivers import DRIVERS, CameraCounts
    from async_tnt.sources.live.cameras import Camera, open_camera
    from async_tnt.sources.live.clock import Clock
    from async_tnt.sources.live.datagrams import EVENT_BYTES, Decoder, encode
    from async_tnt.sources.live.udp import NetworkCounts, UdpSource, open_udp
    from async_tnt.sources.opening import open_source
    from async_tnt.sources.pixels.pixel_filter import PixelCounts, PixelFilter
    from async_tnt.sources.pixels.pixel_masks import (
        count_pixels,
        hot_pixels,
        learn_mask,
        load_mask,
        save_mask,
    )
    from async_tnt.sources.pixels.pixels import Pixels
    from async_tnt.sources.queues.background_reader import BackgroundReader
    from async_tnt.sources.queues.keep_up import KeepUp
    from async_tnt.sources.queues.queue import PacketQueue, QueueCounters
else:
    from async_tnt.base.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "queues.background_reader": "BackgroundReader",
            "live.camera_drivers": "DRIVERS CameraCounts",
            "live.cameras": "Camera open_camera",
            "live.clock": "Clock",
            "live.datagrams": "EVENT_BYTES Decoder encode",
            "files.nmnist": "read_nmnist",
            "files.off_sensor": "EventsOffSensor",
            "files.recording": "READERS Recording RecordingCounts open_recording sample_recordings",
            "files.source": "CorruptData DamagedRecording ReadOptions Source Topic",
            "queues.keep_up": "KeepUp",
            "opening": "open_source",
            "pixels.pixel_filter": "PixelCounts PixelFilter",
            "pixels.pixel_masks": "count_pixels hot_pixels learn_mask load_mask save_mask",
            "pixels.pixels": "Pixels",
            "files.playback": "replay",
            "queues.queue": "PacketQueue QueueCounters",
            "live.udp": "NetworkCounts UdpSource open_udp",
        },
    )

__all__ = [
    "DRIVERS", "EVENT_BYTES", "READERS", "BackgroundReader", "Camera", "CameraCounts", "Clock",
    "CorruptData", "DamagedRecording", "Decoder", "EventsOffSensor", "KeepUp", "NetworkCounts",
    "PacketQueue", "PixelCounts", "PixelFilter", "Pixels",
    "QueueCounters", "ReadOptions", "Recording", "RecordingCounts", "Source", "Topic", "UdpSource",
    "count_pixels", "encode", "hot_pixels", "learn_mask", "load_mask", "open_camera",
    "open_recording", "open_source", "open_udp", "read_nmnist", "replay", "sample_recordings",
    "save_mask",
]  # fmt: skip
