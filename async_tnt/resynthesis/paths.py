"""Find the path on which the image of a window moves, from the window's events alone.

The result is the path with the highest evidence, see `moving_image`. The search has two steps. The
first step tries a dictionary of straight paths: combinations of a direction, a length and a speed
profile. Some of them turn round and come back. The evidence of all these paths is computed at
once, as a product with a table. The second step begins at the best path of the dictionary, and
moves its K points by Levenberg-Marquardt steps. A prior on the second differences keeps the path
smooth.

The search finds a path in any window, even one with noise or with several objects. Such a path
cannot be relied on. So a path must pass three tests:

- Its evidence exceeds that of all paths that lead the other way by `MIN_MARGIN`.
- It explains a larger share of the signal than any path explains of noise with the same number of
  events.
- In each half of the picture (left, right, above and below the middle of the events) it is more
  likely than its reverse. If two objects move in opposite directions, this test fails, because the
  reverse is more likely in the half with the other object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from async_tnt.resynthesis.moving_image import N_FRAMES, MovingImage
from async_tnt.simulation.random_motion import minimum_jerk

DIRECTIONS = 16
"""Number of directions of the dictionary's paths."""
LENGTHS = (1.0, 1.75, 3.0, 5.0, 8.0, 12.0)
"""Lengths of the dictionary's paths, in cells."""
PROFILES = ((0.0, 1.0), (0.0, 0.6), (0.2, 0.8), (0.4, 1.0))
"""Speed profiles of the dictionary's paths: the moments at which the motion begins and ends, as
shares of the window. One more profile has a constant speed."""
TURNS = (0.4, 0.55, 0.7, 0.85)
"""Moments at which paths that come back turn round, as shares of the window."""
BACK_LENGTHS = LENGTHS[:4]
"""Lengths of the dictionary's paths that come back, in cells."""
BEND = 0.2
"""Standard deviation of a path's second differences in the prior, in cells."""

MOST_STEPS = 20
"""Most steps of the search from the best path of the dictionary on."""
MOST_TRIES = 6
"""Most dampings that are tried for one step."""
LONGEST_STEP = 1.0
"""Largest distance by which a step may move a point, in cells."""
SMALLEST_GAIN = 0.05
"""Least gain of evidence of a step. After a step with a smaller gain the search ends."""

MIN_EVENTS = 50
"""Fewest events from which a path can be relied on."""
MIN_MARGIN = 6.0
"""Least evidence by which a path must exceed all paths that lead the other way."""
MIN_LENGTH = 0.1
"""Least length of a path that counts as a motion, in pixels."""
MOST_EXPLAINED = 0.5
"""Upper limit of the share of the signal that a path must explain. This share is the square of the
number of events per cell, or `MOST_EXPLAINED` if the square is larger.

Dense noise has paths with a large margin, but they explain little. With few events, noise has no
such paths, and even real motions explain little of the signal. So the requirement is lower there.
"""


