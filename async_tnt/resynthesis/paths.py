"""How the image of a window moves: its path, found from its events alone.

The path that is found is the one of the highest evidence. The search begins with a dictionary of
straight paths, `DIRECTIONS` x `LENGTHS` x speed profiles, some of which turn round and come back.
The evidence of all of them is one product with a table. From the best of them on,
Levenberg-Marquardt steps over the K points of the path, which a prior on its second differences
keeps smooth.

Noise and several objects have paths, too, that may not be relied on. So a path must pass three
tests:

- Its evidence exceeds that of all paths that lead the other way, by `MIN_MARGIN`.
- It explains a share of the signal that noise of as many events does not reach.
- In each half of the picture (left, right, above and below the middle of the events) it is more
  likely than its reverse. Two objects that move oppositely fail this test, as the reverse is more
  likely in a half with the other object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from async_tnt.resynthesis.moving_image import N_FRAMES, MovingImage
from async_tnt.simulation.random_motion import minimum_jerk

DIRECTIONS = 16
"""Directions of the dictionary's paths."""
LENGTHS = (1.0, 1.75, 3.0, 5.0, 8.0, 12.0)
"""Their lengths, in cells."""
PROFILES = ((0.0, 1.0), (0.0, 0.6), (0.2, 0.8), (0.4, 1.0))
"""From when to when they move, as shares of the window; one more profile is of constant speed."""
TURNS = (0.4, 0.55, 0.7, 0.85)
"""When a path that comes back turns round, as shares of the window."""
BACK_LENGTHS = LENGTHS[:4]
"""Lengths of paths that come back, in cells."""
BEND = 0.2
"""Standard deviation of a path's second differences, in cells."""

MOST_STEPS = 20
"""Steps of the search from the best path of the dictionary on, at most."""
MOST_TRIES = 6
"""Dampings that are tried for one step, at most."""
LONGEST_STEP = 1.0
"""Cells by which a step may move a point, at most."""
SMALLEST_GAIN = 0.05
"""Evidence that a step must gain for the search to go on."""

MIN_EVENTS = 50
"""Events that a window must have."""
MIN_MARGIN = 6.0
"""Evidence by which a path must exceed all that lead the other way."""
MIN_LENGTH = 0.1
"""Length of a path that is a motion, in pixels."""
MOST_EXPLAINED = 0.5
"""A path must explain a share of the signal: the square of the number of events a cell, but at most
this. Dense noise has paths of high margin, which explain little. Where there are few events, noise
has no such paths, and little is explained of real motions, too."""


@dataclass(frozen=True, eq=False)
class MotionPath:
    """How the image of a window moves.

    Parameters
    ----------
    positions : float64, (K, 2). Displacement (x, y) since the path's start, in sensor pixels, at
        the end of each of K equal parts of its time.
    margin : evidence by which the best path of the dictionary exceeds all that lead the other way.
    explained : share of the signal that the moving image explains.
    agreement : evidence by which the path exceeds its reverse, in the half of the picture where it
        does so least.
    n_events : number of events that it was found in.
    events_a_cell : their mean number in a cell of the picture.
    span : number of windows that the path goes through; the window itself is the middle one.
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
        """Why the path may not be relied on; empty where it may."""
        enough = min(self.events_a_cell**2, MOST_EXPLAINED)
        reasons = {
            "few events": self.n_events < MIN_EVENTS,
            "no motion": self.length < MIN_LENGTH,
            "ambiguous direction": self.margin < MIN_MARGIN,
            "noise": self.explained < enough,
            "several objects": self.agreement < 0,
        }
        for reason, holds in reasons.items():
            if holds:
                return reason
        return ""

    @property
    def length(self) -> float:
        """Distance between the two places of the window that are the furthest apart, in pixels."""
        places = self.at(np.arange(N_FRAMES + 1) / N_FRAMES)
        return float(np.linalg.norm(places[:, None] - places, axis=2).max())

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Displacement since the window's start at `shares` of the window, (n, 2)."""
        displacement: np.ndarray = self._since_the_start((self.span - 1) / 2 + shares) - self.before
        return displacement

    @property
    def before(self) -> np.ndarray:
        """Displacement from the path's start to the window's start, (2,)."""
        before: np.ndarray = self._since_the_start(np.array([(self.span - 1) / 2]))[0]
        return before

    def _since_the_start(self, windows: np.ndarray) -> np.ndarray:
        """Displacement after so many windows, (n, 2), in straight lines between the positions."""
        places = self.span * np.arange(N_FRAMES + 1) / N_FRAMES
        positions = np.concatenate([np.zeros((1, 2)), self.positions])
        return np.stack([np.interp(windows, places, positions[:, axis]) for axis in (0, 1)], axis=1)


