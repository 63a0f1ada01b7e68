"""Stop a stream after any event, go on elsewhere: the same volumes and decisions, bit for bit."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from deciding import CONFIG, key, total_and_size
from hypothesis import given, settings
from hypothesis import strategies as st
from made import nasty_streams, random_events, random_model

from async_tnt import LeakyIntegrator, Processor, TNTConfig
from async_tnt.checked_tensors import STATE_FORMAT, checksum, read_state, state_bytes, tensor_bytes

SETTINGS = [
    {},
    {"hop_us": 300},
    {"every_us": 170},
    {"every_events": 7, "late": "drop"},
    {"confidence": 0.35, "every_events": 3},
    {"activity": LeakyIntegrator(5, 300.0), "hop_us": 450},
    {"start_us": 40, "every_us": 90, "hop_us": 999},
]


def seen(processor, decisions):
    return [key(d) for d in decisions], processor.volume().tobytes(), processor.landmark, processor.counts


def go_on(processor, events, size=13):
    decisions = []
    for first in range(0, len(events), size):
        decisions += processor.push(events[first : first + size])
    return decisions


def assert_goes_on_the_same(make, events, stop):
    """An uninterrupted processor against one that was stopped after `stop` events."""
    whole, stopped = make(), make()
    go_on(whole, events[:stop])
    go_on(stopped, events[:stop])
    resumed = make()
    resumed.push(random_events(30, seed=9, duration_us=2000, sensor=(30, 30)))  # what it did before is forgotten
    resumed.restore_state(stopped.save_state())
    assert seen(whole, []) == seen(resumed, []) == seen(stopped, [])
    after = events[stop:]
    assert seen(whole, go_on(whole, after)) == seen(resumed, go_on(resumed, after))
    assert seen(whole, whole.finish()) == seen(resumed, resumed.finish())


@settings(deadline=None, max_examples=60)
@given(nasty_streams((34, 34), 1000, 50), st.integers(0, 60), st.sampled_from(SETTINGS))
def test_nasty_streams(events, stop, settings):
    if settings.get("late") == "drop" or len(events) == 0:
        settings = {}
    assert_goes_on_the_same(lambda: Processor(CONFIG, classifier=total_and_size, **settings), events, stop)


def test_triggers_are_set_as_they_were():
    one = Processor(CONFIG, classifier=total_and_size, every_us=100)
    one.every_us, one.confidence, one.activity = None, 0.75, LeakyIntegrator(9, 50.0, 2.0)
    other = Processor(CONFIG, classifier=total_and_size, every_events=3)
    other.restore_state(one.save_state())
    assert (other.every_us, other.every_events, other.confidence) == (None, None, 0.75)
    assert other.activity == LeakyIntegrator(9, 50.0, 2.0)


def test_in_another_process(tmp_path):
    model = random_model(CONFIG, classes=3)
    model.save(tmp_path / "model.safetensors")
    events = random_events(400, seed=5, duration_us=3000)
    np.save(tmp_path / "rest.npy", events[170:])
    processor = Processor(model, every_events=10)
    processor.push(events[:170])
    (tmp_path / "state").write_bytes(processor.save_state())
    code = (
        "import sys, numpy as np, async_tnt; from pathlib import Path; folder = Path(sys.argv[1])\n"
        "p = async_tnt.Processor(async_tnt.load_model(folder / 'model.safetensors'), every_events=10)\n"
        "p.restore_state((folder / 'state').read_bytes())\n"
        "d = p.push(np.load(folder / 'rest.npy')) + p.finish()\n"
        "print([(x.trigger, x.time_us, x.logits.tobytes().hex()) for x in d])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, timeout=120)
    decisions = processor.push(events[170:]) + processor.finish()
    assert len(decisions) > 20
    assert done.stdout.strip() == str([(d.trigger, d.time_us, d.logits.tobytes().hex()) for d in decisions]), (
        done.stderr
    )


def test_a_state_is_small_where_little_has_happened():
    processor = Processor(CONFIG.replace(sensor=(640, 480), grid=(640, 480)), classifier=total_and_size)
    processor.push(random_events(100, duration_us=900))
    assert len(processor.save_state()) < 20_000


def test_another_configuration_or_other_settings_are_refused():
    state = Processor(CONFIG, classifier=total_and_size, hop_us=500).save_state()
    for other in (
        Processor(CONFIG.replace(bins=3), classifier=total_and_size, hop_us=500),
        Processor(CONFIG, classifier=total_and_size),
        Processor(CONFIG, classifier=total_and_size, hop_us=500, late="drop"),
    ):
        other.push(([5], [5], [5], [1]))
        with pytest.raises(ValueError, match="`state` is of another processor, with "):
            other.restore_state(state)
        assert other.counts.received == 1


def test_more_stored_events_than_there_is_room_for():
    config = CONFIG.replace(landmark="window")
    full = Processor(config, classifier=total_and_size)
    full.push(random_events(100, duration_us=900))
    small = Processor(config, classifier=total_and_size, replay_events=50)
    with pytest.raises(ValueError, match="cannot be restored here: it stores 100 events, but `replay_events` is 50"):
        small.restore_state(full.save_state())
    assert small.counts.received == 0


def test_damage_is_noticed():
    processor = Processor(CONFIG, classifier=total_and_size, every_events=5)
    processor.push(random_events(50, duration_us=900))
    state = processor.save_state()
    rng = np.random.default_rng(0)
    for cut in (0, 1, 8, 100, len(state) // 2, len(state) - 1):
        with pytest.raises(ValueError, match="`state` "):
            Processor(CONFIG, classifier=total_and_size).restore_state(state[:cut])
    for place in rng.integers(0, len(state), 300):
        damaged = bytearray(state)
        damaged[place] ^= 1 << int(rng.integers(8))
        if bytes(damaged) != state:
            with pytest.raises(ValueError, match="`state` "):
                Processor(CONFIG, classifier=total_and_size).restore_state(bytes(damaged))
    for nonsense in (b"", b"hello", "text", None, 5):
        with pytest.raises(ValueError, match="`state` must be what `save_state` returned"):
            Processor(CONFIG, classifier=total_and_size).restore_state(nonsense)


@pytest.mark.parametrize("text", [None, "", "[" * 100_000, "nonsense"], ids=["none", "empty", "deep", "no JSON"])
def test_a_valid_checksum_over_no_state(text):
    metadata = {"format": STATE_FORMAT, "sha256": checksum({}, text or "")} | ({} if text is None else {"about": text})
    with pytest.raises(ValueError, match=r"^`state` is damaged: .+$"):
        read_state(tensor_bytes({}, metadata))


def test_a_state_of_another_type():
    state = tensor_bytes({"slots": np.zeros(4, np.float16)}, {"format": STATE_FORMAT})
    with pytest.raises(ValueError, match="something else: NumPy has no type BF16"):
        read_state(state.replace(b'"F16"', b'"BF16"').replace(state[:8], (state[0] + 1).to_bytes(8, "little"), 1))


def test_what_the_door_dropped_is_remembered():
    model = random_model(CONFIG, classes=3, widths=(3, 4, 5))
    events = random_events(200, seed=5, duration_us=1500, sensor=(30, 30))
    events["t"][[20, 60, 130]] = 3
    assert_goes_on_the_same(lambda: Processor(model, late="drop"), events, 100)
    resumed = Processor(model, late="drop")
    stopped = Processor(model, late="drop")
    stopped.push(events[:100])
    resumed.restore_state(stopped.save_state())
    assert resumed.counts == stopped.counts and resumed.counts.dropped_late == 2


def test_where_restoring_fails_nothing_has_changed():
    model = random_model(CONFIG, classes=3, widths=(3, 4, 5))
    here, there = (Processor(model, every_us=777) for _ in range(2))
    for processor in (here, there):
        processor.push(random_events(20, duration_us=100, sensor=(30, 30)))
    stopped = Processor(model, every_us=100)
    stopped.push(random_events(20, duration_us=100, sensor=(30, 30)))
    arrays, about = read_state(stopped.save_state())
    for missing in ("counts", "order", "0.slots", "0.cells", "triggers.times", "door"):
        with pytest.raises(ValueError, match="cannot be restored here"):
            here.restore_state(state_bytes({name: a for name, a in arrays.items() if name != missing}, about))
    assert here.every_us == 777 and here.counts.received == 20
    more = random_events(300, seed=2, duration_us=3000, sensor=(30, 30))
    assert seen(here, go_on(here, more)) == seen(there, go_on(there, more))


def attracted(volume):
    return [0.3 * float(np.abs(volume).sum()), 2.0]


@pytest.mark.parametrize(
    "landmark, settings",
    [("line", {"confidence": 0.9, "every_us": 130}), ("window", {"hop_us": 400, "every_events": 7})],
)
def test_states_written_by_earlier_versions(landmark, settings):
    """Files of commit 9f851ae, after 90 of these events."""
    config = TNTConfig(sensor=(12, 10), grid=(12, 10), bins=2, window_us=1000, t_max=2.0, landmark=landmark)
    events = random_events(160, seed=1, duration_us=4000, sensor=(12, 10))
    events["t"][::13] = np.maximum(0, events["t"][::13] - 700)
    whole, resumed = (Processor(config, classifier=attracted, **settings) for _ in range(2))
    whole.push(events[:90])
    resumed.restore_state(Path(__file__).with_name("written_before").joinpath(f"{landmark}.state").read_bytes())
    assert whole.fire().events > 10
    assert seen(whole, []) == seen(resumed, [])
    assert seen(whole, go_on(whole, events[90:])) == seen(resumed, go_on(resumed, events[90:]))