@dataclass(frozen=True, eq=False)
class MotionPath:
    """How the image of a window moves.

    Parameters
    ----------
    positions : float64, (K, 2). Displacement (x, y) since the path's start, in sensor pixels, at
        the end of each of K equal parts of the path's time.
    margin : evidence by which the best path of the dictionary exceeds all its paths that lead the
        other way.
    explained : share of the signal that the moving image explains.
    agreement : evidence by which the path exceeds its reverse, in the half of the picture where
        this evidence is smallest.
    n_events : number of events from which the path was found.
    events_a_cell : mean number of these events in a cell.
    span : number of consecutive windows that the path goes through. The window itself is the middle
        one.
    """

    positions: np.ndarray
    margin: float = np.inf
    explained: float = 1.0
    agreement: float = np.inf
    n_events: int = MIN_EVENTS
    events_a_cell: float = 0.0
    span: int = 1

    @property
    def refused(self) -> str:
        """Why the path cannot be relied on; empty if it can."""
        least_explained = min(self.events_a_cell**2, MOST_EXPLAINED)
        reasons = {
            "few events": self.n_events < MIN_EVENTS,
            "no motion": self.length < MIN_LENGTH,
            "ambiguous direction": self.margin < MIN_MARGIN,
            "noise": self.explained < least_explained,
            "several objects": self.agreement < 0,
        }
        for reason, holds in reasons.items():
            if holds:
                return reason
        return ""

    @property
    def length(self) -> float:
        """Largest distance between two places of the path within the window, in pixels."""
        places = self.at(np.arange(N_FRAMES + 1) / N_FRAMES)
        return float(np.linalg.norm(places[:, None] - places, axis=2).max())

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Displacement since the window's start, in pixels, at `shares` of the window: (n, 2)."""
        # (span - 1) / 2 windows of the path are before this one
        since_start = self._since_path_start((self.span - 1) / 2 + shares)
        displacement: np.ndarray = since_start - self.window_start
        return displacement

    @property
    def window_start(self) -> np.ndarray:
        """Displacement from the path's start to the window's start, in pixels: (2,)."""
        displacement: np.ndarray = self._since_path_start(np.array([(self.span - 1) / 2]))[0]
        return displacement

    def _since_path_start(self, times: np.ndarray) -> np.ndarray:
        """Displacement since the path's start at n times, linear between the positions: (n, 2).

        times : the times since the path's start, in lengths of a window.
        """
        known_times = self.span * np.arange(N_FRAMES + 1) / N_FRAMES
        positions = np.concatenate([np.zeros((1, 2)), self.positions])
        columns = [np.interp(times, known_times, positions[:, axis]) for axis in (0, 1)]
        return np.stack(columns, axis=1)


