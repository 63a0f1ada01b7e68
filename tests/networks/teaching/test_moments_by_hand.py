"""Moments, margins and rows, with numbers worked out by hand."""

import numpy as np
import pytest

from async_tnt import TNTConfig
from async_tnt.networks.teaching import closed_form
from async_tnt.networks.teaching.closed_form import (
    LEAST_RECORDINGS,
    MARGIN,
    MARGINS,
    RIDGE,
    TAUGHT_SHARE,
    Row,
    choose_margin,
    row_of,
    taken,
)
from async_tnt.networks.teaching.moments import Moments, merged, triangle_size
from async_tnt.networks.teaching.statistics import (
    MAX_BYTES,
    MOST_COMPONENTS,
    Statistics,
    log_sum_exp,
    n_components_for,
    principal_components,
    tensors_of_statistics,
)
from async_tnt.networks.teaching.taught_network import features_layer
from async_tnt.networks.teaching.teach import spread_order
from async_tnt.networks.teaching.window_readings import edges


def test_moments_of_three_vectors():
    """Mean (2, 5); deviations (-1, -3), (0, 0), (1, 3): sums of products 2, 6, 18."""
    moments = Moments.of(np.array([[1, 2], [2, 5], [3, 8]]))
    assert moments.count == 3
    assert moments.mean.tolist() == [2, 5]
    assert moments.scatter.tolist() == [2, 6, 18]
    np.testing.assert_allclose(moments.covariance, [[2 / 3, 2], [2, 6]])
    # the means of 1, 4, 9; of 2, 10, 24; of 4, 25, 64
    expected = [[14 / 3, 12, 2], [12, 31, 5], [2, 5, 1]]
    np.testing.assert_allclose(moments.second, expected, rtol=1e-12)


def test_merged_moments_by_hand():
    """0 and 2 have the mean 1 and the scatter 2; 5 alone: together mean 7/3, scatter 38/3."""
    both = Moments.of(np.array([[0.0], [2.0]])).merged(Moments.of(np.array([[5.0]])))
    assert both.count == 3
    np.testing.assert_allclose(both.mean, [7 / 3], rtol=1e-15)
    np.testing.assert_allclose(both.scatter, [38 / 3], rtol=2**-24)


def test_a_small_variance_beside_a_large_mean_is_kept():
    """A sum of squares of 1e8 + {0, 1} would lose the variance 1/4 in 53 bits after few numbers."""
    vectors = 1e8 + np.arange(1000)[:, None] % 2
    halves = [Moments.of(vectors[:300]), Moments.of(vectors[300:])]
    assert merged(halves).covariance[0, 0] == pytest.approx(0.25, rel=1e-6)


def one_class(*values, s=0.0):
    return Moments.of(np.array([[x, s] for x in values]))


def test_a_row_by_hand():
    """Windows of the class have x = 1, others x = -1, and s = 2 everywhere: r . (x, 1) = 2 + M y.

    The mean of x is w - (1 - w) = 2 w - 1, that of x^2 is 1. With the ridge a = .03 the equations
    (1 + a) r + (2 w - 1) b = E[x t] and (2 w - 1) r + b = E[t], for a target t, give the slope
    r = (E[x t] - (2 w - 1) E[t]) / (1 + a - (2 w - 1)^2). For t = y = x: E[x t] = 1.
    """
    row = row_of(one_class(1.0, s=2.0), [one_class(-1.0, s=2.0)])
    mean = 2 * TAUGHT_SHARE - 1
    slope = (1 - mean**2) / (1 + RIDGE - mean**2)
    np.testing.assert_allclose(row.rise, [slope, mean * (1 - slope)], rtol=1e-12)
    np.testing.assert_allclose(row.level, [0, 2], atol=1e-12)
    np.testing.assert_allclose(row.at(8.0), [8 * slope, 2 + 8 * mean * (1 - slope)], rtol=1e-12)


