"""faery's UDP encoder to our source, our sender to faery's decoder: event for event, on loopback."""

import gc

import numpy as np
import pytest
from listening import free_port, wait_for_listener
from made import events_of, random_events
from waiting import meanwhile

from async_tnt.sources import UdpSender, UdpSource

faery = pytest.importorskip("faery", reason="needs the extra `files`")

# faery leaves its sockets to the garbage collector
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
LONG_FORMAT, SHORT_FORMAT = ("t64_x16_y16_on8", "t32_x16_y15_on1")
STREAMS = {
    "random": random_events(2500, sensor=(1280, 720), start_us=1_000),
    # 32 bits of time wrap after 71 minutes: at the start of a datagram, as faery sees no wrap within one
    "wrap": events_of(2**32 - 100 + np.arange(200), [1] * 200, [2] * 200, [1] * 200),
}
of_all = pytest.mark.parametrize(
    ("events", "format"),
    [(STREAMS["random"], LONG_FORMAT), (STREAMS["random"], SHORT_FORMAT), (STREAMS["wrap"], SHORT_FORMAT)],
)


@pytest.fixture(autouse=True, scope="module")
def collect_faerys_sockets():
    """Here, where the warning does no harm."""
    yield
    gc.collect()


def as_faery(events):
    """Our records under faery's names."""
    array = np.zeros(len(events), faery.EVENTS_DTYPE)
    array["t"], array["x"], array["y"], array["on"] = events["t"], events["x"], events["y"], events["p"] == 1
    return array


@of_all
def test_what_faery_sends_arrives(events, format):
    with UdpSource(port=0, format=format, timeout_s=0.3) as source:
        stream = faery.events_stream_from_array(as_faery(events), dimensions=(1 << 15, 1 << 15))
        stream.to_udp(("127.0.0.1", source.port), format=format)
        assert np.concatenate(list(source)).tobytes() == events.tobytes()
        assert source.counts.malformed == source.counts.late == 0


@of_all
def test_what_we_send_arrives_at_faery(events, format):
    port = free_port()

    def send():
        wait_for_listener(port)  # faery passes over the empty datagram
        with UdpSender(port=port, format=format) as sender:
            sender.send(events)

    packets = []
    stream = iter(faery.events_stream_from_udp((1 << 15, 1 << 15), ("127.0.0.1", port), format))
    with meanwhile(send):
        while sum(map(len, packets)) < len(events):  # it never ends by itself
            packets.append(next(stream))
        stream.close()
    assert np.concatenate(packets).tolist() == as_faery(events).tolist()
