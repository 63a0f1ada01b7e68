"""One image that moves over a sensor: the evidence for its path, and the cost of an image.

L is the image of log luminance at the window's start, in units of the pixels' thresholds. The
window has K equal parts. r_k is the displacement of the image at the end of the k-th part. The
events until then, added up at each pixel, are c_k. With noise e_k, which is independent from pixel
to pixel:

    c_k           = (S(r_k) - 1) L + e_k
    cov(e_k, e_m) = V_km 1
    V_km          = 1/3 (delta_km + 1) + 0.01 min(k, m)

S(r) moves an image on a torus of odd sides without blurring it. Everything here is dense linear
algebra over the pixels of small tori, without Fourier transforms.
"""

from __future__ import annotations

import math

import torch


def contrast_frames(
    t: torch.Tensor,
    x: torch.Tensor,
    y: torch.Tensor,
    p: torch.Tensor,
    *,
    window_us: int,
    n_frames: int,
    shape: tuple[int, int],
    step_on: float = 1.0,
    step_off: float = 1.0,
) -> torch.Tensor:
    """c: the sum of each pixel's events up to the end of each part of the window.

    Parameters
    ----------
    t, x, y, p : (N,) columns of one window, 0 <= t < window_us.
    window_us : the window's length.
    n_frames : K.
    shape : (rows, columns).
    step_on, step_off : what an ON and an OFF event are worth.

    Returns
    -------
    float64 tensor (K, rows, columns).
    """
    frames = torch.zeros(n_frames, *shape, dtype=torch.float64)
    for k in range(n_frames):
        for i in range(len(t)):
            if int(t[i]) * n_frames < (k + 1) * window_us:
                frames[k, int(y[i]), int(x[i])] += step_on if p[i] else -step_off
    return frames


def shift_matrix(n: int, displacement: torch.Tensor) -> torch.Tensor:
    """S, (n, n): the matrix that moves n samples of a periodic signal by a real displacement.

    n must be odd.

    S_ij = D(i - j - displacement)
    D(a) = 1/n sum_{|m| <= (n-1)/2} cos(2 pi m a / n)        the periodic sinc
    """
    if n % 2 == 0:
        raise ValueError(f"`n` must be odd, got {n}")
    places = torch.arange(n, dtype=torch.float64)
    distance = places[:, None] - places[None, :] - displacement
    waves = torch.arange(-(n // 2), n // 2 + 1, dtype=torch.float64)
    return torch.cos(2 * math.pi / n * waves * distance[..., None]).sum(-1) / n


def motion_matrix(path: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
    """A, (K R C, R C): the matrix from an image, taken row by row, to all c_k without noise.

    `path` is (K, 2), with columns x and y.
    """
    rows, columns = shape
    identity = torch.eye(rows * columns, dtype=torch.float64)
    blocks = [
        torch.kron(shift_matrix(rows, r[1]), shift_matrix(columns, r[0])) - identity for r in path
    ]
    return torch.cat(blocks)


def noise_covariance(n_frames: int) -> torch.Tensor:
    """V, (K, K): the covariance of a pixel's e_k."""
    k = torch.arange(1, n_frames + 1, dtype=torch.float64)
    return (torch.eye(n_frames, dtype=torch.float64) + 1) / 3 + 0.01 * torch.minimum(k[:, None], k)


def path_evidence(
    frames: torch.Tensor, path: torch.Tensor, *, roughness: float = 16.0, level: float = 1.0
) -> torch.Tensor:
    """log p(c | path) - log p(c | no image), for an image with Gaussian differences of neighbours.

        L ~ N(0, Q^-1),  Q = roughness D^T D + level 1        c ~ N(0, V x 1 + A Q^-1 A^T)

    Parameters
    ----------
    frames : (K, rows, columns), on the whole torus.
    path : (K, 2), in pixels.

    Returns
    -------
    Scalar tensor, differentiable with respect to `path`.
    """
    n_frames, rows, columns = frames.shape
    identity = torch.eye(rows * columns, dtype=torch.float64)
    noise = torch.kron(noise_covariance(n_frames), identity)
    differences = difference_matrix((rows, columns))
    precision = roughness * differences.T @ differences + level * identity
    motion = motion_matrix(path, (rows, columns))
    covariance = noise + motion @ torch.linalg.solve(precision, motion.T)
    c = frames.reshape(-1)
    return _log_density(c, covariance) - _log_density(c, noise)


def image_cost(
    image: torch.Tensor,
    frames: torch.Tensor,
    path: torch.Tensor,
    *,
    sparseness: float,
    edge: float,
    level: float,
) -> torch.Tensor:
    """The cost of an image, which the best image minimises.

        1/2 |V^-1/2 (c - A L)|^2 + sum g(|D L|) + level/2 |L|^2

        g(z) = sparseness edge (u sqrt(u^2 + 1) + asinh u - u^2),  u = z / (2 edge)

    Parameters
    ----------
    image : (rows, columns).
    frames : (K, rows, columns).
    path : (K, 2), in pixels.
    """
    n_frames, rows, columns = frames.shape
    predicted = motion_matrix(path, (rows, columns)) @ image.reshape(-1)
    residual = frames.reshape(n_frames, -1) - predicted.reshape(n_frames, -1)
    misfit = 0.5 * (residual * torch.linalg.solve(noise_covariance(n_frames), residual)).sum()

    across, down = (difference_matrix((rows, columns)) @ image.reshape(-1)).reshape(2, -1)
    u = torch.hypot(across, down) / (2 * edge)
    edges = sparseness * edge * (u * torch.sqrt(u**2 + 1) + torch.asinh(u) - u**2)

    total: torch.Tensor = misfit + edges.sum() + 0.5 * level * (image**2).sum()
    return total


def difference_matrix(shape: tuple[int, int]) -> torch.Tensor:
    """D, (2 R C, R C): the differences of neighbouring pixels on a torus.

    First each pixel's right neighbour minus the pixel, then its lower neighbour minus the pixel.
    """
    rows = torch.eye(shape[0], dtype=torch.float64)
    columns = torch.eye(shape[1], dtype=torch.float64)
    across = torch.roll(columns, 1, dims=1) - columns
    down = torch.roll(rows, 1, dims=1) - rows
    return torch.cat([torch.kron(rows, across), torch.kron(down, columns)])


def _log_density(c: torch.Tensor, covariance: torch.Tensor) -> torch.Tensor:
    """The log density at c of a Gaussian with mean 0, without its constant log(2 pi) term."""
    factor = torch.linalg.cholesky(covariance)
    white = torch.linalg.solve_triangular(factor, c[:, None], upper=False)[:, 0]
    log_density: torch.Tensor = -0.5 * (white**2).sum() - torch.log(factor.diagonal()).sum()
    return log_density