def test_every_other_class_counts_alike_whatever_number_of_windows_it_has():
    taught = one_class(3.0, 3.5, s=1.0)
    few = one_class(-1.0, 1.0, s=2.0)
    many = one_class(*[-1.0, 1.0] * 500, s=2.0)
    other = one_class(0.5, 0.7, 0.9, s=4.0)
    a = row_of(taught, [few, other])
    b = row_of(taught, [many, other])
    np.testing.assert_allclose(a.rise, b.rise, rtol=1e-6)
    np.testing.assert_allclose(a.level, b.level, rtol=1e-6)


def test_features_that_say_nothing_give_the_share_of_the_class():
    """Without any spread the row is its constant: s + M (w - (1 - w))."""
    row = row_of(one_class(0.0, s=5.0), [one_class(0.0, s=5.0)])
    assert row.at(10.0).tolist() == pytest.approx([0.0, 5 + 10 * (2 * TAUGHT_SHARE - 1)])


@pytest.mark.parametrize(("constant", "expected"), [(3.0, 0.841345), (1.0, 0.158655), (2.0, 0.5)])
def test_the_share_that_is_taken_by_a_normal_distribution(constant, expected):
    """s is 1 or 3, of deviation 1; a logit of 3 lies one deviation above its mean."""
    windows = Moments.of(np.array([[0.0, 1.0], [0.0, 3.0]]))
    row = Row(np.array([0.0, constant]), np.zeros(2))
    assert taken(row, MARGIN, windows) == pytest.approx(expected, abs=1e-6)


def test_windows_that_are_all_alike_are_taken_or_not():
    for constant, expected in ((3.0, 1.0), (1.0, 0.0)):
        row = Row(np.array([0.0, constant]), np.zeros(2))
        assert taken(row, MARGIN, one_class(0.0, s=2.0)) == expected


def test_a_margin_is_chosen_from_five_recordings_on():
    rng = np.random.default_rng(0)

    def recording(mean):
        return np.stack([rng.normal(mean, 1.0, 9), rng.normal(6.0, 0.5, 9)], axis=1)

    others = {"a": Moments.of(recording(-3.0)), None: Moments.of(recording(0.0))}
    for n in range(1, 12):
        choice = choose_margin([recording(3.0) for _ in range(n)], others)
        assert (choice.held_out is None) == (n < LEAST_RECORDINGS)
        if choice.held_out is None:
            assert choice.margin == MARGIN
        else:
            assert 0.5 < choice.held_out <= 1.0


def test_a_class_that_is_not_told_apart_gets_a_smaller_margin():
    """Where windows that are left out lie on the wrong side, a large margin is punished."""
    rng = np.random.default_rng(1)

    def margin(distance):
        recordings = [
            np.stack([rng.normal(distance, 1.0, 9), np.full(9, 6.0)], axis=1) for _ in range(20)
        ]
        other = Moments.of(np.stack([rng.normal(0, 1, 900), np.full(900, 6.0)], axis=1))
        return choose_margin(recordings, {"a": other}).margin

    assert margin(1.0) < margin(3.0) < margin(6.0)


def losses_of(recordings, others):
    """For each M of `MARGINS` the loss of "is it this class", and the share that is right.

    Each recording is left out. A class of the others is taken as normally distributed.
    """
    rest = [Moments.of(one) for one in others]
    whole = row_of(Moments.of(np.concatenate(recordings)), rest)
    z = np.linspace(-9.0, 9.0, 4001)
    density = np.exp(-(z**2) / 2)
    losses = []
    shares = []
    for margin in MARGINS:
        own = []
        for k, left_out in enumerate(recordings):
            kept = np.concatenate([*recordings[:k], *recordings[k + 1 :]])
            own.append(logit_above_s(row_of(Moments.of(kept), rest), margin, left_out))
        own = np.concatenate(own)
        shares.append((own > 0).mean())
        of_classes = [np.logaddexp(0, -own).mean()]
        for one in others:
            theirs = logit_above_s(whole, margin, one)
            at = np.logaddexp(0, theirs.mean() + theirs.std() * z)
            of_classes.append((at * density).sum() / density.sum())
        losses.append(np.mean(of_classes))
    return losses, shares


def logit_above_s(row, margin, u):
    """z - s for vectors u = (x, s)."""
    return u[:, :-1] @ row.at(margin)[:-1] + row.at(margin)[-1] - u[:, -1]


