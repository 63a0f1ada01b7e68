"""Where events come from: recordings, cameras, the network, queues; and which pixels of them count.

open_recording      a file of any format that `sources.files` reads; `sample_recordings` are bundled
open_camera         a camera of Prophesee or iniVation (extra `cameras`)
open_udp            datagrams from the network; `UdpSender` sends them
replay              a recording at its own pace
BackgroundReader    reads a source in a thread of its own; `PacketQueue` is the queue alone, for drivers that call back
PixelFilter         a region, a cropped sensor, masked pixels; `learn_mask` finds hot pixels in recordings
"""

from async_tnt.sources.background_reader import BackgroundReader
from async_tnt.sources.camera import Camera, CameraCounts
from async_tnt.sources.camera_opening import DRIVERS, open_camera
from async_tnt.sources.datagrams import EVENT_BYTES, Decoded, Decoder, decode, encode
from async_tnt.sources.files.fitting import check_sensor, open_for
from async_tnt.sources.files.formats import READERS
from async_tnt.sources.files.nmnist import read_nmnist, write_nmnist
from async_tnt.sources.files.recording import Recording, open_recording, sample_recordings
from async_tnt.sources.files.source import CorruptData, DamagedRecording, Source
from async_tnt.sources.hot_pixels import count_pixels, hot_pixels, learn_mask
from async_tnt.sources.pixel_filter import PixelCounts, PixelFilter
from async_tnt.sources.pixel_masks import load_mask, save_mask
from async_tnt.sources.pixel_selection import PackedMask, PixelSelection
from async_tnt.sources.pixel_selector import PixelSelector
from async_tnt.sources.queue import PacketQueue, QueueCounters
from async_tnt.sources.replay import replay
from async_tnt.sources.udp import UdpSource, open_udp
from async_tnt.sources.udp_counts import NetworkCounts
from async_tnt.sources.udp_sender import UdpSender
from async_tnt.sources.udp_url import UdpUrl, parse_udp_url

__all__ = [
    "DRIVERS",
    "EVENT_BYTES",
    "READERS",
    "BackgroundReader",
    "Camera",
    "CameraCounts",
    "CorruptData",
    "DamagedRecording",
    "Decoded",
    "Decoder",
    "NetworkCounts",
    "PackedMask",
    "PacketQueue",
    "PixelCounts",
    "PixelFilter",
    "PixelSelection",
    "PixelSelector",
    "QueueCounters",
    "Recording",
    "Source",
    "UdpSender",
    "UdpSource",
    "UdpUrl",
    "check_sensor",
    "count_pixels",
    "decode",
    "encode",
    "hot_pixels",
    "learn_mask",
    "load_mask",
    "open_camera",
    "open_for",
    "open_recording",
    "open_udp",
    "parse_udp_url",
    "read_nmnist",
    "replay",
    "sample_recordings",
    "save_mask",
    "write_nmnist",
]
