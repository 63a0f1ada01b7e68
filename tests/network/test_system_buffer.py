"""What the system threw away: its counter as it reports it."""

import struct
from types import SimpleNamespace

import pytest

from async_tnt.sources import udp_socket
from async_tnt.sources.udp_socket import LostDatagrams


class Socket:
    """Answers as the system does: what it is given, one after the other, then as a closed one."""

    def __init__(self, *answers):
        self._answers = list(answers)

    def getsockopt(self, *_):
        if not self._answers:
            raise OSError(9, "Bad file descriptor")
        return self._answers.pop(0)


def meminfo(dropped):
    return struct.pack("=9I", *range(1, 9), dropped)


@pytest.fixture(autouse=True)
def linux(monkeypatch):
    monkeypatch.setattr(udp_socket, "sys", SimpleNamespace(platform="linux"))


def test_a_counter_of_32_bits_goes_on_where_it_wraps():
    reported = [0, 5, 2**32 - 1, 3, 3, 2**32 - 1, 0]
    lost = LostDatagrams(Socket(*map(meminfo, reported)))
    assert [lost.read() for _ in reported] == [0, 5, 2**32 - 1, 2**32 + 3, 2**32 + 3, 2 * 2**32 - 1, 2 * 2**32]


def test_a_closed_socket_keeps_its_last_answer():
    lost = LostDatagrams(Socket(meminfo(7)))
    assert [lost.read(), lost.read()] == [7, 7]


def test_a_system_that_does_not_say(monkeypatch):
    assert LostDatagrams(Socket()).read() is None
    assert LostDatagrams(Socket(bytes(32))).read() is None  # before Linux 4.12: eight numbers
    monkeypatch.setattr(udp_socket, "sys", SimpleNamespace(platform="darwin"))
    assert LostDatagrams(Socket(meminfo(7))).read() is None
