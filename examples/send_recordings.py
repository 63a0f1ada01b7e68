"""Send recordings over the network at their own speed, as UDP datagrams: something to receive without a camera.

    python send_recordings.py udp://127.0.0.1:3333                    the bundled samples, one after the other
    python send_recordings.py udp://10.0.0.7:3333?format=spif a.bin   a recording, in another format

`async-tnt run udp://127.0.0.1:3333` receives them. Each recording starts with a new window of the receiver.
"""

import sys

from async_tnt.sources import UdpSender, open_recording, parse_udp_url, replay, sample_recordings

WINDOW_US = 105_000

url = parse_udp_url(sys.argv[1] if len(sys.argv) > 1 else "udp://127.0.0.1:3333")
paths = sys.argv[2:] or sample_recordings().values()


def one_after_the_other():
    start_us = 0
    for path in paths:
        events = open_recording(path).read()
        events["t"] += start_us - events["t"].min()
        yield events
        start_us = -(-(int(events["t"].max()) + 1) // WINDOW_US) * WINDOW_US


with UdpSender(url.host, url.port, url.format) as sender:
    for packet in replay(one_after_the_other()):
        sender.send(packet)
sent = f"{sender.events:,} events in {sender.datagrams:,} datagrams"
print(f"sent {sent} to {url.host}:{url.port}, {sender.refused} refused")
