"""Incremental networks have the logits of a whole forward pass, bit for bit.

This holds after any events, windows and copies.
"""

import copy
import itertools
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from deciding import key
from hypothesis import given, settings
from hypothesis import strategies as st
from made import random_events
from networks.cases import DIGITS, LARGE, NETWORKS, SMALL, WINDOW_US, Network
from networks.random_networks import CONFIG, random_models
from oracles import Oracle, as_values
from tnt_reference import LayerNetwork

from async_tnt import (
    CompiledClassifier,
    CompiledNetwork,
    CompiledRegressor,
    Model,
    Processor,
    TNTConfig,
    TNTVolume,
)
from async_tnt.kernels.network import program as P
from async_tnt.kernels.volume import state as S
from async_tnt.networks.models.compiled_network import compiled_network_of
from async_tnt.volume import state as volume_state

DUPLICATES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
}


def logits_after_packets(network: Network, events: np.ndarray, sizes) -> list[bytes]:
    """The logits after each packet of these sizes, held against the whole network's."""
    classifier = network.classifier()
    volume = network.volume()
    seen = []
    first = 0
    for size in itertools.cycle(sizes):
        if first >= len(events):
            return seen
        if size == 1:
            volume.update_one(*events[first].tolist())
        else:
            volume.update(events[first : first + size])
        seen.append(classifier.refresh(volume).tobytes())
        assert seen[-1] == network.dense()(volume.array).tobytes()
        first += size


# -- in any order, with copies ---------------------------------------------------------------------

which = st.integers(0, 1)
steps = st.one_of(
    st.tuples(st.just("refresh"), which, which),
    st.tuples(st.just("packet"), which, st.one_of(st.integers(1, 12), st.integers(13, 700))),
    st.tuples(st.just("one"), which, st.integers(0, 500)),
    st.tuples(st.sampled_from(["array", "open", "close", "reset", "jump", "dense"]), which, which),
    st.tuples(st.just("duplicate"), which, st.sampled_from(sorted(DUPLICATES))),
    st.tuples(st.just("duplicate classifier"), which, st.sampled_from(["deepcopy", "pickle"])),
)


@settings(max_examples=2 * settings.default.max_examples)
@given(st.sampled_from(NETWORKS[:7]), st.lists(steps, min_size=4, max_size=40))
def test_two_volumes_and_two_classifiers_in_any_order(network, script):
    """The volumes are of one shape and two kinds.

    Each has a twin with the same events, whose array only the whole network reads. A copy takes the
    place of the other volume or of the other classifier.
    """
    config = network.config
    other = config.replace(
        polarity="signed", bins=config.channels, landmark="center", remove_flow=False
    )
    seeds = [0, 1]
    classifiers = [network.classifier(0), network.classifier(1)]
    volumes = [network.volume(), network.volume(other)]
    twins = [network.volume(), network.volume(other)]
    now_us = [0, 0]
    for k, (step, v, number) in enumerate(script):
        both = volumes[v], twins[v]
        width, height = config.sensor
        if step == "refresh":
            logits = classifiers[number].refresh(volumes[v])
            assert logits.tobytes() == network.dense(seeds[number])(twins[v].array).tobytes()
        elif step == "packet":
            events = random_events(
                number, seed=k, duration_us=300, sensor=config.sensor, start_us=now_us[v]
            )
            for volume in both:
                volume.update(events)
            now_us[v] += 300
        elif step == "one":
            for volume in both:
                volume.update_one(now_us[v] + number, (k * 7) % width, (k * 5) % height, k % 2)
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
        elif step == "dense":  # the incremental classifier is called with an array in between
            array = np.random.default_rng(k).normal(size=config.shape).astype(np.float32)
            expected = network.dense(seeds[number])(array)
            assert classifiers[number](array).tobytes() == expected.tobytes()
        elif step == "duplicate":
            volumes[1 - v] = DUPLICATES[number](volumes[v])
            twins[1 - v] = copy.deepcopy(twins[v])
            now_us[1 - v] = now_us[v]
        else:
            classifiers[1 - v] = DUPLICATES[number](classifiers[v])
            seeds[1 - v] = seeds[v]
    for v, number in np.ndindex(2, 2):
        logits = classifiers[number].refresh(volumes[v])
        assert logits.tobytes() == network.dense(seeds[number])(twins[v].array).tobytes()
        assert volumes[v].array.tobytes() == twins[v].array.tobytes()


