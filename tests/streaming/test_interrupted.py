"""Ctrl-C at any moment leaves a Processor that goes on as after some part of the packet.

CPython handles signals where a function of Python starts, after a call of any other function, and
where a loop jumps back. An exception is raised at each of these moments within a call, one after
the other.
"""

import dis
import functools
import itertools
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from deciding import CONFIG, key, total_and_size
from made import random_events, random_model, random_regressor_model

import async_tnt
from async_tnt import Processor, TNTVolume

FOLDER = str(Path(async_tnt.__file__).parent)
EVENTS = random_events(40, seed=4, duration_us=5_500)
BEFORE = EVENTS[:14]
PACKET = EVENTS[14:24]
AFTER = EVENTS[24:]
# a way back to earlier times, within the open windows and before them
PACKET["t"][[3, 8]] -= [40, 900]


class Interrupted(BaseException):
    """Stands for KeyboardInterrupt, which would also end pytest."""


@functools.cache
def handles_signals(code):
    """For each instruction of a function, whether CPython may handle a signal right after it."""
    return {
        one.offset: one.opname.startswith(("CALL", "JUMP_BACKWARD"))
        and one.opname != "CALL_INTRINSIC_1"
        for one in dis.get_instructions(code)
    }


def interrupted(call, at):
    """Raise within `call` at moment number `at` in the package; returns whether it had so many."""
    left = at
    callers = set()  # frames whose newest call is of a function of Python

    def moment():
        nonlocal left
        left -= 1
        if left == 0:
            sys.settrace(None)
            raise Interrupted

    def trace(frame, event, _):
        callers.add(frame.f_back)
        code = frame.f_code
        # what repairs the state is not interrupted itself
        if not code.co_filename.startswith(FOLDER) or code.co_name in (
            "_recover",
            "recover",
            "overlap",
        ):
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        before = -1  # the instruction

        def trace_instructions(frame, event, _):
            nonlocal before
            if event == "opcode":
                if handles_signals(code).get(before) and frame not in callers:
                    moment()
                callers.discard(frame)
                before = frame.f_lasti
            return trace_instructions

        moment()
        return trace_instructions

    sys.settrace(trace)
    try:
        call()
    except Interrupted:
        return True
    finally:
        sys.settrace(None)
    return False


# thousands of copies are made, and decide: the networks are small
MODEL = random_model(CONFIG, widths=(3, 4, 5))
MAKERS = {
    "plain": lambda: Processor(MODEL),
    "every_us": lambda: Processor(MODEL, every_us=300),
    "every_events": lambda: Processor(MODEL, every_events=3),
    "confidence": lambda: Processor(MODEL, confidence=0.3),
    "overlap": lambda: Processor(MODEL, hop_us=300),
    "overlap, every_us": lambda: Processor(
        CONFIG, classifier=total_and_size, hop_us=300, every_us=200
    ),
    "window_events": lambda: Processor(
        CONFIG.replace(window_events=7), classifier=total_and_size, every_events=2
    ),
    "landmark window": lambda: Processor(
        CONFIG.replace(landmark="window"), classifier=total_and_size, every_events=4
    ),
    "regressor": lambda: Processor(
        random_regressor_model(
            CONFIG.replace(landmark="regressor"), widths=(3, 4, 5), regressor_widths=(3, 3, 3)
        ),
        every_us=300,
    ),
    "late drop": lambda: Processor(MODEL, late="drop", every_us=300),
}


def copies(start):
    """A function that makes copies, each in a fifth of the time of `copy.deepcopy`."""
    return functools.partial(pickle.loads, pickle.dumps(start))


def rest(processor):
    """How it goes on: later decisions, and the counts at the end."""
    decisions = [key(d) for d in processor.push(AFTER)]
    decisions += [key(d) for d in processor.finish()]
    return decisions, processor.counts


