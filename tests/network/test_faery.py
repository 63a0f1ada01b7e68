"""faery's UDP encoder to our source, our sender to faery's decoder: event for event, on loopback."""

import gc
import threading

import numpy as np
import pytest
from listening import free_port, wait_for_listener
from made import events_of, random_events

from async_tnt.sources.udp import UdpSource
from async_tnt.sources.udp_sender import UdpSender

faery = pytest.importorskip("faery", reason="needs the extra `files`")

# faery leaves its sockets to the garbage collector
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
FORMATS = ("t64_x16_y16_on8", "t32_x16_y15_on1")
EVENTS = random_events(2500, sensor=(1280, 720), start_us=1_000)


@pytest.fixture(autouse=True)
def collect_faerys_sockets():
    """Here, where the warning of it does no harm."""
    yield
    gc.collect()


def as_faery(events):
    """Our records under faery's names."""
    array = np.zeros(len(events), faery.EVENTS_DTYPE)
    array["t"], array["x"], array["y"], array["on"] = events["t"], events["x"], events["y"], events["p"] == 1
    return array


def from_faery(events, format):
    """What our source gets when faery sends these."""
    with UdpSource(port=0, format=format, timeout_s=0.3) as source:
        stream = faery.events_stream_from_array(as_faery(events), dimensions=(1 << 15, 1 << 15))
        stream.to_udp(("127.0.0.1", source.port), format=format)
        packets = list(source)
        assert source.counts.malformed == source.counts.late == 0
    return np.concatenate(packets)


def to_faery(events, format):
    """What faery's decoder gets when we send these."""
    port = free_port()

    def send():
        wait_for_listener(port)  # faery passes over the empty datagram
        with UdpSender(port=port, format=format) as sender:
            sender.send(events)

    packets, n = [], 0
    stream = iter(faery.events_stream_from_udp((1 << 15, 1 << 15), ("127.0.0.1", port), format))
    sending = threading.Thread(target=send)
    sending.start()
    for packet in stream:  # never ends by itself
        packets.append(packet)
        n += len(packet)
        if n >= len(events):
            break
    stream.close()
    sending.join()
    return np.concatenate(packets)


@pytest.mark.parametrize("format", FORMATS)
def test_what_faery_sends_arrives(format):
    assert from_faery(EVENTS, format).tobytes() == EVENTS.tobytes()


@pytest.mark.parametrize("format", FORMATS)
def test_what_we_send_arrives_at_faery(format):
    got = to_faery(EVENTS, format)
    assert got.tolist() == as_faery(EVENTS).tolist() and len(got) == 2500


def test_an_hour_and_a_half_goes_both_ways():
    """32 bits of time wrap after 71 minutes: at the start of a datagram, as faery sees no wrap within one."""
    events = events_of(2**32 - 100 + np.arange(200), [1] * 200, [2] * 200, [1] * 200)
    assert to_faery(events, FORMATS[1]).tolist() == as_faery(events).tolist()
    assert from_faery(events, FORMATS[1]).tobytes() == events.tobytes()
