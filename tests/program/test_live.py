"""`async-tnt run` of a stream from the network, and --live, the view in the terminal."""

import io
import json
import threading
from types import SimpleNamespace

import pytest
from listening import free_port, send_in_parts
from made import random_events, random_model

from async_tnt import Processor, TNTConfig, load_model
from async_tnt.cli.live_view import LiveView
from async_tnt.sources.files.recording import open_recording, sample_recordings

EVENTS = open_recording(sample_recordings()[7]).read()


@pytest.mark.parametrize("options", ["", "--latest 64 --roi 60,0,34,34 --crop --sensor 100x40"])
def test_a_stream_from_the_network_gives_the_decisions_of_its_file(options, program):
    port, sent = free_port(), EVENTS.copy()
    sent["x"] += 60 if "--roi" in options else 0
    sender = threading.Thread(target=send_in_parts, args=(port, sent), daemon=True)  # once somebody listens
    sender.start()
    url = f"udp://127.0.0.1:{port}?timeout_s=1"
    code, out, err = program("run", url, "--json", "--every-us", 20_000, *options.split())
    sender.join()
    processor = Processor(load_model("digits"), every_us=20_000)
    expected = processor.push(EVENTS) + processor.finish()
    got = [json.loads(line) for line in out.splitlines()]
    assert code == 0 and [(d["trigger"], d["time_us"], d["label"], d["events"]) for d in got] == [
        (d.trigger, d.time_us, d.label, d.events) for d in expected
    ]
    assert f"listening at udp://127.0.0.1:{port}" in err and f"{len(EVENTS):,} events (0 malformed" in err
    assert ("0 skipped to stay fresh" in err) == ("--latest" in options)
    assert ("left out: 0 outside of the region" in err) == ("--roi" in options)


def test_the_view_shows_the_newest_decision_and_what_waits():
    rich_console = pytest.importorskip("rich.console", reason="rich is not installed (extra `view`)")
    console = rich_console.Console(file=io.StringIO(), force_terminal=True, width=160, color_system=None)
    model = random_model(TNTConfig(window_us=1000), classes=3)
    processor = Processor(model, every_events=20)
    decisions = processor.push(random_events(100, duration_us=900))
    queue = SimpleNamespace(delay_us=2_500, backlog=1_000, n_skipped=7)
    with LiveView(model.classes, "a recording", console) as view:
        view.show(decisions, 50.0, processor.counts, queue)
    last = console.file.getvalue().split("a recording")[-1]
    assert f"{decisions[-1].label} at 0.001 s, every_events" in last
    assert all(f"{probability:.2f}" in last for probability in decisions[-1].probabilities)
    assert "100 events" in last and "1,000 events waiting, 7 skipped" in last


def test_run_draws_a_recording_at_its_pace(program, monkeypatch):
    pytest.importorskip("rich", reason="rich is not installed (extra `view`)")
    from async_tnt.cli import run

    speeds = []
    replay = run.replay
    monkeypatch.setattr(run, "replay", lambda packets, speed: replay(packets, speeds.append(speed) or 1e9))
    code, out, _ = program("run", "--live", "--speed", "2", sample_recordings()[3])
    assert code == 0 and speeds == [2.0] and "3.bin" in out and "us to a decision" in out and "█" in out