class PathFinder:
    """Finds the paths of windows of one sensor and length."""

    def __init__(self, model: MovingImage) -> None:
        self.model = model
        # the start, which is 0, is one of the points
        bend = np.diff(np.eye(N_FRAMES + 1)[:, 1:], 2, axis=0) / BEND
        self._stiffness = bend.T @ bend

    def find(
        self, band: np.ndarray, halves: np.ndarray, n_events: Sequence[int], span: int = 1
    ) -> list[MotionPath]:
        """Find a path for each of N windows.

        Parameters
        ----------
        band : complex128, (N, F, K), `MovingImage.band_of` their spectra.
        halves : complex128, (N, 4, F, K), the same of the halves of their pictures.
        n_events : number of events of each.
        span : number of windows that are taken together.
        """
        model = self.model
        n_cells = model.rows * model.columns
        paths = []
        for of_window, parts, scores, n in zip(
            band, halves, self.scores(band), n_events, strict=True
        ):
            positions, _ = self.refine(of_window[None], self.dictionary[int(scores.argmax())])
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
        """Evidence of each path of the dictionary for each of N windows, (N, D)."""
        table, freedom = self._table
        by_frequency = np.ascontiguousarray(band.transpose(1, 2, 0), np.complex64)
        explained = np.zeros((len(freedom), len(band)))
        for by_path, spectra in zip(table, by_frequency, strict=True):
            # (D, N), small enough for the processor's cache
            product = by_path @ spectra
            explained += product.real**2 + product.imag**2
        evidence: np.ndarray = explained.T - freedom
        return evidence

    def refine(self, band: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, float]:
        """Find the path of the highest evidence near another one, for all windows together.

        Parameters
        ----------
        band : complex128, (N, F, K), of `MovingImage.band_of`.
        path : float64, (K, 2), in cells: where the search begins.

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
            else:  # no step gains anything
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
        """Straight paths, (D, K, 2), in cells."""
        angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        share = np.arange(1, N_FRAMES + 1) / N_FRAMES
        out = [share] + [minimum_jerk((share - start) / (end - start)) for start, end in PROFILES]
        back = [(1 - np.cos(np.pi * share / turn)) / 2 for turn in TURNS]
        paths = []
        for lengths, profiles in ((LENGTHS, out), (BACK_LENGTHS, back)):
            every = np.einsum("ad,l,pk->alpkd", direction, np.array(lengths), np.array(profiles))
            paths.append(every.reshape(-1, N_FRAMES, 2))
        return np.concatenate(paths)

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """A table by which `scores` are computed, and the freedom of each path.

        Returns
        -------
        table : complex64, (F, D, K). The squared product with a window's spectrum, summed over F,
            is what each path explains.
        freedom : float64, (D,): what the paths' freedom takes from their evidence.
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
        """Evidence by which the best path exceeds all that lead the other way."""
        # where a path leads: its mean, as a path that comes back ends where it began
        leads = self.dictionary.mean(1)
        # the bound keeps perpendicular paths out, whatever is rounded
        backwards = leads @ leads[int(scores.argmax())] < -1e-9
        return float(scores.max() - scores[backwards].max())

    def _bending(self, path: np.ndarray) -> float:
        """What a path's second differences take from its evidence."""
        return 0.5 * float((path * (self._stiffness @ path)).sum())