@pytest.mark.parametrize("seed", [1, 3, 6])
def test_the_margin_is_that_of_the_smallest_loss(seed):
    rng = np.random.default_rng(seed)

    def readings(n, distance):
        x = rng.normal(distance, 1.0, (n, 3)) + rng.normal(size=3)
        return np.hstack([x, rng.normal(4.0, 1.5, (n, 1))])

    distance = 0.4 * seed
    recordings = [readings(3, distance) for _ in range(5 + seed)]
    others = [readings(40, 0.0), readings(7, -1.0)]
    losses, shares = losses_of(recordings, others)
    choice = choose_margin(recordings, dict(enumerate(map(Moments.of, others))))
    best = int(np.argmin(losses))
    assert choice.margin == MARGINS[best]
    assert choice.held_out == pytest.approx(shares[best])


def test_many_recordings_are_left_out_in_at_most_twenty_parts(monkeypatch):
    """For each part a row is made of the others, and one row of all."""
    made = []

    def counted(*arguments):
        made.append(arguments)
        return row_of(*arguments)

    monkeypatch.setattr(closed_form, "row_of", counted)
    others = {"a": one_class(-1.0, 1.0)}
    for n, n_rows in ((5, 6), (20, 21), (47, 21)):
        made.clear()
        choose_margin([np.array([[3.0 + k % 2, 1.0]]) for k in range(n)], others)
        assert len(made) == n_rows


def test_log_sum_exp_of_large_logits():
    assert log_sum_exp(np.array([[1000.0, 1000.0], [0.0, -1000.0]])).tolist() == pytest.approx(
        [1000 + np.log(2), 0.0]
    )


def test_principal_components_by_hand():
    """Classes at (0, 0) and (6, 0) whose windows lie 1 above and below: first x, then y."""
    features = [Moments.of(np.array([[x, -1.0], [x, 1.0]] * n)) for x, n in ((0.0, 1), (6.0, 50))]
    center, projection = principal_components(features, 2)
    assert center.tolist() == [3, 0]
    np.testing.assert_allclose(projection, np.eye(2), atol=1e-7)


def test_principal_components_of_few_readings_are_those_of_the_whole_covariance():
    """40 readings of 200 features have 39 directions of any variance, each half of the one before.

    Their first 10 are found.
    """
    rng = np.random.default_rng(3)
    axes, _ = np.linalg.qr(rng.normal(size=(200, 39)))
    readings = rng.normal(size=(40, 39)) * 0.5 ** np.arange(39) @ axes.T
    features = [Moments.of(readings[:12]), Moments.of(readings[12:])]
    covariance = sum(np.cov(part.T, bias=True) for part in (readings[:12], readings[12:])) / 2
    between = (features[1].mean - features[0].mean) / 2
    variances, directions = np.linalg.eigh(covariance + np.outer(between, between))
    _, projection = principal_components(features, 10)
    overlaps = np.abs(projection.T @ directions[:, ::-1][:, :10])
    assert variances[-1] > 1e4 * variances[-10]
    np.testing.assert_allclose(overlaps, np.eye(10), atol=1e-3)
    assert (projection[np.abs(projection).argmax(0), np.arange(10)] > 0).all()


@pytest.mark.parametrize("n_features", [5, 64, 250, 768, 2048, 4096])
@pytest.mark.parametrize("n_classes", [2, 22, 101])
def test_statistics_have_as_many_components_as_fit(n_features, n_classes):
    n = n_components_for(n_features, n_classes, 30_000)
    assert n <= min(n_features, MOST_COMPONENTS)
    assert n == n_features or n % 16 == 0

    def n_bytes(n):
        moments = Moments(1, np.zeros(n + 1), np.zeros(triangle_size(n + 1), np.float32))
        names = [str(k) for k in range(n_classes)]
        projection = np.zeros((n_features, n), np.float32)
        statistics = Statistics(
            "a", "b", tuple(names), projection[:, 0], projection, dict.fromkeys(names, moments),
            moments,
        )  # fmt: skip
        tensors = tensors_of_statistics(statistics)
        assert statistics.n_bytes == sum(tensor.nbytes for tensor in tensors.values())
        return statistics.n_bytes

    assert n_bytes(n) <= MAX_BYTES
    if n < min(n_features, MOST_COMPONENTS):
        assert n_bytes(n + 16) > MAX_BYTES


