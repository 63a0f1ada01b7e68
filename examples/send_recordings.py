"""Send recordings over the network at their own speed, as UDP datagrams: something to receive
without a camera.

    python send_recordings.py udp://127.0.0.1:3333                    the bundled samples, one after
                                                                      the other
    python send_recordings.py udp://10.0.0.7:3333?format=spif a.bin   a recording, in another format

`async-tnt run udp://127.0.0.1:3333` receives them. Each recording starts with a new window of the
receiver.
"""

import socket
import sys
from urllib.parse import parse_qs, urlsplit

from async_tnt.sources import encode, open_recording, replay, sample_recordings

WINDOW_US = 105_000
DATAGRAM_EVENTS = 100  # 1300 bytes of the longest format: fits Ethernet's 1500 with all headers

url = urlsplit(sys.argv[1] if len(sys.argv) > 1 else "udp://127.0.0.1:3333")
format = parse_qs(url.query).get("format", ["t64_x16_y16_on8"])[0]
paths = sys.argv[2:] or sample_recordings().values()


def one_after_the_other():
    start_us = 0
    for path in paths:
        events = open_recording(path).read()
        if not len(events):
            continue
        events["t"] += start_us - events["t"].min()
        yield events
        # the next recording begins at the end of the last window with an event
        n_windows = int(events["t"].max()) // WINDOW_US + 1
        start_us = n_windows * WINDOW_US


n_events = 0
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
    for packet in replay(one_after_the_other()):
        for first in range(0, len(packet), DATAGRAM_EVENTS):
            datagram = encode(packet[first : first + DATAGRAM_EVENTS], format)
            sender.sendto(datagram, (url.hostname, url.port))
        n_events += len(packet)
print(f"sent {n_events:,} events to {url.hostname}:{url.port}")
