"""Events over the network: UDP datagrams in, packets out (`UdpSource`), and the other way round (`UdpSender`)."""

from .counts import NetworkCounts
from .datagrams import EVENT_BYTES, Decoded, Decoder, decode, encode
from .sender import UdpSender
from .udp_source import UdpSource, open_udp
from .url import UdpUrl, parse_udp_url

__all__ = [
    "EVENT_BYTES",
    "Decoded",
    "Decoder",
    "NetworkCounts",
    "UdpSender",
    "UdpSource",
    "UdpUrl",
    "decode",
    "encode",
    "open_udp",
    "parse_udp_url",
]
