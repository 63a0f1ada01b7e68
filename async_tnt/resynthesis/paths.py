"""How the image of a window moves: its path, found from its events alone, and paths that were not
recorded.

The path that is found is the one of the highest evidence. First a dictionary of straight paths,
`DIRECTIONS` x `LENGTHS` x speed profiles, some of which turn round and come back: the evidence of
all of them is one product with a table. From the best of them on, Levenberg-Marquardt steps over
the K points of the path, which is kept smooth by a prior on its second differences.

Whether the path may be relied on is asked against noise and against several objects. Its evidence
must exceed that of all paths that lead the other way, by `MIN_MARGIN`. It must explain a share of
the signal that noise of as many events does not reach. And in each half of the picture, left,
right, above and below the middle of the events, it must be more likely than its reverse: of two
objects that move oppositely, one is as well explained by the other's path with the opposite
contrast, but for what tells both ways apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from async_tnt.resynthesis.moving_image import N_FRAMES, MovingImage
from async_tnt.simulation.random_motion import minimum_jerk

DIRECTIONS = 16
LENGTHS = (1.0, 1.75, 3.0, 5.0, 8.0, 12.0)  # in cells
# from when to when it moves, as shares of the window
PROFILES = ((0.0, 1.0), (0.0, 0.6), (0.2, 0.8), (0.4, 1.0))
TURNS = (0.4, 0.55, 0.7, 0.85)
"""When a path that comes back turns round."""
BACK_LENGTHS = LENGTHS[:4]
BEND = 0.2
"""Standard deviation of a path's second differences, in cells."""
MOST_STEPS, LONGEST_STEP, SMALLEST_GAIN = 20, 1.0, 0.05

MIN_EVENTS, MIN_MARGIN, MIN_LENGTH = 50, 6.0, 0.1
MOST_EXPLAINED = 0.5
"""Of the signal must be explained: the square of the events of a cell, at most this. Dense noise
has paths of high margin, which explain little; few events have no such paths, and little of them is
explained."""


@dataclass(frozen=True, eq=False)
class MotionPath:
    """How the image of a window moves.

    Parameters
    ----------
    positions : float64, (K, 2). Displacement (x, y) since the path's start, in sensor pixels, at
        the end of each of K equal parts of its time.
    margin : by how much evidence the best path of the dictionary exceeds all that lead the other
        way.
    explained : share of the signal that the moving image explains.
    agreement : by how much evidence the path exceeds its reverse, in the half of the picture where
        it does so least.
    n_events : that it was found in.
    events_a_cell : the same of each of the picture's cells, in the mean.
    span : of how many windows it is the path; the window itself is the middle one.
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
        return next((reason for reason, holds in reasons.items() if holds), "")

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
        """Displacement at the window's start since that of the path, (2,)."""
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
        """A path for each of N windows, of `MovingImage.band_of` their spectra, (N, F, K), and
        those of their halves, (N, 4, F, K)."""
        model, paths = self.model, []
        for one, parts, scores, n in zip(band, halves, self.scores(band), n_events, strict=True):
            positions, _ = self.refine(one[None], self.dictionary[int(scores.argmax())])
            agreement = min(
                model.evidence(part[None], positions)[0] - model.evidence(part[None], -positions)[0]
                for part in parts
            )
            explained = model.explained(one, positions)
            a_cell = n / (model.rows * model.columns)
            paths.append(
                MotionPath(
                    positions * model.cell,
                    self._margin(scores),
                    explained,
                    agreement,
                    n,
                    a_cell,
                    span,
                )
            )
        return paths

    def scores(self, band: np.ndarray) -> np.ndarray:
        """Evidence of each path of the dictionary for each of N windows, (N, D)."""
        table, freedom = self._table
        explained = np.zeros((len(freedom), len(band)))
        for one, spectra in zip(
            table, np.ascontiguousarray(band.transpose(1, 2, 0), np.complex64), strict=True
        ):
            product = one @ spectra  # of one frequency: (D, N), small enough for the cache
            explained += product.real**2 + product.imag**2
        evidence: np.ndarray = explained.T - freedom
        return evidence

    def refine(self, band: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, float]:
        """The path of the highest evidence near `path`, (K, 2) in cells, for all windows together;
        and its evidence."""
        stiffness = np.kron(self._stiffness, np.eye(2))
        damping, path = 1e-2, path.copy()
        evidence, gradient, curvature = self.model.evidence(band, path)
        value = evidence - self._bending(path)
        for _ in range(MOST_STEPS):
            slope = (gradient - self._stiffness @ path).ravel()
            matrix = curvature + stiffness
            for _ in range(6):
                step = np.linalg.solve(
                    matrix + damping * np.diag(matrix.diagonal()), slope
                ).reshape(-1, 2)
                trial = path + step * min(1.0, LONGEST_STEP / max(np.abs(step).max(), 1e-12))
                found = self.model.evidence(band, trial)
                gain = found[0] - self._bending(trial) - value
                if gain > 0:
                    break
                damping = max(8 * damping, 1e-3)
            else:
                break
            path, (evidence, gradient, curvature) = trial, found
            value, damping = value + gain, damping / 4
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
        return np.concatenate(
            [
                np.einsum(
                    "ad,l,pk->alpkd", direction, np.array(lengths), np.array(profiles)
                ).reshape(-1, N_FRAMES, 2)
                for lengths, profiles in ((LENGTHS, out), (BACK_LENGTHS, back))
            ]
        )

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """(F, D, K), whose squared product with a window's spectrum is what its paths explain; and
        their freedom."""
        model = self.model
        prior, weights = model.band_prior, np.tile(model.band_weights, len(model.band[1]))
        white = model.white_motion(self.dictionary, *model.band).reshape(
            len(self.dictionary), len(prior), N_FRAMES
        )
        h = (np.abs(white) ** 2).sum(-1)
        table = white.conj() * np.sqrt(0.5 * weights / (h + prior))[..., None]
        freedom = 0.5 * (weights * np.log1p(h / prior)).sum(-1)
        return np.ascontiguousarray(table.transpose(1, 0, 2), np.complex64), freedom

    def _margin(self, scores: np.ndarray) -> float:
        leads = self.dictionary.mean(1)  # a path that comes back ends where it began
        # perpendicular ones are not, whatever is rounded
        backwards = leads @ leads[int(scores.argmax())] < -1e-9
        return float(scores.max() - scores[backwards].max())

    def _bending(self, path: np.ndarray) -> float:
        return 0.5 * float((path * (self._stiffness @ path)).sum())