@pytest.mark.parametrize("duplicate", DUPLICATES)
@pytest.mark.parametrize("network", [DIGITS, LARGE], ids=str)
def test_a_classifier_that_goes_from_a_volume_to_its_copy_and_back(network, duplicate):
    """Both have as many events, but other ones. Only the volume itself tells them apart."""
    volume = network.volume()
    classifier = network.classifier()
    width, height = network.config.sensor
    volume.update(random_events(40, seed=1, duration_us=300, sensor=network.config.sensor))
    classifier.refresh(volume)
    both = volume, DUPLICATES[duplicate](volume)
    for k in range(6):
        for n, one in enumerate(both):
            one.update_one(300 + k, width // 2 + k % 3, height // 2 + 2 * n, 1)
        for one in both:
            expected = network.dense()(one.array).tobytes()
            assert classifier.refresh(one).tobytes() == expected
    assert not np.array_equal(both[0].array, both[1].array)


def test_a_classifier_from_another_process_does_not_know_this_ones_windows(monkeypatch):
    """The other process numbers its windows 1, 2, 3 .. too.

    The classifier must not take one of them for a window of the first process.
    """
    classifier = SMALL.classifier()
    volume = SMALL.volume()
    volume.update(random_events(10, seed=1, duration_us=900, sensor=SMALL.config.sensor))
    classifier.refresh(volume)
    parcel = pickle.dumps(classifier)
    number = int(classifier.network.program[P.EPOCH])
    assert number > 0
    # one for `reset`, one for `open`
    monkeypatch.setattr(volume_state, "_epochs", itertools.count(number - 1))
    here = SMALL.volume()
    here.update(random_events(10, seed=2, duration_us=900, sensor=SMALL.config.sensor))
    expected = SMALL.dense()(here.array).tobytes()
    assert pickle.loads(parcel).refresh(here).tobytes() == expected
    vars(classifier._program)["lanes"] = 4
    with pytest.raises(ValueError, match="pickled on a processor with other vector registers"):
        pickle.loads(pickle.dumps(classifier))
    classifier.network.program[P.EPOCH] = number  # had it kept the number, it would have been wrong
    assert classifier.refresh(here).tobytes() != expected


PLAIN = TNTConfig(sensor=(6, 5), grid=(6, 5), bins=2, window_us=1000, transform="none")
"""A place of the volume is a pixel."""


def network_of(kind: str) -> CompiledClassifier | CompiledNetwork:
    """A network whose answer is its volume: its means as logits, a map of objects, or raw."""
    classes = {"logits": ["a", "b"], "objects": ["a"], "raw": []}[kind]
    layers = [{"op": "pick", "name": "last", "inputs": ["volume"], "channels": [0, 1]}]
    if kind == "logits":
        layers.append({"op": "global_average_pool", "name": "mean", "inputs": ["last"]})
    outputs = {"map": "last"} if kind == "raw" else {}
    model = Model(PLAIN, {}, classes, network={"classifier": layers}, outputs=outputs)
    return compiled_network_of(model)


def volume_of(seed: int) -> TNTVolume:
    volume = TNTVolume(PLAIN)
    volume.update(random_events(10, seed=seed, duration_us=900, sensor=PLAIN.sensor))
    return volume


def numbers(answer: np.ndarray | tuple[np.ndarray, ...]) -> bytes:
    return np.array(answer).tobytes()


KINDS = ("logits", "objects", "raw")


@pytest.mark.parametrize("kind", KINDS)
def test_any_network_from_another_process_does_not_know_this_ones_windows(kind, monkeypatch):
    """As above."""
    network = network_of(kind)
    network.refresh(volume_of(1))
    parcel = pickle.dumps(network)
    number = int(network.network.program[P.EPOCH])
    monkeypatch.setattr(volume_state, "_epochs", itertools.count(number - 1))
    here = volume_of(2)
    expected = numbers(network_of(kind)(here.array))
    assert numbers(pickle.loads(parcel).refresh(here)) == expected
    network.network.program[P.EPOCH] = number
    assert numbers(network.refresh(here)) != expected


@pytest.mark.parametrize("duplicate", ["deepcopy", "pickle"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_of_a_network_answers_with_its_own_numbers(kind, duplicate):
    """Although the network has shown a view of its map before."""
    network = network_of(kind)
    first = volume_of(1)
    expected = numbers(network.refresh(first))
    twin = DUPLICATES[duplicate](network)
    second = volume_of(2)
    of_second = numbers(network_of(kind)(second.array))
    assert numbers(twin.refresh(second)) == of_second != expected
    assert numbers(twin(second.array)) == of_second
    assert numbers(network.refresh(first)) == expected


@pytest.mark.parametrize("kind", KINDS)
def test_an_array_is_read_whatever_its_type_and_its_memory(kind):
    network = network_of(kind)
    array = np.random.default_rng(0).integers(-9, 9, PLAIN.shape).astype(np.float32)
    expected = numbers(network(array))
    for other in (np.asfortranarray(array), np.repeat(array, 2, 2)[:, :, ::2], array.astype("f8")):
        other.flags.writeable = False
        assert numbers(network(other)) == expected
        assert numbers(network(np.zeros(PLAIN.shape, np.float32))) != expected


# -- the log, a ring of the newest events' places --------------------------------------------------


LONG_LOG = Network((34, 34), 24, (3, 5, 7), 3, polarity="split")


@pytest.mark.parametrize("network", [NETWORKS[0], NETWORKS[2], LONG_LOG], ids=str)
@pytest.mark.parametrize("more", [-1, 0, 1])
def test_packets_about_as_long_as_the_log_or_as_it_pays_to_follow_it(network, more):
    """So many that they cross the ring's end several times, each time elsewhere, in one window."""
    log = int(network.volume().buffer.view(np.int64)[S.LOG_SIZE])
    n = max(int(np.prod(network.config.shape)) // S.CELLS_PER_LOGGED, 1)
    assert n < log == (1024 if network is LONG_LOG else 512)
    long = [log + more] * 4 + [1] * 5 + [2 * log + more] * 2 + [20 * log, 1, n, 1, 2]
    for sizes in (long, [max(n + more, 1)] * (3 * log // n)):
        sensor = network.config.sensor
        events = random_events(
            sum(sizes), seed=7, duration_us=WINDOW_US - 1, sensor=sensor, start_us=1
        )
        logits_after_packets(network, events, sizes)


def test_a_volume_of_another_shape_is_refused():
    volume = TNTVolume(TNTConfig(polarity="split"))
    for call, argument in ((DIGITS.dense().refresh, volume), (DIGITS.dense(), volume.array)):
        with pytest.raises(
            ValueError, match=r"^`volume` must have shape \(9, 34, 34\), got \(18, 34, 34\)"
        ):
            call(argument)


@settings(max_examples=3 * settings.default.max_examples)
@given(
    random_models(),
    st.integers(0, 10_000),
    st.lists(st.sampled_from([1, 1, 2, 10, 100]), min_size=3, max_size=12),
)
def test_at_every_packet(model, seed, sizes):
    dense = CompiledClassifier(model)
    incremental = CompiledClassifier(model)
    reference = LayerNetwork(model.network["classifier"], model.weights).double().eval()
    volume = TNTVolume(model.config)
    first = 0
    events = random_events(sum(sizes), seed=seed, duration_us=2500, sensor=CONFIG.sensor)
    for size in sizes:
        volume.update(events[first : first + size])
        first += size
        logits = incremental.refresh(volume)
        assert logits.tobytes() == dense(volume.array).tobytes()
        with torch.no_grad():
            expected = reference(torch.tensor(volume.array.copy())[None].double()).flatten().numpy()
        assert np.abs(logits - expected).max() <= 1e-4 * max(1, np.abs(expected).max())


# -- in a Processor, on its compiled and its general path ------------------------------------------


def decide(processor, events, size):
    """size : events in a packet; 0: one by one, by `push_one`."""
    if size == 0:
        decisions = [d for event in events.tolist() for d in processor.push_one(*event)]
    else:
        decisions = [
            d for k in range(0, len(events), size) for d in processor.push(events[k : k + size])
        ]
    return decisions + processor.finish()


@pytest.mark.parametrize("network", [*NETWORKS, LARGE], ids=str)
def test_decisions_after_every_event_are_those_of_a_plain_loop(network):
    """One event at a time, and the whole network each time."""
    n = 24 if network is LARGE else 300
    events = random_events(n, seed=1, duration_us=2 * WINDOW_US + 900, sensor=network.config.sensor)
    regressor = CompiledRegressor(network.model()) if network.config.needs_regressor else None
    oracle = Oracle(network.config, network.dense(), regressor=regressor, every_events=1)
    expected = oracle.push_all(events) + oracle.finish()
    assert len(expected) == n + 3  # two closed windows and the end
    assert len({logits for *_, logits in expected}) > 0.4 * n  # most events change them
    for size in (0, 7, n):
        assert [
            as_values(d) for d in decide(Processor(network.model(), every_events=1), events, size)
        ] == expected


@pytest.mark.parametrize("settings", [{"every_events": 1}, {"confidence": 0.9}], ids=str)
def test_processors_in_threads_decide_as_one_after_the_other(settings):
    n_threads = 4
    together = threading.Barrier(n_threads)

    def work(seed, wait=lambda: None):
        processor = Processor(DIGITS.model(seed), **settings)
        events = random_events(700, seed=seed, duration_us=10_000)
        wait()
        return [key(d) for d in decide(processor, events, 300)]

    expected = [work(seed) for seed in range(n_threads)]
    with ThreadPoolExecutor(n_threads) as threads:
        found = threads.map(lambda seed: work(seed, together.wait), range(n_threads))
        assert list(found) == expected
    assert len({str(decisions) for decisions in expected}) == n_threads  # none has another one's
