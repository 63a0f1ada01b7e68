"""Public names of `async_tnt.sources`, and those that are gone."""

import pytest

from async_tnt import sources
from async_tnt.sources.files.source_error import SourceError

REMOVED = [
    ("PackedMask", r"`Pixels\(mask=...\)`"),
    ("PixelSelection", "it is `Pixels`"),
    ("PixelSelector", r"`Pixels.filter_of\(camera\)`"),
    ("PixelCounts", "async_tnt.sources.pixels.pixel_filter"),
    ("count_pixels", "async_tnt.sources.pixels.hot_pixels"),
    ("hot_pixels", "async_tnt.sources.pixels.hot_pixels"),
    ("QueueCounters", "async_tnt.sources.queues.queue"),
    ("CameraCounts", "async_tnt.sources.live.camera_drivers"),
    ("DRIVERS", "async_tnt.sources.live.camera_drivers"),
    ("NetworkCounts", "async_tnt.sources.live.udp"),
    ("Decoder", "async_tnt.sources.live.datagrams"),
    ("EVENT_BYTES", "async_tnt.sources.live.datagrams"),
    ("read_nmnist", "async_tnt.sources.files.nmnist"),
]
"""Public name of version 0.2, and what the error says instead."""


@pytest.mark.parametrize(("name", "instead"), REMOVED)
def test_a_removed_name_says_what_to_write_instead(name, instead):
    with pytest.raises(AttributeError, match=rf"^async_tnt.sources has no '{name}' .*{instead}"):
        getattr(sources, name)
    assert name not in dir(sources)
    assert not hasattr(sources, name)


def test_each_removed_name_is_where_the_error_says():
    from async_tnt.sources.files.nmnist import read_nmnist
    from async_tnt.sources.live.camera_drivers import DRIVERS, CameraCounts
    from async_tnt.sources.live.datagrams import EVENT_BYTES, Decoder
    from async_tnt.sources.live.udp import NetworkCounts
    from async_tnt.sources.pixels.hot_pixels import count_pixels, hot_pixels
    from async_tnt.sources.pixels.pixel_filter import PixelCounts
    from async_tnt.sources.queues.queue import QueueCounters

    found = [read_nmnist, DRIVERS, CameraCounts, EVENT_BYTES, Decoder, NetworkCounts]
    found += [count_pixels, hot_pixels, PixelCounts, QueueCounters]
    assert len(found) == len(REMOVED) - 3  # the first three have no home any more


def test_another_name_is_an_ordinary_mistake():
    with pytest.raises(
        AttributeError, match=r"^module 'async_tnt.sources' has no attribute 'nam'$"
    ):
        sources.nam  # noqa: B018


def test_a_source_error_begins_with_the_source_and_names_parameters_as_asked():
    error = SourceError("", "choose one by {topic}").of("a.bag", "not readable: ")
    assert str(error) == "a.bag: not readable: choose one by `topic`"
    assert error.text({"topic": "--topic"}) == "a.bag: not readable: choose one by --topic"
