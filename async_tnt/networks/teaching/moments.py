"""Moments: the number, mean and scatter of vectors, which can be merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any

import numpy as np


def triangle_size(n: int) -> int:
    """How many numbers a symmetric n x n matrix has in its lower triangle."""
    return n * (n + 1) // 2


@dataclass(frozen=True, eq=False)  # arrays have no single answer to ==
class Moments:
    """The number, mean and scatter of N vectors u of d numbers.

        mean = sum u / N           scatter = sum (u - mean) (u - mean)^T

    The scatter is about the mean, because a sum of u u^T loses small variances beside large means.

    Parameters
    ----------
    count : N, at least 1.
    mean : float64, shape (d,).
    scatter : float32, shape (d (d + 1) / 2,), the lower triangle row by row. Its numbers are
        rounded to 24 bits: a relative error of at most 2**-24.
    """

    count: int
    mean: np.ndarray
    scatter: np.ndarray

    @classmethod
    def of(cls, vectors: np.ndarray) -> Moments:
        """The moments of vectors, shape (N, d), of at least one.

        Examples
        --------
        >>> moments = Moments.of(np.array([[1.0, 2.0], [3.0, 6.0]]))
        >>> moments.count, moments.mean.tolist(), moments.scatter.tolist()
        (2, [2.0, 4.0], [2.0, 4.0, 8.0])
        """
        vectors = np.asarray(vectors, np.float64)
        mean = vectors.mean(0)
        centred = vectors - mean
        return cls._packed(len(vectors), mean, centred.T @ centred)

    @classmethod
    def _packed(cls, count: int, mean: np.ndarray, scatter: np.ndarray) -> Moments:
        """The moments with a scatter (d, d), of which the lower triangle is kept in float32."""
        return cls(count, mean, scatter[np.tril_indices(len(mean))].astype(np.float32))

    def merged(self, other: Moments) -> Moments:
        """The moments of both sets of vectors together.

        With N = N1 + N2 and the difference of the means e = mean2 - mean1:

            mean = mean1 + e N2 / N       scatter = scatter1 + scatter2 + e e^T N1 N2 / N

        References
        ----------
        Chan, Golub, LeVeque 1979, Updating formulae and a pairwise algorithm for computing sample
        variances.
        """
        count = self.count + other.count
        between = other.mean - self.mean
        share = other.count / count
        scatter = self._full_scatter + other._full_scatter
        scatter += np.outer(between, between) * (self.count * share)
        return Moments._packed(count, self.mean + between * share, scatter)

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle has: the moments, without matrices that were computed of them."""
        return {"count": self.count, "mean": self.mean, "scatter": self.scatter}

    @property
    def size(self) -> int:
        """The number d of numbers of a vector."""
        return len(self.mean)

    @cached_property
    def covariance(self) -> np.ndarray:
        """The mean of (u - mean) (u - mean)^T: float64, shape (d, d)."""
        covariance: np.ndarray = self._full_scatter / self.count
        return covariance

    @cached_property
    def second(self) -> np.ndarray:
        """The mean of v v^T for v = (u, 1): float64, shape (d + 1, d + 1)."""
        with_one = np.append(self.mean, 1.0)
        second = np.outer(with_one, with_one)
        second[:-1, :-1] += self.covariance
        return second

    @property
    def _full_scatter(self) -> np.ndarray:
        """The scatter as a symmetric matrix: float64, shape (d, d)."""
        matrix = np.zeros((self.size, self.size))
        rows, columns = np.tril_indices(self.size)
        matrix[rows, columns] = self.scatter
        matrix[columns, rows] = self.scatter
        return matrix


def merged(parts: Sequence[Moments]) -> Moments:
    """The moments of all parts together, of which there is at least one."""
    return reduce(Moments.merged, parts)
