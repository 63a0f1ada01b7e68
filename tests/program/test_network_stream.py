"""`async-tnt run` of a stream from the network."""

import json
import re
import threading
from types import SimpleNamespace

import pytest
from listening import free_port, sent
from waiting import PATIENCE_S

from async_tnt import Processor, load_model
from async_tnt.cli.packets import check_sources
from async_tnt.sources import Pixels, UdpSource, open_source
from async_tnt.sources.files.recording import READERS, open_recording, sample_recordings
from async_tnt.sources.pixels.model_pixels import ModelPixels
from async_tnt.sources.queues.keep_up import KeepUp

EVENTS = open_recording(sample_recordings()[7]).read()


@pytest.mark.parametrize(
    "options", ["--confidence 0.9", "--keep-up 60000 --roi 60,0,34,34 --crop --sensor 100x40"]
)
def test_a_stream_from_the_network_gives_the_decisions_of_its_file(options, program):
    events = EVENTS.copy()
    events["x"] += 60 if "--roi" in options else 0
    with sent(events) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=3"
        code, out, err = program("run", url, "--json", "--every-us", 20_000, *options.split())
    confidence = 0.9 if "--confidence" in options else None
    processor = Processor(load_model("digits"), every_us=20_000, confidence=confidence)
    expected = processor.push(EVENTS) + processor.finish()
    got = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    assert [(d["trigger"], d["time_us"], d["label"], d["events"]) for d in got] == [
        (d.trigger, d.time_us, d.label, d.events) for d in expected
    ]
    assert f"listening at udp://127.0.0.1:{port}" in err
    assert f"{len(EVENTS):,} events (0 malformed" in err
    counts = processor.counts
    n_decided = counts.dropped_decided
    n_moved_off = counts.dropped_outside + counts.dropped_tau_zero
    assert counts.dropped_outside > 0 < counts.dropped_tau_zero
    assert (
        f"; {counts.kept:,} kept, {n_moved_off:,} moved off the grid by the transform, "
        f"0 too late for their window, {n_decided:,} after it was decided\n"
    ) in err
    assert (n_decided > 1000) == ("--confidence" in options)
    assert ("left out: 0 outside of the region" in err) == ("--roi" in options)
    keeps_up = "--keep-up" in options
    assert ("0 skipped to stay fresh" in err) == keeps_up
    assert all(d["n_skipped"] == 0 if keeps_up else "n_skipped" not in d for d in got)


def test_a_stream_after_a_recording_has_windows_and_counts_of_its_own(program):
    """The recording's window would have gone on for some events of the stream."""
    recording = sample_recordings()[3]
    with sent(EVENTS) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=1"
        code, out, err = program("run", recording, url, "--json")
    processor = Processor(load_model("digits"))
    expected = processor.push(EVENTS) + processor.finish()
    got = [json.loads(line) for line in out.splitlines()]
    assert code == 0 and got[0]["recording"] == str(recording)
    assert [(d["window_start_us"], d["events"]) for d in got if d["recording"] == url] == [
        (d.window_start_us, d.events) for d in expected
    ]
    assert f"; {processor.counts.kept:,} kept, " in err