@pytest.mark.parametrize(
    ("n_readings", "expected"), [(0, 16), (100, 16), (130, 32), (1023, 240), (1024, 256)]
)
def test_few_readings_have_few_components(n_readings, expected):
    assert n_components_for(768, 10, n_readings) == expected
    assert n_components_for(11, 10, n_readings) == 11


def test_the_first_recordings_that_are_read_are_spread_over_all():
    for n in (1, 2, 10, 1000):
        assert sorted(spread_order(n).tolist()) == list(range(n))
    first = np.sort(spread_order(1000)[:50])
    assert np.diff(first).max() < 40


def test_where_windows_are_read():
    """Quarters and halves are read if events came; an event that is late counts where it comes."""
    config = TNTConfig(window_us=100)
    assert list(edges(np.array([], np.int64), config)) == []
    assert list(edges(np.array([7]), config)) == [(1, True)]
    late = np.array([0, 60, 10, 105, 99, 250])
    assert list(edges(late, config)) == [(1, False), (3, True), (5, True), (6, True)]
    assert list(edges(np.array([40, 90]), config, start_us=0)) == [(1, False), (2, True)]
    # 24 us are in the first quarter, 25 us in the second
    assert list(edges(np.array([0, 24, 25]), config)) == [(2, False), (3, True)]
    # a quarter of 10 us ends at 2.5 us, so 2 us are in it
    assert list(edges(np.array([0, 2, 3]), TNTConfig(window_us=10))) == [(2, False), (3, True)]


@pytest.mark.parametrize(
    "settings",
    [
        {"window_events": 8, "window_us": None},
        {"last_events": 8, "representation": "count"},
    ],
)
def test_where_windows_of_a_number_of_events_are_read(settings):
    config = TNTConfig(**settings)
    expected = [(2, False), (4, False), (8, True), (10, False), (11, True)]
    assert list(edges(np.arange(11), config)) == expected


def test_a_part_of_a_window_of_a_number_of_events_is_rounded_up():
    """A quarter of 10 events are 3."""
    config = TNTConfig(window_events=10, window_us=None)
    assert list(edges(np.arange(10), config)) == [(3, False), (5, False), (10, True)]


def features_of(*layers):
    """The layer of the features. A layer is its name, operation, input and output's shape."""
    network = [{"op": op, "name": name, "inputs": [source]} for name, op, source, _ in layers]
    shapes = {name: shape for name, _, _, shape in layers}
    return features_layer(network, {"volume": (2, 64, 64), **shapes})


def test_features_are_of_the_last_map_of_16_places_and_at_most_4096_numbers():
    logits = ("z", "dense", "h", (3,))
    flat = [("f", "flatten", "b", (120,)), ("h", "dense", "f", (9,)), logits]
    large = ("a", "conv", "volume", (4, 32, 32))
    assert features_of(large, ("b", "conv", "a", (8, 4, 4)), *flat) == "b"
    assert features_of(large, ("b", "conv", "a", (8, 3, 5)), *flat) == "a"
    # without such a map, of the last layer before the logits of as few numbers
    larger = ("a", "conv", "volume", (4, 32, 33))
    assert features_of(larger, ("b", "conv", "a", (8, 3, 5)), *flat) == "h"
    # a flattened map is none, and what keeps its order, but a flattened place is one
    kept = [("f", "flatten", "b", (120,)), ("r", "relu", "f", (120,)), ("z", "dense", "r", (3,))]
    assert features_of(larger, ("b", "conv", "a", (8, 3, 5)), *kept) == "b"
    place = [("m", "global_average_pool", "a", (4, 1, 1)), ("f", "flatten", "m", (4,))]
    assert features_of(larger, *place, ("z", "dense", "f", (3,))) == "f"
    assert features_of(larger, ("z", "flatten", "a", (4224,))) is None
