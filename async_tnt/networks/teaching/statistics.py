"""Statistics: what a model keeps of the recordings of its classes, so that more can be taught."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from async_tnt.networks.teaching.moments import Moments, triangle_size

MAX_BYTES = 3_000_000
"""The most bytes that statistics take in a file."""

MOST_COMPONENTS = 256
"""The most principal components of the features that are kept."""

STEP = 16
"""The number of components is a multiple of this one, unless there are fewer features."""

READINGS_A_COMPONENT = 4
"""How many readings there are for each component, at least. With fewer, a row would fit single
readings rather than classes."""

STATISTICS_PREFIX = "statistics:"
"""What the names of the tensors in a model's file begin with. No layer's weights have a colon."""


@dataclass(frozen=True, eq=False)  # arrays have no single answer to ==
class Statistics:
    """Moments of the features of each class, and which classes were taught.

    Features f are the numbers of one layer. A reading of the network is the vector

        u = (x, s)      x = P^T (f - f0)      s = log sum_k exp z_k

    with the principal components P of the features, and the logits z of the network as it was
    trained.

    Parameters
    ----------
    layer : the layer whose numbers are the features.
    logits : the layer that computes the logits z.
    trained : the classes that the network was trained on, in the order of z.
    center, projection : f0, float32, (D,), and P, float32, (D, p).
    moments : class -> moments of u in its windows; of trained and of taught classes.
    nothing : moments of u in windows that show no class; None: not known.
    margins : taught class -> M, the distance of its logit from s that is aimed at.
    """

    layer: str
    logits: str
    trained: tuple[str, ...]
    center: np.ndarray
    projection: np.ndarray
    moments: Mapping[str, Moments]
    nothing: Moments | None = None
    margins: Mapping[str, float] = field(default_factory=dict)

    @property
    def classes(self) -> tuple[str, ...]:
        """The model's classes: those of the trained ones that were not forgotten, then others."""
        kept = [name for name in self.trained if name in self.moments and name not in self.margins]
        return (*kept, *self.margins)

    @property
    def n_components(self) -> int:
        """The number p of components."""
        return int(self.projection.shape[1])

    @property
    def n_bytes(self) -> int:
        """How many bytes the statistics take in a file."""
        return sum(int(tensor.nbytes) for tensor in tensors_of_statistics(self).values())

    def readings(self, features: np.ndarray, logits: np.ndarray) -> np.ndarray:
        """The vectors u: float64, shape (N, p + 1).

        features, logits : shapes (N, D) and (N, number of trained classes).
        """
        components = (features.astype(np.float64) - self.center) @ self.projection
        return np.hstack([components, log_sum_exp(logits)[:, None]])

    def with_class(self, name: str, moments: Moments, margin: float) -> Statistics:
        """The statistics with one more taught class."""
        return replace(
            self,
            moments={**self.moments, name: moments},
            margins={**self.margins, name: margin},
        )

    def without_class(self, name: str) -> Statistics:
        """The statistics without a class. The other classes keep every bit."""
        return replace(
            self,
            moments={other: m for other, m in self.moments.items() if other != name},
            margins={other: m for other, m in self.margins.items() if other != name},
        )


def log_sum_exp(logits: np.ndarray) -> np.ndarray:
    """log sum_k exp z_k of each row: float64, shape (N,)."""
    z = logits.astype(np.float64)
    largest = z.max(1)
    return np.asarray(largest + np.log(np.exp(z - largest[:, None]).sum(1)))


