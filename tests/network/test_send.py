"""Playback at recording pace, on a made clock; the command `send`."""

import json
import math
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.cli import send
from async_tnt.sources import UdpSource, open_recording, playback, replay, sample_recordings

EVENTS = random_events(2500, duration_us=50_000, start_us=7_000_000)


class Clock:
    """Stands still, but for sleeping, which takes 150 us longer than asked."""

    now_ns = 123

    def monotonic_ns(self):
        return self.now_ns

    def sleep(self, seconds):
        assert seconds > 0
        self.now_ns += round(seconds * 1e9) + 150_000


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(playback, "time", clock)
    return clock


def at(*times):
    return events_of(times, [0] * len(times), [0] * len(times), [0] * len(times))


@pytest.mark.parametrize(("speed", "size"), [(0.5, 60), (1.0, 1), (7.0, 2500)])
def test_packets_come_when_they_are_due_without_drift(clock, speed, size):
    packets = [EVENTS[first : first + size] for first in range(0, len(EVENTS), size)]
    started_ns, parts = clock.now_ns, []
    for packet in replay(packets, speed):
        due_ns = (int(packet["t"][-1]) - int(EVENTS["t"][0])) * 1000 / speed
        assert 0 <= clock.now_ns - started_ns - due_ns + 1 <= 150_002  # late by one sleep, not by all of them
        assert packet["t"][-1] - packet["t"][0] < 1000
        parts.append(packet)
    assert np.concatenate(parts).tobytes() == EVENTS.tobytes()


@pytest.mark.parametrize(
    ("packets", "played"),
    [
        ([at(0, 5000, 100, 5100, 200, 9000)], [[0], [5000, 100, 5100, 200], [9000]]),
        ([at(0, 5000), at(100, 5100), at(200, 9000)], [[0], [5000], [100, 5100], [200], [9000]]),
        ([at(), at(5), at()], [[5]]),
        ([at()], []),
    ],
)
def test_an_event_out_of_order_is_due_with_the_newest_before(clock, packets, played):
    assert [packet["t"].tolist() for packet in replay(packets)] == played


def test_speeds_at_which_nothing_comes_are_refused_at_once(monkeypatch):
    with pytest.raises(ValueError, match=r"`speed` must be above 0 \(math.inf: as fast as possible\), got"):
        replay(EVENTS, math.nan)
    monkeypatch.setattr("async_tnt.sources.playback.time.sleep", lambda seconds: waited.append(seconds))
    waited = []
    assert list(replay(EVENTS[:2], 1e-310)) and max(waited) < 1 << 33  # what `sleep` can hold
    with pytest.raises(ValueError, match="`packet_us` must be at least 1, got 0"):
        replay(EVENTS, packet_us=0)


def test_recordings_in_one_stream_continue_in_time():
    a, b = at(100, 300), at(50, 55)
    assert np.concatenate(list(send.one_stream([a, a[:0], b], False, 1)))["t"].tolist() == [100, 300, 301, 306]
    assert np.concatenate(list(send.one_stream([a, b], False, 1000)))["t"].tolist() == [100, 300, 1100, 1105]
    endless = send.one_stream([a], True, 150)
    assert [next(endless)["t"].tolist() for _ in range(3)] == [[100, 300], [400, 600], [700, 900]]
    assert a["t"].tolist() == [100, 300]


# -- async-tnt send --------------------------------------------------------------------------------------


def test_send_sends_what_it_reports(tmp_path, program):
    np.save(tmp_path / "a.npy", EVENTS)
    with UdpSource(port=0, timeout_s=0.15) as source:
        code, out, _ = program("send", tmp_path / "a.npy", f"udp://127.0.0.1:{source.port}", "--speed", "inf", "--json")
        assert np.concatenate(list(source)).tobytes() == EVENTS.tobytes()
        sent = json.loads(out)
        assert (code, sent["events"], sent["refused"], sent["bytes"]) == (0, 2500, 0, 2500 * 13)
        assert source.counts.datagrams == sent["datagrams"]


def test_send_the_samples_by_format_and_rate(program):
    with UdpSource(port=0, format="spif_t32", timeout_s=0.15) as source:
        url = f"udp://127.0.0.1:{source.port}?format=spif_t32"
        code, out, err = program("send", "samples", url, "--rate", "2e6", "--packet-events", "1000")
        n_samples = sum(open_recording(path).n_events for path in sample_recordings().values())
        assert sum(map(len, source)) == n_samples and source.counts.late == 0
    assert code == 0 and out.startswith(f"sent {n_samples:,} events in ") and err == ""


@pytest.mark.parametrize(
    "words, message",
    [
        (["missing.bin", "udp://127.0.0.1:9"], "missing.bin"),
        (["samples", "udp://127.0.0.1:0"], r"`port` must be in \[1, 65535\]"),
        (["samples", "udp://127.0.0.1:9", "--packet-events", "9000"], r"`packet_events` must be in \[1, 5039\]"),
    ],
)
def test_mistakes_are_one_line(words, message, program):
    code, _, err = program("send", *words)
    assert code == 2 and len(err.splitlines()) == 1 and re.search(message, err)


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to another process")
def test_ctrl_c_reports_what_was_sent_and_exits_with_130():
    with UdpSource(port=0) as source:
        argv = [sys.executable, "-m", "async_tnt", "send", "samples", f"udp://127.0.0.1:{source.port}", "--loop"]
        with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as sending:
            try:
                assert source.receive(60) is not None
                sending.send_signal(signal.SIGINT)
                out, err = sending.communicate(timeout=60)
            finally:
                sending.kill()
    assert sending.returncode == 130 and out.startswith("sent ") and err == "async-tnt: interrupted\n"
