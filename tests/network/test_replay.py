"""Replay at recording pace, on a made clock and on the real one; the command `send`."""

import json
import math
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.cli import main, send
from async_tnt.cli.send import even, one_stream
from async_tnt.sources import playback as sources
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.playback import replay
from async_tnt.sources.udp import UdpSource

EVENTS = random_events(2500, duration_us=50_000, start_us=7_000_000)


class Clock:
    """Stands still, but for sleeping, which takes `late_ns` longer than asked."""

    def __init__(self, late_ns=0):
        self.now_ns, self.late_ns, self.n_slept = 123, late_ns, 0

    def monotonic_ns(self):
        return self.now_ns

    def sleep(self, seconds):
        assert seconds > 0
        self.n_slept += 1
        self.now_ns += round(seconds * 1e9) + self.late_ns


@pytest.fixture
def clock(monkeypatch):
    clock = Clock(late_ns=150_000)
    monkeypatch.setattr(sources, "time", clock)
    monkeypatch.setattr(send, "time", clock)
    return clock


@pytest.mark.parametrize("speed", [0.5, 1.0, 7.0])
@pytest.mark.parametrize("size", [1, 60, 2500])
def test_packets_come_when_they_are_due_without_drift(clock, speed, size):
    packets = [EVENTS[first : first + size] for first in range(0, len(EVENTS), size)]
    started_ns, parts = clock.now_ns, []
    for packet in replay(packets, speed):
        due_ns = (int(packet["t"][-1]) - int(EVENTS["t"][0])) * 1000 / speed
        assert 0 <= clock.now_ns - started_ns - due_ns + 1 <= 150_002  # late by one sleep, not by all of them
        assert packet["t"][-1] - packet["t"][0] < 1000
        parts.append(packet)
    assert np.concatenate(parts).tobytes() == EVENTS.tobytes()


def test_a_slow_reader_gets_what_is_overdue_at_once(clock):
    packets = replay(EVENTS)
    next(packets)
    clock.now_ns += 10**9
    n_slept = clock.n_slept
    assert sum(map(len, packets)) > 2000 and clock.n_slept == n_slept


def test_infinite_speed_never_sleeps(clock):
    assert sum(map(len, replay(EVENTS, math.inf))) == len(EVENTS) and clock.n_slept == 0


def test_events_out_of_order_stay_in_their_place(clock):
    t = [0, 5000, 100, 5100, 200, 9000]
    packets = list(replay(events_of(t, [0] * 6, [0] * 6, [0] * 6)))
    assert [packet["t"].tolist() for packet in packets] == [[0], [5000, 100, 5100, 200], [9000]]


def test_replay_takes_recordings_and_paths_and_nothing():
    path = sample_recordings()[7]
    for source in (path, str(path), open_recording(path)):
        assert np.concatenate(list(replay(source, math.inf))).tobytes() == open_recording(path).read().tobytes()
    assert list(replay([EVENTS[:0]])) == []


@pytest.mark.parametrize("speed", [0, -1, math.nan])
def test_speeds_at_which_nothing_comes_are_refused_at_once(speed):
    with pytest.raises(ValueError, match=r"`speed` must be above 0 \(math.inf: as fast as possible\), got"):
        replay(EVENTS, speed)
    with pytest.raises(ValueError, match="`packet_us` must be at least 1, got 0"):
        replay(EVENTS, packet_us=0)


def test_on_the_real_clock():
    started = time.monotonic()
    for _ in replay(EVENTS):
        pass
    took = time.monotonic() - started
    assert 0.049 < took < 5


def test_recordings_in_one_stream_go_on_in_time():
    a, b = events_of([100, 300], [0, 1], [0, 0], [0, 0]), events_of([50, 55], [2, 3], [0, 0], [0, 0])
    assert np.concatenate(list(one_stream([a, a[:0], b], False, 1)))["t"].tolist() == [100, 300, 301, 306]
    assert np.concatenate(list(one_stream([a, b], False, 1000)))["t"].tolist() == [100, 300, 1100, 1105]
    endless = one_stream([a], True, 150)
    assert [next(endless)["t"].tolist() for _ in range(3)] == [[100, 300], [400, 600], [700, 900]]
    assert a["t"].tolist() == [100, 300]


def test_an_even_rate_does_not_drift(clock):
    started_ns, n = clock.now_ns, 0
    for packet in even(iter([EVENTS, EVENTS]), 50_000):
        n += len(packet)
        assert -1 <= clock.now_ns - started_ns - n * 20_000 <= 150_001
        assert len(packet) <= 50
    assert n == 5000


# -- async-tnt send ------------------------------------------------------------------------------------------


def test_send_sends_what_it_says(tmp_path, capsys):
    np.save(tmp_path / "a.npy", EVENTS)
    with UdpSource(port=0, timeout_s=0.15) as source:
        url = f"udp://127.0.0.1:{source.port}"
        assert main(["send", str(tmp_path / "a.npy"), url, "--speed", "inf", "--json"]) == 0
        assert np.concatenate(list(source)).tobytes() == EVENTS.tobytes()
        sent = json.loads(capsys.readouterr().out)
        assert (sent["events"], sent["refused"], sent["bytes"]) == (2500, 0, 2500 * 13)
        assert source.counts.datagrams == sent["datagrams"]


def test_send_the_samples_by_format_and_rate(capsys):
    with UdpSource(port=0, format="spif_t32", timeout_s=0.15) as source:
        url = f"udp://127.0.0.1:{source.port}?format=spif_t32"
        assert main(["send", "samples", url, "--rate", "2e6", "--packet-events", "1000"]) == 0
        n_samples = sum(open_recording(path).n_events for path in sample_recordings().values())
        assert sum(map(len, source)) == n_samples and source.counts.late == 0
    out = capsys.readouterr()
    assert out.out.startswith(f"sent {n_samples:,} events in ") and out.err == ""


@pytest.mark.parametrize(
    "argv, message",
    [
        (["missing.bin", "udp://127.0.0.1:9"], "missing.bin"),
        (["samples", "127.0.0.1:9"], "expected udp://HOST:PORT"),
        (["samples", "udp://127.0.0.1:0"], r"`port` must be in \[1, 65535\]"),
        (["samples", "udp://127.0.0.1:9", "--packet-events", "9000"], r"`packet_events` must be in \[1, 5039\]"),
    ],
)
def test_mistakes_are_one_line(argv, message, capsys):
    assert main(["send", *argv]) == 2
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1 and pytest.importorskip("re").search(message, err)


@pytest.mark.parametrize("flag", [["--speed", "0"], ["--rate", "nan"], ["--speed", "1", "--rate", "5"]])
def test_wrong_flags(flag):
    with pytest.raises(SystemExit) as stopped:
        main(["send", "samples", "udp://127.0.0.1:9", *flag])
    assert stopped.value.code == 2


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to another process")
def test_ctrl_c_says_what_was_sent_and_exits_with_130():
    with UdpSource(port=0) as source:
        argv = [sys.executable, "-m", "async_tnt.cli", "send", "samples", f"udp://127.0.0.1:{source.port}", "--loop"]
        with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as sending:
            try:
                assert source.receive(60) is not None
                sending.send_signal(signal.SIGINT)
                out, err = sending.communicate(timeout=60)
            finally:
                sending.kill()
    assert sending.returncode == 130 and out.startswith("sent ") and err == "async-tnt: interrupted\n"
