"""Stop a stream, continue elsewhere: what a state holds, and which are refused.

That the same volumes and decisions follow, bit for bit, is a law of tests/test_laws.py.
"""

import subprocess
import sys

import numpy as np
import pytest
from deciding import CONFIG, at, key, total_and_size
from made import random_events, random_model

from async_tnt import LeakyIntegrator, Processor
from async_tnt.checked_tensors import read_state, state_bytes


def processor(config=CONFIG, **settings):
    return Processor(config, classifier=total_and_size, **settings)


def restored(state, **settings):
    made = processor(**settings)
    made.restore_state(state)
    return made


def seen(processor, decisions=()):
    return [key(d) for d in decisions], processor.volume().tobytes(), processor.landmark, processor.counts


def test_triggers_are_restored_with_the_stream():
    one = processor(every_us=100)
    one.every_us, one.confidence, one.activity = None, 0.75, LeakyIntegrator(9, 50.0, 2.0)
    other = restored(one.save_state(), every_events=3)
    assert (other.every_us, other.every_events, other.confidence) == (None, None, 0.75)
    assert other.activity == LeakyIntegrator(9, 50.0, 2.0)


def test_which_windows_were_closed_early_is_restored():
    """So that their late events are counted as `dropped_decided` there, too."""
    one = Processor(CONFIG, classifier=lambda volume: [9.0, 0.0], confidence=0.9, every_events=2, hop_us=500)
    one.push(at([0, 1, 1200, 2300]))
    other = Processor(CONFIG, classifier=lambda volume: [9.0, 0.0], hop_us=500)
    other.restore_state(one.save_state())
    for stream in (one, other):
        stream.push(at([2, 3, 4, 1201]))
        assert (stream.counts.dropped_decided, stream.counts.dropped_late) == (3, 1)


# -- what is refused -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"config": CONFIG.replace(bins=3)}, r"bins = 9 \(here 3\)"),
        ({"config": CONFIG.replace(representation="count", bins=1)}, r".*representation = 'volume' \(here 'count'\)"),
        ({"hop_us": None}, r"hop_us = 500 \(here 1000\)"),
        ({"late": "drop"}, r"late = 'accept' \(here 'drop'\)"),
    ],
    ids=str,
)
def test_another_configuration_or_other_settings(change, message):
    state = processor(hop_us=500).save_state()
    other = processor(**{"hop_us": 500, **change})
    other.push(at([5]))
    with pytest.raises(ValueError, match=f"`state` is of another processor, with {message}$"):
        other.restore_state(state)
    assert other.counts.received == 1


def test_damage_is_noticed():
    stopped = processor(every_events=5)
    stopped.push(random_events(50, duration_us=900))
    state = stopped.save_state()
    damaged = [state[:cut] for cut in (0, 1, 8, 100, len(state) // 2, len(state) - 1)]
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(state), 200):
        damaged.append(state[:place] + bytes([state[place] ^ 1 << int(rng.integers(8))]) + state[place + 1 :])
    for content in damaged:
        with pytest.raises(ValueError, match="`state` "):
            restored(content)
    for nonsense in (b"hello", None):
        with pytest.raises(ValueError, match="`state` must be what `save_state` returned"):
            restored(nonsense)


def test_where_restoring_fails_nothing_has_changed():
    here, untouched = (processor(every_us=777) for _ in range(2))
    stopped = processor(every_us=100)
    for stream in (here, untouched, stopped):
        stream.push(random_events(20, duration_us=100))
    arrays, about = read_state(stopped.save_state())
    for missing in ("counts", "order", "0.slots", "0.cells", "triggers.times", "door"):
        with pytest.raises(ValueError, match="cannot be restored here"):
            here.restore_state(state_bytes({name: a for name, a in arrays.items() if name != missing}, about))
    assert here.every_us == 777
    more = random_events(300, seed=2, duration_us=3000)
    assert seen(here, here.push(more)) == seen(untouched, untouched.push(more))


def test_in_another_process(tmp_path):
    model = random_model(CONFIG, classes=3)
    model.save(tmp_path / "model.safetensors")
    events = random_events(400, seed=5, duration_us=3000)
    np.save(tmp_path / "rest.npy", events[170:])
    here = Processor(model, every_events=10)
    here.push(events[:170])
    (tmp_path / "state").write_bytes(here.save_state())
    code = (
        "import sys, numpy as np, async_tnt; from pathlib import Path; folder = Path(sys.argv[1])\n"
        "p = async_tnt.Processor(async_tnt.load_model(folder / 'model.safetensors'), every_events=10)\n"
        "p.restore_state((folder / 'state').read_bytes())\n"
        "d = p.push(np.load(folder / 'rest.npy')) + p.finish()\n"
        "print([(x.trigger, x.time_us, x.logits.tobytes().hex()) for x in d])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    decisions = here.push(events[170:]) + here.finish()
    assert len(decisions) > 20
    expected = str([(d.trigger, d.time_us, d.logits.tobytes().hex()) for d in decisions])
    assert done.stdout.strip() == expected, done.stderr