class PathFinder:
    """Finds the paths of windows, for one sensor and one length of windows."""

    def __init__(self, model: MovingImage) -> None:
        self.model = model
        # The second differences of K + 1 points. The first point is the path's start, which is 0,
        # so its column is left out.
        bend = np.diff(np.eye(N_FRAMES + 1)[:, 1:], 2, axis=0) / BEND
        self._stiffness = bend.T @ bend

    def find(
        self, band: np.ndarray, halves: np.ndarray, n_events: Sequence[int], span: int = 1
    ) -> list[MotionPath]:
        """Find a path for each of N windows.

        Parameters
        ----------
        band : complex128, (N, F, K), `MovingImage.band_of` of the windows' spectra.
        halves : complex128, (N, 4, F, K), the bands of the four halves of each window's pictures.
        n_events : number of events of each window.
        span : number of consecutive windows that `band` was computed from.
        """
        model = self.model
        n_cells = model.rows * model.columns
        paths = []
        for window_band, half_bands, scores, n in zip(
            band, halves, self.scores(band), n_events, strict=True
        ):
            likeliest = self.dictionary[int(scores.argmax())]
            positions, _ = self.refine(window_band[None], likeliest)
            # in each half of the picture, the evidence of the path minus that of its reverse
            advantages = []
            for half_band in half_bands:
                forwards, _, _ = model.evidence(half_band[None], positions)
                backwards, _, _ = model.evidence(half_band[None], -positions)
                advantages.append(forwards - backwards)
            path = MotionPath(
                positions * model.cell,
                margin=self._margin(scores),
                explained=model.explained(window_band, positions),
                agreement=min(advantages),
                n_events=n,
                events_a_cell=n / n_cells,
                span=span,
            )
            paths.append(path)
        return paths

    def scores(self, band: np.ndarray) -> np.ndarray:
        """Evidence of each of the dictionary's D paths for each of N windows, (N, D)."""
        table, penalties = self._table
        spectra = np.ascontiguousarray(band.transpose(1, 2, 0), np.complex64)  # (F, K, N)
        explained = np.zeros((len(penalties), len(band)))
        # frequency by frequency, so that each product fits into the processor's cache
        for rows, spectrum in zip(table, spectra, strict=True):
            product = rows @ spectrum  # (D, N)
            explained += product.real**2 + product.imag**2
        evidence: np.ndarray = explained.T - penalties
        return evidence

    def refine(self, band: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, float]:
        """Find the path with the highest evidence near a first path, for all windows together.

        Parameters
        ----------
        band : complex128, (N, F, K), from `MovingImage.band_of`.
        path : float64, (K, 2), in cells: the first path.

        Returns
        -------
        The path, (K, 2) in cells, and its evidence.
        """
        stiffness = np.kron(self._stiffness, np.eye(2))  # the same in x and in y
        damping = 1e-2
        path = path.copy()
        evidence, gradient, curvature = self.model.evidence(band, path)
        objective = evidence - self._bending(path)
        for _ in range(MOST_STEPS):
            slope = (gradient - self._stiffness @ path).ravel()
            matrix = curvature + stiffness
            for _ in range(MOST_TRIES):
                damped = matrix + damping * np.diag(matrix.diagonal())
                step = np.linalg.solve(damped, slope).reshape(-1, 2)
                trial = path + step * min(1.0, LONGEST_STEP / max(np.abs(step).max(), 1e-12))
                trial_terms = self.model.evidence(band, trial)
                gain = trial_terms[0] - self._bending(trial) - objective
                if gain > 0:
                    break
                damping = max(8 * damping, 1e-3)
            else:  # no damping led to a gain
                break
            path = trial
            evidence, gradient, curvature = trial_terms
            objective = objective + gain
            damping = damping / 4
            if gain < SMALLEST_GAIN:
                break
        return path, evidence

    @cached_property
    def dictionary(self) -> np.ndarray:
        """The D straight paths with which a search begins: float64, (D, K, 2), in cells."""
        angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        time = np.arange(1, N_FRAMES + 1) / N_FRAMES
        # A profile is the distance from the path's start at each time, as a share of the path's
        # length: (K,).
        one_way = [time] + [minimum_jerk((time - start) / (end - start)) for start, end in PROFILES]
        with_return = [(1 - np.cos(np.pi * time / turn)) / 2 for turn in TURNS]
        paths = []
        for lengths, profiles in ((LENGTHS, one_way), (BACK_LENGTHS, with_return)):
            # (directions, lengths, profiles, K, 2)
            product = np.einsum("ad,l,pk->alpkd", direction, np.array(lengths), np.array(profiles))
            paths.append(product.reshape(-1, N_FRAMES, 2))
        return np.concatenate(paths)

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """What `scores` needs for the two terms of the evidence of the dictionary's D paths.

        F is the number of frequencies of the band.

        Returns
        -------
        table : complex64, (F, D, K). For each frequency f, the product `table[f] @ spectrum[f]`
            sums over the K frames. The sum of |product|^2 over all f is the first term of the
            evidence: the signal that a path explains.
        penalties : float64, (D,): the second term of the evidence, which is subtracted. It is
            larger for a path that could also explain many other signals.
        """
        model = self.model
        prior = model.band_prior
        weights = np.tile(model.band_weights, len(model.band_frequencies[1]))
        white = model.white_motion(self.dictionary, *model.band_frequencies)
        white = white.reshape(len(self.dictionary), len(prior), N_FRAMES)
        h = (np.abs(white) ** 2).sum(-1)
        table = white.conj() * np.sqrt(0.5 * weights / (h + prior))[..., None]
        penalties = 0.5 * (weights * np.log1p(h / prior)).sum(-1)
        return np.ascontiguousarray(table.transpose(1, 0, 2), np.complex64), penalties

    def _margin(self, scores: np.ndarray) -> float:
        """The evidence by which the best path exceeds all paths that lead the other way.

        scores : (D,), the evidence of the dictionary's paths for one window.
        """
        # The direction of a path is that of the mean of its points, because a path that comes back
        # may end near its start.
        directions = self.dictionary.mean(1)
        # -1e-9 instead of 0, because rounding must not make a perpendicular path a backward one
        is_backward = directions @ directions[int(scores.argmax())] < -1e-9
        return float(scores.max() - scores[is_backward].max())

    def _bending(self, path: np.ndarray) -> float:
        """The evidence that the prior subtracts because of a path's second differences."""
        return 0.5 * float((path * (self._stiffness @ path)).sum())
