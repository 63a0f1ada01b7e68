"""async-tnt run udp://...: a stream from the network, on loopback."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from listening import free_port, send_in_parts

from async_tnt import Processor, load_model
from async_tnt.cli import main
from async_tnt.sources.files.recording import open_recording, sample_recordings

EVENTS = open_recording(sample_recordings()[7]).read()


def sending(port, events):
    """A thread that sends once somebody listens."""
    thread = threading.Thread(target=send_in_parts, args=(port, events), daemon=True)
    thread.start()
    return thread


def test_it_decides_what_a_file_gives(capsys):
    port = free_port()
    sender = sending(port, EVENTS)
    assert main(["run", "--json", "--every-us", "20000", f"udp://127.0.0.1:{port}?timeout_s=1"]) == 0
    sender.join()
    out, err = capsys.readouterr()
    got = [json.loads(line) for line in out.splitlines()]
    processor = Processor(load_model("digits"), every_us=20_000)
    expected = processor.push(EVENTS) + processor.finish()
    assert [(d["trigger"], d["time_us"], d["label"], d["events"]) for d in got] == [
        (d.trigger, d.time_us, d.label, d.events) for d in expected
    ]
    assert f"listening at udp://127.0.0.1:{port}" in err and f"{len(EVENTS):,} events (0 malformed" in err


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_it_with_the_counts():
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "async_tnt.cli", "run", f"udp://127.0.0.1:{port}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        line = process.stderr.readline()
        while "listening" not in line and process.poll() is None:  # a cold cache says that it compiles
            line = process.stderr.readline()
        send_in_parts(port, EVENTS)
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "7" in out and f"{len(EVENTS):,} events (0 malformed" in err and "Traceback" not in err


@pytest.mark.parametrize(
    "url, message",
    [
        ("udp://127.0.0.1", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:99999", "expected udp://HOST:PORT"),
        ("tcp://127.0.0.1:5", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:5?format=jpeg", "format"),
        ("udp://203.0.113.1:50000", "203.0.113.1"),
    ],
)
def test_wrong_addresses_are_told_in_one_line(capsys, url, message):
    assert main(["run", url]) == 2
    err = capsys.readouterr().err
    assert message in err and len(err.splitlines()) == 1


def test_a_reader_that_stays_fresh_says_so(capsys):
    port = free_port()
    sender = sending(port, EVENTS)
    options = ["--json", "--latest", "4096", "--every-us", "20000"]
    assert main(["run", *options, f"udp://127.0.0.1:{port}?timeout_s=1"]) == 0
    sender.join()
    out, err = capsys.readouterr()
    got = [json.loads(line) for line in out.splitlines()]
    processor = Processor(load_model("digits"), every_us=20_000)
    expected = processor.push(EVENTS) + processor.finish()
    assert [(d["trigger"], d["label"], d["events"]) for d in got] == [(d.trigger, d.label, d.events) for d in expected]
    assert all(d["n_skipped"] == 0 and d["backlog"] >= 0 and 0 <= d["delay_us"] < 1e6 for d in got[:-1])
    assert "0 skipped to stay fresh" in err and f"{len(EVENTS):,} events" in err


def test_a_region_and_a_mask_of_a_stream(capsys):
    port = free_port()
    moved = EVENTS.copy()
    moved["x"] += 60
    sender = sending(port, moved)
    options = ["--json", "--latest", "64", "--roi", "60,0,34,34", "--crop", "--sensor", "100x40"]
    assert main(["run", *options, f"udp://127.0.0.1:{port}?timeout_s=1"]) == 0
    sender.join()
    out, err = capsys.readouterr()
    processor = Processor(load_model("digits"))
    expected = processor.push(EVENTS) + processor.finish()
    assert [(d["label"], d["events"]) for d in map(json.loads, out.splitlines())] == [
        (d.label, d.events) for d in expected
    ]
    assert "left out: 0 outside of the region" in err


def test_a_region_of_a_stream_whose_sensor_nobody_knows(capsys):
    assert main(["run", f"udp://127.0.0.1:{free_port()}?timeout_s=1", "--roi", "60,0,34,34", "--crop"]) == 2
    assert "does not say the camera's pixels, which --crop needs: give --sensor WxH" in capsys.readouterr().err
