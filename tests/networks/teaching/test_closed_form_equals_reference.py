"""The rows from moments are those of the reference, which has all readings at once."""

import numpy as np
import pytest
import torch
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from tnt_reference import taught_row

from async_tnt.networks.teaching.closed_form import MARGINS, row_of
from async_tnt.networks.teaching.moments import Moments, merged


@given(st.integers(0, 1 << 32), st.integers(1, 12), st.integers(1, 6), st.sampled_from(MARGINS))
def test_a_row_equals_the_reference(seed, p, n_others, margin):
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-2, 2, p + 1)

    def readings():
        n = int(rng.integers(1, 40))
        return rng.normal(rng.normal(size=p + 1), rng.uniform(0.1, 2.0), (n, p + 1)) * scales

    taught = readings()
    others = [readings() for _ in range(n_others)]
    row = row_of(Moments.of(taught), [Moments.of(one) for one in others]).at(margin)
    expected = taught_row(
        torch.from_numpy(taught), [torch.from_numpy(one) for one in others], margin=margin
    ).numpy()
    # compared by their logits, as a row has more freedom than readings show; moments have 24 bits
    everything = np.concatenate([taught, *others])
    phi = np.hstack([everything[:, :-1], np.ones((len(everything), 1))])
    largest = np.abs(everything[:, -1]).max() + margin
    np.testing.assert_allclose(phi @ row, phi @ expected, atol=1e-4 * largest)


NASTY = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 8), st.just(3)),
    elements=st.sampled_from([0.0, -0.0, 1.0, 1e-30, -1e-6, 1e6, 3.5]) | st.floats(-1e3, 1e3),
)


@given(st.lists(NASTY, min_size=1, max_size=5))
def test_merged_moments_are_those_of_all_vectors_in_any_order(parts):
    whole = Moments.of(np.concatenate(parts))
    for order in (parts, parts[::-1]):
        both = merged([Moments.of(part) for part in order])
        assert both.count == whole.count
        scale = np.abs(np.concatenate(parts)).max(0)
        assert (np.abs(both.mean - whole.mean) <= 1e-12 * scale + 1e-300).all()
        # 24 bits for each of the parts' scatters, none of which is larger than the whole one
        bound = 2.0**-20 * whole.count * np.outer(scale, scale) + 1e-40
        difference = np.abs(both.covariance - whole.covariance) * whole.count
        assert (difference <= bound).all()


@example(np.full((1, 3), 1.22734504e-159), [np.zeros((1, 3))])
@given(NASTY, st.lists(NASTY, min_size=1, max_size=4))
def test_a_row_of_nasty_readings_is_finite(taught, others):
    row = row_of(Moments.of(taught), [Moments.of(one) for one in others])
    assert np.isfinite(row.level).all()
    assert np.isfinite(row.rise).all()


@given(NASTY)
def test_a_covariance_has_no_negative_variance(vectors):
    assume(len(vectors) > 1)
    covariance = Moments.of(vectors).covariance
    assert (np.diag(covariance) >= 0).all()
    assert (covariance == covariance.T).all()


@pytest.mark.parametrize("n", [1, 2, 50])
def test_a_ridge_shrinks_a_row_towards_none(n):
    rng = np.random.default_rng(n)
    taught = torch.from_numpy(rng.normal(1.0, 1.0, (n, 5)))
    others = [torch.from_numpy(rng.normal(0.0, 1.0, (n, 5))) for _ in range(3)]
    norms = [
        taught_row(taught, others, margin=8.0, ridge=ridge)[:-1].norm()
        for ridge in (0.03, 1.0, 9.0)
    ]
    assert norms[0] > norms[1] > norms[2]