# Where there are thousands of moments, only every so many are interrupted.
STEPS = {
    "window_events": 3,
    "overlap": 11,
    "overlap, every_us": 11,
    "regressor": 7,
    "landmark window": 3,
}


def ends_alike(one, other):
    n = min(len(one), len(other))
    return one[len(one) - n :] == other[len(other) - n :]


# "late drop" is left out: it counts the late events of the whole packet.
@pytest.mark.parametrize("name", sorted(MAKERS.keys() - {"late drop"}))
def test_an_interrupted_push_is_a_push_of_some_first_events(name):
    start = MAKERS[name]()
    start.push(BEFORE)
    copy = copies(start)
    expected = {}
    for n in range(len(PACKET) + 1):
        processor = copy()
        processor.push(PACKET[:n])
        expected.setdefault(processor.counts.received, []).append(rest(processor))
    n_interrupted = 0
    for at in itertools.count(1, STEPS.get(name, 1)):
        processor = copy()
        if not interrupted(lambda p=processor: p.push(PACKET), at):
            break
        n_interrupted += 1
        n_received = processor.counts.received
        processor.fire()
        decisions, counts = rest(processor)
        # decisions that had been made when the exception came are lost, or made again
        assert any(
            counts == counts_then
            and abs(len(later) - len(decisions)) <= 8
            and ends_alike(later, decisions)
            for later, counts_then in expected[n_received]
        ), f"moment {at}"
    assert n_interrupted > 15


def test_a_window_that_began_for_a_lost_event_begins_again():
    """The first window begins at the first event."""
    for make in (MAKERS["plain"], MAKERS["overlap"], MAKERS["window_events"]):
        for at in itertools.count(1):
            processor = make()
            if not interrupted(lambda p=processor: p.push(PACKET), at):
                break
            if processor.counts.received:
                break
            assert rest(processor) == rest(make()), f"moment {at}"


@pytest.mark.parametrize("name", MAKERS)
def test_single_events_and_the_end_may_be_interrupted_too(name):
    """Each event is there once or not at all, and the end may be asked for again."""
    start = MAKERS[name]()
    start.push(BEFORE)
    for event in PACKET.tolist()[:6]:
        copy = copies(start)
        for at in itertools.count(1, STEPS.get(name, 1)):
            processor = copy()
            if not interrupted(lambda p=processor, e=event: p.push_one(*e), at):
                break
            assert processor.counts.received - start.counts.received in (0, 1)
            rest(processor)
        start.push_one(*event)
    copy = copies(start)
    for at in itertools.count(1):
        processor = copy()
        if not interrupted(processor.finish, at):
            break
        processor.finish()
        assert processor.fire().events == 0 and len(processor._windows) == 0
        processor.reset()
        assert processor.counts.received == 0
        assert len(processor.push(EVENTS) + processor.finish()) > 1


@pytest.mark.parametrize("settings", [{}, {"landmark": "window"}, {"window_events": 7}], ids=str)
def test_an_interrupted_volume_reads_as_after_some_first_events(settings):
    config = CONFIG.replace(**settings)
    start = TNTVolume(config)
    start.update(BEFORE)
    copy = copies(start)
    expected = set()
    for n in range(len(PACKET) + 1):
        volume = copy()
        volume.update(PACKET[:n])
        expected.add((volume.array.tobytes(), volume.counts))
    for read in (
        lambda v: v.update(PACKET),
        lambda v: (v.update(PACKET), v.array),
        lambda v: (v.update(PACKET), v.counts),
    ):
        for at in itertools.count(1):
            volume = copy()
            if not interrupted(lambda v=volume, r=read: r(v), at):
                break
            seen = volume.array.tobytes(), volume.counts
            is_empty = volume.n_events == 0 and not volume.array.any()
            assert seen in expected or (
                is_empty and seen[1] in [counts for _, counts in expected]
            ), f"moment {at}"
            volume.update(AFTER)
            assert np.isfinite(volume.array).all()
    assert at > 10
