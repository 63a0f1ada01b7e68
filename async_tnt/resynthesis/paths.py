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
- It explains a larger share of the signal than a path explains of noise with as many events.
- In each half of the picture (left, right, above and below the middle of the events) it is more
  likely than its reverse. Two objects that move in opposite directions fail this test: in a half
  with the other object, the reverse is more likely.
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
"""Speed profiles of the dictionary's paths: when the motion begins and ends, as shares of the
window. One more profile has a constant speed."""
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
"""Least gain of evidence by a step with which the search goes on."""

MIN_EVENTS = 50
"""Fewest events of a window whose path is relied on."""
MIN_MARGIN = 6.0
"""Least evidence by which a path must exceed all paths that lead the other way."""
MIN_LENGTH = 0.1
"""Least length of a path that counts as a motion, in pixels."""
MOST_EXPLAINED = 0.5
"""Largest share of the signal that a path must explain. The required share is the square of the
number of events per cell, but at most this.

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
        displacement: np.ndarray = self._since_the_start((self.span - 1) / 2 + shares) - self.before
        return displacement

    @property
    def before(self) -> np.ndarray:
        """Displacement from the path's start to the window's start, in pixels: (2,)."""
        before: np.ndarray = self._since_the_start(np.array([(self.span - 1) / 2]))[0]
        return before

    def _since_the_start(self, windows: np.ndarray) -> np.ndarray:
        """Displacement since the path's start at n times, linear between the positions: (n, 2).

        windows : the times since the path's start, in lengths of a window.
        """
        times = self.span * np.arange(N_FRAMES + 1) / N_FRAMES
        positions = np.concatenate([np.zeros((1, 2)), self.positions])
        return np.stack([np.interp(windows, times, positions[:, axis]) for axis in (0, 1)], axis=1)


class PathFinder:
    """Finds the paths of windows, for one sensor and one length of windows."""

    def __init__(self, model: MovingImage) -> None:
        self.model = model
        # The second differences of K + 1 points: the path's start, which is 0, is a point, too.
        bend = np.diff(np.eye(N_FRAMES + 1)[:, 1:], 2, axis=0) / BEND
        self._stiffness = bend.T @ bend

    def find(
        self, band: np.ndarray, halves: np.ndarray, n_events: Sequence[int], span: int = 1
    ) -> list[MotionPath]:
        """Find a path for each of N windows.

        Parameters
        ----------
        band : complex128, (N, F, K), `MovingImage.band_of` of the windows' spectra.
        halves : complex128, (N, 4, F, K), the same for the four halves of the windows' pictures.
        n_events : number of events of each window.
        span : number of consecutive windows that `band` was computed from.
        """
        model = self.model
        n_cells = model.rows * model.columns
        paths = []
        for of_window, parts, scores, n in zip(
            band, halves, self.scores(band), n_events, strict=True
        ):
            likeliest = self.dictionary[int(scores.argmax())]
            positions, _ = self.refine(of_window[None], likeliest)
            # in each half of the picture, the evidence of the path minus that of its reverse
            advantages = []
            for part in parts:
                forwards, _, _ = model.evidence(part[None], positions)
                backwards, _, _ = model.evidence(part[None], -positions)
                advantages.append(forwards - backwards)
            path = MotionPath(
                positions * model.cell,
                margin=self._margin(scores),
                explained=model.explained(of_window, positions),
                agreement=min(advantages),
                n_events=n,
                events_a_cell=n / n_cells,
                span=span,
            )
            paths.append(path)
        return paths

    def scores(self, band: np.ndarray) -> np.ndarray:
        """Evidence of each of the dictionary's D paths for each of N windows, (N, D)."""
        table, freedom = self._table
        by_frequency = np.ascontiguousarray(band.transpose(1, 2, 0), np.complex64)
        explained = np.zeros((len(freedom), len(band)))
        for by_path, spectra in zip(table, by_frequency, strict=True):
            # (D, N): frequency by frequency, the product fits into the processor's cache
            product = by_path @ spectra
            explained += product.real**2 + product.imag**2
        evidence: np.ndarray = explained.T - freedom
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
        stiffness = np.kron(self._stiffness, np.eye(2))
        damping = 1e-2
        path = path.copy()
        evidence, gradient, curvature = self.model.evidence(band, path)
        value = evidence - self._bending(path)
        for _ in range(MOST_STEPS):
            slope = (gradient - self._stiffness @ path).ravel()
            matrix = curvature + stiffness
            for _ in range(MOST_TRIES):
                damped = matrix + damping * np.diag(matrix.diagonal())
                step = np.linalg.solve(damped, slope).reshape(-1, 2)
                trial = path + step * min(1.0, LONGEST_STEP / max(np.abs(step).max(), 1e-12))
                found = self.model.evidence(band, trial)
                gain = found[0] - self._bending(trial) - value
                if gain > 0:
                    break
                damping = max(8 * damping, 1e-3)
            else:  # no damping gives a step that gains evidence
                break
            path = trial
            evidence, gradient, curvature = found
            value = value + gain
            damping = damping / 4
            if gain < SMALLEST_GAIN:
                break
        return path, evidence

    @cached_property
    def dictionary(self) -> np.ndarray:
        """The D straight paths with which a search begins: float64, (D, K, 2), in cells."""
        angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        share = np.arange(1, N_FRAMES + 1) / N_FRAMES
        # A profile tells which share of its length a path is away from its start: (K,).
        out = [share] + [minimum_jerk((share - start) / (end - start)) for start, end in PROFILES]
        back = [(1 - np.cos(np.pi * share / turn)) / 2 for turn in TURNS]
        paths = []
        for lengths, profiles in ((LENGTHS, out), (BACK_LENGTHS, back)):
            # (directions, lengths, profiles, K, 2)
            every = np.einsum("ad,l,pk->alpkd", direction, np.array(lengths), np.array(profiles))
            paths.append(every.reshape(-1, N_FRAMES, 2))
        return np.concatenate(paths)

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """The two terms of the evidence of the dictionary's paths, for `scores`.

        Returns
        -------
        table : complex64, (F, D, K). The squared absolute product with a window's spectrum, summed
            over F, is the first term of the evidence: the signal that a path explains.
        freedom : float64, (D,): the second term, which the freedom of the path takes away.
        """
        model = self.model
        prior = model.band_prior
        weights = np.tile(model.band_weights, len(model.band[1]))
        white = model.white_motion(self.dictionary, *model.band)
        white = white.reshape(len(self.dictionary), len(prior), N_FRAMES)
        h = (np.abs(white) ** 2).sum(-1)
        table = white.conj() * np.sqrt(0.5 * weights / (h + prior))[..., None]
        freedom = 0.5 * (weights * np.log1p(h / prior)).sum(-1)
        return np.ascontiguousarray(table.transpose(1, 0, 2), np.complex64), freedom

    def _margin(self, scores: np.ndarray) -> float:
        """The evidence by which the best path exceeds all paths that lead the other way.

        scores : (D,), the evidence of the dictionary's paths for one window.
        """
        # A path leads to the mean of its points: a path that comes back ends where it began.
        leads = self.dictionary.mean(1)
        # -1e-9 instead of 0: rounding must not make a perpendicular path a backward one
        backwards = leads @ leads[int(scores.argmax())] < -1e-9
        return float(scores.max() - scores[backwards].max())

    def _bending(self, path: np.ndarray) -> float:
        """The evidence that the prior takes from a path because of its second differences."""
        return 0.5 * float((path * (self._stiffness @ path)).sum())
