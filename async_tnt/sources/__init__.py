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
PixelFilter         keeps the events of a region, without masked pixels; `Pixels` is the same as a
                    value without a sensor; `learn_mask` finds hot pixels in recordings
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
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
    from async_tnt.sources.live.cameras import Camera, open_camera
    from async_tnt.sources.live.clock import Clock
    from async_tnt.sources.live.datagrams import encode
    from async_tnt.sources.live.udp import UdpSource, open_udp
    from async_tnt.sources.opening import open_source
    from async_tnt.sources.pixels.hot_pixels import learn_mask
    from async_tnt.sources.pixels.pixel_filter import PixelFilter
    from async_tnt.sources.pixels.pixel_masks import load_mask, save_mask
    from async_tnt.sources.pixels.pixels import Pixels
    from async_tnt.sources.queues.background_reader import BackgroundReader
    from async_tnt.sources.queues.keep_up import KeepUp
    from async_tnt.sources.queues.queue import PacketQueue
else:
    from async_tnt.base.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "files.off_sensor": "EventsOffSensor",
            "files.playback": "replay",
            "files.recording": "READERS Recording RecordingCounts open_recording sample_recordings",
            "files.source": "CorruptData DamagedRecording ReadOptions Source Topic",
            "live.cameras": "Camera open_camera",
            "live.clock": "Clock",
            "live.datagrams": "encode",
            "live.udp": "UdpSource open_udp",
            "opening": "open_source",
            "pixels.hot_pixels": "learn_mask",
            "pixels.pixel_filter": "PixelFilter",
            "pixels.pixel_masks": "load_mask save_mask",
            "pixels.pixels": "Pixels",
            "queues.background_reader": "BackgroundReader",
            "queues.keep_up": "KeepUp",
            "queues.queue": "PacketQueue",
        },
        instead={
            "PackedMask": "give the mask, or the name of its file, to `Pixels(mask=...)`",
            "PixelSelection": "it is `Pixels`, with the same parameters",
            "PixelSelector": "`Pixels.filter_of(camera)` gives the filter of a camera",
            "PixelCounts": "it is in `async_tnt.sources.pixels.pixel_filter`",
            "count_pixels": "it is in `async_tnt.sources.pixels.hot_pixels`; or use `learn_mask`",
            "hot_pixels": "it is in `async_tnt.sources.pixels.hot_pixels`; or use `learn_mask`",
            "QueueCounters": "it is in `async_tnt.sources.queues.queue`",
            "CameraCounts": "it is in `async_tnt.sources.live.camera_drivers`",
            "DRIVERS": "it is in `async_tnt.sources.live.camera_drivers`",
            "NetworkCounts": "it is in `async_tnt.sources.live.udp`",
            "Decoder": "it is in `async_tnt.sources.live.datagrams`; `open_udp` decodes",
            "EVENT_BYTES": "it is in `async_tnt.sources.live.datagrams`",
            "read_nmnist": "`open_recording(path).read()`, or `async_tnt.sources.files.nmnist`",
        },
    )

__all__ = [
    "READERS",
    "BackgroundReader",
    "Camera",
    "Clock",
    "CorruptData",
    "DamagedRecording",
    "EventsOffSensor",
    "KeepUp",
    "PacketQueue",
    "PixelFilter",
    "Pixels",
    "ReadOptions",
    "Recording",
    "RecordingCounts",
    "Source",
    "Topic",
    "UdpSource",
    "encode",
    "learn_mask",
    "load_mask",
    "open_camera",
    "open_recording",
    "open_source",
    "open_udp",
    "replay",
    "sample_recordings",
    "save_mask",
]