@pytest.mark.parametrize("command", ["run", "record --class a --sensor 34x34 --out gestures"])
@pytest.mark.parametrize("address", ["127.0.0.1", "[::1]"])
def test_a_port_that_the_system_chooses_is_told(command, address, program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    url = f"udp://{address}:0?timeout_s=.01"
    try:
        open_source(url).close()
    except OSError:
        pytest.skip(f"no {address} here")
    name, *rest = command.split()
    _, _, err = program(name, url, *rest)
    ports = re.findall(re.escape(f"udp://{address}:") + r"(\d+)\b", err)
    assert len(ports) == 2 and len(set(ports)) == 1 and int(ports[0]) > 0


@pytest.mark.parametrize(
    ("every", "rarer"), [((), ""), (("--every-us", 20_000), ", decisions up to 2 times rarer")]
)
@pytest.mark.parametrize(("keep_up_ms", "n_skipped"), [(31, 0), (29, 800)])
def test_packets_older_than_keep_up_milliseconds_are_skipped(
    keep_up_ms, n_skipped, every, rarer, program, monkeypatch
):
    """Only the newest packet is kept.

    Three packets wait for 30 ms, of a simulated clock, before the first is read.
    """
    now_us = [1_000_000]
    have_waited = threading.Event()
    clock = SimpleNamespace(monotonic_ns=lambda: 1_000 * now_us[0])
    for module in ("queue", "keep_up"):
        monkeypatch.setattr(f"async_tnt.sources.queues.{module}.time", clock)

    class Source:
        name = "camera"
        sensor = 34, 34

        def __iter__(self):
            yield from (EVENTS[:400], EVENTS[400:800], EVENTS[800:])
            now_us[0] += 30_000
            have_waited.set()

        def close(self):
            pass

        def summary(self):
            return "closed"

    class KeepUpLate(KeepUp):
        def __init__(self, *given, **settings):
            super().__init__(*given, **settings)
            assert have_waited.wait(PATIENCE_S)

    monkeypatch.setattr("async_tnt.sources.queues.keep_up.KeepUp", KeepUpLate)
    monkeypatch.setattr("async_tnt.cli.packets.open_source", lambda *_: Source())
    code, _, err = program("run", "camera", "--keep-up", keep_up_ms, *every)
    told = f"closed; {n_skipped} skipped to stay fresh, at most 30.0 ms waited{rarer}"
    assert code == 0 and re.search(rf"{re.escape(told)}(;|$)", err, re.MULTILINE)


def test_keep_up_may_be_given_for_a_stream_among_recordings(program):
    words = "run", sample_recordings()[7], "udp://127.0.0.1:0?timeout_s=.01"
    _, out, err = program(*words, "--keep-up", 60_000)
    assert out and "0 skipped to stay fresh" in err and "--keep-up belongs" not in err


def test_of_sources_that_cannot_be_opened_the_last_is_the_error_and_the_others_are_told(
    tmp_path, capsys
):
    pixels = ModelPixels(Pixels(), (34, 34))
    port = free_port()
    url = f"udp://127.0.0.1:{port}"
    paths = [tmp_path / "a.npy", url + "?format=jpeg", tmp_path / "b.npy"]
    with pytest.raises(FileNotFoundError, match=r"b\.npy"):
        check_sources(paths, pixels)
    first, second = capsys.readouterr().err.splitlines()
    assert "a.npy" in first and "`format` must be one of" in second
    # the first that can be opened is closed again, and the others are not tried
    check_sources([tmp_path / "a.npy", url, tmp_path / "b.npy"], pixels)
    check_sources([sample_recordings()[7], tmp_path / "b.npy"], pixels)
    UdpSource(port=port).close()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("error", [ValueError, OSError, ImportError, MemoryError])
def test_the_search_for_a_source_goes_on_after_any_error(error, tmp_path, monkeypatch):
    def read(path, options):
        raise error("no such luck")

    monkeypatch.setitem(READERS, ".own", read)
    own = tmp_path / "a.own"
    own.touch()
    pixels = ModelPixels(Pixels(), (34, 34))
    check_sources([own, sample_recordings()[7]], pixels)
    with pytest.raises(error, match="no such luck"):
        check_sources([own], pixels)


@pytest.mark.parametrize("keep_up", [(), ("--keep-up", 60_000)])
def test_when_decisions_fail_the_source_is_closed_and_counted(keep_up, program, monkeypatch):
    """A source that waits for its next packet is woken by that."""
    closed = threading.Event()

    class Source:
        name = "camera"
        sensor = 34, 34

        def __iter__(self):
            yield EVENTS[:400]
            yield ([-1], [0], [0], [1])  # no time
            assert closed.wait(PATIENCE_S)

        def close(self):
            closed.set()

        def summary(self):
            return "3 packets"

    monkeypatch.setattr("async_tnt.cli.packets.open_source", lambda *_: Source())
    code, _, err = program("run", "camera", *keep_up)
    assert code == 2 and closed.is_set() and "camera: 3 packets" in err
    assert "`t` must be" in err.splitlines()[-1]
