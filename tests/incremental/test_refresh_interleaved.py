"""Readers do not disturb each other: several volumes and classifiers, read and written in any order.

Each volume has a twin that absorbs the same events and is read only by the oracle, from its array.
"""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from incremental.cases import CASES, WINDOW_US, Case, dense_of
from made import random_events

# two kinds of volume of one shape: signed with four bins, and two bins split by polarity
SMALL = (Case((13, 9), 4, "signed", "running", (3, 5, 7), 3), Case((13, 9), 2, "split", "flow", (3, 5, 7), 3))
BIGGER = (Case((40, 30), 4, "signed", "none", (3, 5, 7), 3), Case((40, 30), 2, "split", "running", (3, 5, 7), 3))
REPLAYED = (Case((8, 8), 4, "signed", "window", (3, 5, 7), 3), Case((8, 8), 2, "split", "line", (3, 5, 7), 3))

which = st.integers(0, 1)
steps = st.one_of(
    st.tuples(st.just("refresh"), which, which),
    st.tuples(st.just("packet"), which, st.one_of(st.integers(1, 12), st.integers(13, 700))),
    st.tuples(st.just("one"), which, st.integers(0, 500)),
    st.tuples(
        st.sampled_from(["array", "open", "close", "reset", "jump", "deepcopy", "pickle", "dense"]), which, which
    ),
)


@settings(max_examples=500, deadline=None)
@given(st.sampled_from([SMALL, SMALL, BIGGER, REPLAYED]), st.lists(steps, min_size=4, max_size=40))
def test_two_volumes_and_two_classifiers_in_any_order(cases, script):
    networks = [cases[0].classifier(seed) for seed in (0, 1)]
    dense = [dense_of(cases[0], seed) for seed in (0, 1)]
    volumes, twins = [case.volume() for case in cases], [case.volume() for case in cases]
    now_us = [0, 0]
    for k, (step, v, number) in enumerate(script):
        both = volumes[v], twins[v]
        sensor = cases[v].grid
        if step == "refresh":
            logits = networks[number].refresh(volumes[v])
            assert logits.tobytes() == dense[number](twins[v].array).tobytes()
        elif step == "packet":
            events = random_events(number, seed=k, duration_us=300, sensor=sensor, start_us=now_us[v])
            for volume in both:
                volume.update(events)
            now_us[v] += 300
        elif step == "one":
            for volume in both:
                volume.update_one(now_us[v] + number, (k * 7) % sensor[0], (k * 5) % sensor[1], k % 2)
        elif step == "array":
            assert volumes[v].array.tobytes() == twins[v].array.tobytes()
        elif step == "open":
            for volume in both:
                volume.open(now_us[v])
        elif step in ("close", "reset"):
            for volume in both:
                getattr(volume, step)()
        elif step == "jump":
            now_us[v] += WINDOW_US
        elif step == "deepcopy":
            volumes[v] = copy.deepcopy(volumes[v])
        elif step == "pickle":
            networks[number] = pickle.loads(pickle.dumps(networks[number]))
        else:  # the incremental classifier is called with an array in between
            array = np.random.default_rng(k).normal(size=cases[0].config.shape).astype(np.float32)
            assert networks[number](array).tobytes() == dense[number](array).tobytes()
    for v, number in np.ndindex(2, 2):
        logits = networks[number].refresh(volumes[v])
        assert logits.tobytes() == dense[number](twins[v].array).tobytes()
        assert volumes[v].array.tobytes() == twins[v].array.tobytes()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_one_volume_read_by_two_classifiers_and_as_an_array(case):
    """One reads after every event, one after every fifth, the array is looked at after every third."""
    often, seldom, volume, twin = case.classifier(0), case.classifier(1), case.volume(), case.volume()
    for k, event in enumerate(random_events(90, seed=3, duration_us=5000, sensor=case.config.sensor).tolist()):
        volume.update_one(*event)
        twin.update_one(*event)
        assert often.refresh(volume).tobytes() == dense_of(case, 0)(twin.array).tobytes()
        if k % 5 == 4:
            assert seldom.refresh(volume).tobytes() == dense_of(case, 1)(twin.array).tobytes()
        if k % 3 == 2:
            assert volume.array.tobytes() == twin.array.tobytes()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_one_classifier_that_goes_from_volume_to_volume(case):
    """Each volume's log grows while the classifier reads another volume."""
    network, volumes = case.classifier(), [case.volume() for _ in range(3)]
    events = random_events(240, seed=4, duration_us=5000, sensor=case.config.sensor).tolist()
    for k, event in enumerate(events):
        volumes[k % 3].update_one(*event)
        if k % 4 == 0:
            volume = volumes[k // 4 % 3]
            assert network.refresh(volume).tobytes() == dense_of(case)(volume.array).tobytes()
