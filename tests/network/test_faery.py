"""faery's UDP encoder to our source, event for event, on loopback.

Our sender writes the same formats: what it sends, our source decodes to the same events (test_udp_source.py).
"""

import gc

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.sources import UdpSource

faery = pytest.importorskip("faery", reason="needs the extra `files`")

# faery leaves its sockets to the garbage collector
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
RANDOM = random_events(2500, sensor=(1280, 720), start_us=1_000)
# 32 bits of time wrap after 71 minutes: at the start of a datagram, as faery sees no wrap within one
WRAP = events_of(2**32 - 100 + np.arange(200), [1] * 200, [2] * 200, [1] * 200)


@pytest.fixture(autouse=True, scope="module")
def collect_faerys_sockets():
    """Here, where the warning does no harm."""
    yield
    gc.collect()


@pytest.mark.parametrize(
    ("events", "format"), [(RANDOM, "t64_x16_y16_on8"), (RANDOM, "t32_x16_y15_on1"), (WRAP, "t32_x16_y15_on1")]
)
def test_what_faery_sends_arrives(events, format):
    array = np.zeros(len(events), faery.EVENTS_DTYPE)
    array["t"], array["x"], array["y"], array["on"] = events["t"], events["x"], events["y"], events["p"] == 1
    with UdpSource(port=0, format=format, timeout_s=0.3) as source:
        stream = faery.events_stream_from_array(array, dimensions=(1 << 15, 1 << 15))
        stream.to_udp(("127.0.0.1", source.port), format=format)
        assert np.concatenate(list(source)).tobytes() == events.tobytes()
        assert source.counts.malformed == source.counts.late == 0