def n_components_for(n_features: int, n_classes: int, n_readings: int) -> int:
    """The largest number of components for which statistics fit into `MAX_BYTES`.

    It is at most `MOST_COMPONENTS` and one for each `READINGS_A_COMPONENT` readings, and at least
    one `STEP` or all features.

    Examples
    --------
    >>> n_components_for(768, 10, 30_000), n_components_for(2048, 10, 30_000)
    (256, 224)
    >>> n_components_for(768, 101, 30_000), n_components_for(768, 10, 500)
    (96, 112)
    """
    least = min(STEP, n_features)
    most = max(least, min(n_features, MOST_COMPONENTS, n_readings // READINGS_A_COMPONENT))
    if most < n_features:
        most -= most % STEP
    n_entries = n_classes + 1  # with windows that show no class
    n = most
    while n > least:
        of_entries = n_entries * (4 * triangle_size(n + 1) + 8 * (n + 2))
        if of_entries + 4 * n_features * (n + 1) <= MAX_BYTES:
            break
        n = max(least, (n - 1) // STEP * STEP)
    return n


def principal_components(features: Sequence[Moments], n: int) -> tuple[np.ndarray, np.ndarray]:
    """The mean of features, and the n directions in which they vary most.

    Each class counts alike, whatever number of windows it has.

    Parameters
    ----------
    features : moments of the features of each class.
    n : number of directions.

    Returns
    -------
    center, projection : float32, (D,) and (D, n), the direction of most variance first.
    """
    means = np.stack([moments.mean for moments in features])
    center = means.mean(0)
    between = means - center
    covariance = between.T @ between / len(features)
    for moments in features:
        covariance += moments.covariance / len(features)
    n_readings = sum(moments.count for moments in features)
    directions = _directions(covariance, max(n, n_readings))
    chosen = directions[:, ::-1][:, :n]
    # a direction and its opposite are the same one: the largest number of each is positive
    largest = np.abs(chosen).argmax(0)
    chosen = chosen * np.where(chosen[largest, np.arange(n)] < 0, -1.0, 1.0)
    return center.astype(np.float32), np.ascontiguousarray(chosen, np.float32)


def _directions(covariance: np.ndarray, rank: int) -> np.ndarray:
    """The orthonormal directions of a covariance (D, D), the direction of least variance first.

    A covariance of a few readings has its variance in `rank` directions, which are then all that
    are returned. Random vectors times the covariance span them. All eigenvectors of 4096 features
    would take eight seconds.

    References
    ----------
    Halko, Martinsson, Tropp 2011, Finding structure with randomness, algorithms 4.1 and 5.3.
    """
    n_features = len(covariance)
    if rank > n_features // 4:
        return np.linalg.eigh(covariance)[1]
    vectors = np.random.default_rng(0).normal(size=(n_features, rank))
    basis, _ = np.linalg.qr(covariance @ vectors)  # (D, rank)
    _, within = np.linalg.eigh(basis.T @ covariance @ basis)
    directions: np.ndarray = basis @ within
    return directions


# -- in a file -------------------------------------------------------------------------------------


def _entries(statistics: Statistics) -> list[Moments]:
    """The moments of all classes, then of windows that show nothing, if these are known."""
    nothing = [] if statistics.nothing is None else [statistics.nothing]
    return [*statistics.moments.values(), *nothing]


def tensors_of_statistics(statistics: Statistics) -> dict[str, np.ndarray]:
    """The tensors of statistics in a model's file, by their names."""
    entries = _entries(statistics)
    tensors = {
        "center": statistics.center,
        "projection": statistics.projection,
        "counts": np.array([moments.count for moments in entries], np.int64),
        "means": np.stack([moments.mean for moments in entries]),
        "scatters": np.stack([moments.scatter for moments in entries]),
    }
    return {f"{STATISTICS_PREFIX}{name}": np.ascontiguousarray(t) for name, t in tensors.items()}


def description_of_statistics(statistics: Statistics) -> dict[str, Any]:
    """What a file says of statistics beside their tensors, for JSON."""
    return {
        "layer": statistics.layer,
        "logits": statistics.logits,
        "trained": list(statistics.trained),
        "classes": list(statistics.moments),
        "margins": dict(statistics.margins),
    }


def read_statistics(tensors: Mapping[str, np.ndarray], description: Any) -> Statistics:
    """The statistics in a model's file, from its tensors and the description of the statistics.

    Raises
    ------
    ValueError : they are not what `tensors_of_statistics` and `description_of_statistics` gave.
    """
    try:
        layer, logits, trained, names, margins = (
            description[key] for key in ("layer", "logits", "trained", "classes", "margins")
        )
        center, projection, counts, means, scatters = (
            tensors[f"{STATISTICS_PREFIX}{key}"]
            for key in ("center", "projection", "counts", "means", "scatters")
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"its statistics have no {error}") from None
    is_text = all(isinstance(text, str) for text in (layer, logits))
    lists = isinstance(trained, list) and isinstance(names, list) and isinstance(margins, dict)
    if not is_text or not lists or not all(isinstance(name, str) for name in [*trained, *names]):
        raise ValueError("its statistics must name layers and classes")
    if len(set(names)) < len(names) or not set(margins) <= set(names):
        raise ValueError("its statistics must be of different classes, the taught ones among them")
    types = {center.dtype, projection.dtype, scatters.dtype}
    if types != {np.dtype(np.float32)} or means.dtype != np.float64 or counts.dtype != np.int64:
        raise ValueError("its statistics have numbers of another type")
    n_entries = len(names) + (len(counts) > len(names))
    size = projection.shape[1] + 1 if projection.ndim == 2 else 0
    expected = {
        "counts": (counts, (n_entries,)),
        "means": (means, (n_entries, size)),
        "scatters": (scatters, (n_entries, triangle_size(size))),
        "center": (center, projection.shape[:1]),
    }
    for name, (tensor, shape) in expected.items():
        if tensor.shape != shape:
            raise ValueError(f"its statistics' {name} must be of shape {shape}, got {tensor.shape}")
    entries = [Moments(*entry) for entry in zip(counts.tolist(), means, scatters, strict=True)]
    statistics = Statistics(
        layer,
        logits,
        tuple(trained),
        center,
        projection,
        dict(zip(names, entries, strict=False)),
        entries[len(names)] if n_entries > len(names) else None,
        margins,
    )
    return statistics


def check_statistics(
    statistics: Statistics, shapes: Mapping[str, tuple[int, ...]], classes: Sequence[str]
) -> None:
    """Refuse statistics that are not of a network, or damaged.

    Parameters
    ----------
    shapes : layer -> the shape of its output.
    classes : the model's classes.

    Raises
    ------
    ValueError : the message names what does not fit.
    """
    n_features = int(np.prod(shapes.get(statistics.layer, (0,))))
    n_logits = int(np.prod(shapes.get(statistics.logits, (0,))))
    if len(statistics.center) != n_features or len(statistics.trained) != n_logits:
        raise ValueError(
            f"statistics must be of layers with {len(statistics.center)} features and "
            f"{len(statistics.trained)} logits; {statistics.layer!r} has {n_features}, "
            f"{statistics.logits!r} has {n_logits}"
        )
    if tuple(classes) != statistics.classes:
        raise ValueError(
            f"statistics must be of the classes {', '.join(classes)}, got "
            f"{', '.join(statistics.classes)}"
        )
    tensors = tensors_of_statistics(statistics)
    if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
        raise ValueError("statistics must be finite numbers")
    if any(moments.count < 1 for moments in _entries(statistics)):
        raise ValueError("statistics must be of at least one window of each class")
    margins = statistics.margins.values()
    if not all(isinstance(m, float) and 0 < m < np.inf for m in margins):
        raise ValueError("statistics must have positive margins")
