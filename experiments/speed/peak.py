"""How many multiplications a second one core can do at most, measured."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numba import njit

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.simd import fma, vectorized, whole
from async_tnt.kernels.target import LANES
from experiments.speed.timing import spread

N_SUMS = 12
"""Number of registers with sums. One sum can be added to every fourth cycle, and a core has at most
two units that multiply, so eight would do. With the two factors, twelve fit into 16 registers."""

N_TURNS = 1_000_000
"""Number of times that each sum is added to in a measurement."""

ROUNDS = 20
"""Number of measurements, after one to warm up."""


@inlined
def multiply_and_add_plain(numbers, n):  # type: ignore[no-untyped-def]
    """Add the product of two factors to each of N_SUMS * LANES sums, `n` times.

    numbers : float32, of `new_numbers`: the sums, and LANES times the first and the second factor.
    """
    for _ in range(n):
        for k in range(N_SUMS * LANES):
            first = numbers[N_SUMS * LANES + k % LANES]
            second = numbers[(N_SUMS + 1) * LANES + k % LANES]
            numbers[k] = fma(first, second, numbers[k])  # type: ignore[call-arg]


@vectorized(multiply_and_add_plain)
def multiply_and_add(simd: Any, numbers: Any, n: Any) -> None:
    registers = [
        simd.load(numbers, simd.mul(whole(k), LANES))  # the sums, then the two factors
        for k in range(N_SUMS + 2)
    ]
    factors = registers[N_SUMS:]
    sums = simd.loop(
        n, registers[:N_SUMS], lambda _, carried: [simd.fma(*factors, one) for one in carried]
    )
    for k, total in enumerate(sums):
        simd.store(total, numbers, simd.mul(whole(k), LANES))


@njit
def _multiply(numbers, n):  # type: ignore[no-untyped-def]
    multiply_and_add(numbers, n)


def new_numbers() -> np.ndarray:
    """Sums that are 0, and two factors of small numbers: float32, ((N_SUMS + 2) LANES,)."""
    numbers = np.zeros((N_SUMS + 2) * LANES, np.float32)
    numbers[N_SUMS * LANES :] = 0.5
    return numbers


def most_multiplications() -> dict[str, float]:
    """Billions of multiplications, each with an addition, that this core does in a second.

    All numbers stay in registers, so nothing is read from memory. The result has the `spread` of
    `ROUNDS` measurements; its `max` is the core's peak.
    """
    numbers = new_numbers()
    _multiply(numbers, N_TURNS)
    billions = []
    for _ in range(ROUNDS):
        started = time.perf_counter()
        _multiply(numbers, N_TURNS)
        taken_s = time.perf_counter() - started
        billions.append(1e-9 * N_TURNS * N_SUMS * LANES / taken_s)
    return spread(np.array(billions))
