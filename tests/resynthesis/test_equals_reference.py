"""Path evidence, its gradient and the images equal those of the reference.

The reference computes them by dense linear algebra over pixels.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch")

from tnt_reference import moving_image as reference  # noqa: E402

from async_tnt.kernels.training.moving_image import contrast_frames, move_periodic  # noqa: E402
from async_tnt.resynthesis import moving_image  # noqa: E402
from async_tnt.resynthesis.moving_image import finer  # noqa: E402

K = moving_image.N_FRAMES


class SmallTorus(moving_image.MovingImage):
    """The model on a torus of 7 x 5 places, all of whose frequencies tell about the path."""

    def __init__(self):
        super().__init__((34, 34), 1_000)
        self.shape = (5, 7)
        self.band_frequencies = self.frequencies


MODEL = SmallTorus()


def made(seed, n=2):
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(0, 0.4, (K, 2)), 0)
    return np.cumsum(rng.normal(0, 0.7, (n, K, *MODEL.shape)), 1), path


@pytest.mark.parametrize("seed", range(2))
def test_evidence_and_its_gradient(seed):
    frames, path = made(seed)
    found, gradient, _ = MODEL.evidence(MODEL.spectra(frames).reshape(len(frames), -1, K), path)
    position = torch.tensor(path, requires_grad=True)
    expected = sum(reference.path_evidence(torch.tensor(c), position) for c in frames)
    expected.backward()
    assert found == pytest.approx(expected.item(), rel=1e-9)
    np.testing.assert_allclose(gradient, position.grad.numpy(), rtol=1e-7, atol=1e-7)


def test_the_curvature_is_that_of_the_likelihood_about_the_images():
    """It is compared with differences of sum |W c - W a X|^2 / 2, X the posterior means."""
    frames, path = made(3)
    band = MODEL.spectra(frames).reshape(len(frames), -1, K)
    _, _, curvature = MODEL.evidence(band, path)
    weights = np.tile(MODEL.band_weights, len(MODEL.band_frequencies[1]))

    def white(moved):
        return MODEL.white_motion(moved, *MODEL.band_frequencies).reshape(-1, K)

    a = white(path)
    mean = (a.conj() * band).sum(2) / ((abs(a) ** 2).sum(1) + MODEL.band_prior)  # (N, F)
    # how what is explained changes with each number of the path
    steps = 1e-6 * np.eye(2 * K).reshape(2 * K, K, 2)
    slopes = np.array([white(path + step) - white(path - step) for step in steps]) / 2e-6
    changes = (np.sqrt(weights) * mean)[None, :, :, None] * slopes[:, None]
    changes = changes.reshape(2 * K, -1)
    expected = (changes @ changes.conj().T).real
    np.testing.assert_allclose(curvature, expected, rtol=1e-6, atol=1e-6 * abs(expected).max())


def test_image_costs_least():
    """The image's cost is within a thousandth of the least cost that another method finds.

    The other method uses a slightly rounded cost.
    """
    frames, path = made(0, n=1)
    found = moving_image.find_images(MODEL, MODEL.spectra(frames), path[None])[0]

    def cost(image):
        return reference.image_cost(
            image,
            torch.tensor(frames[0]),
            torch.tensor(path),
            sparseness=moving_image.SPARSENESS,
            edge=moving_image.EDGE,
            level=moving_image.MEAN_PRECISION,
        )

    best = torch.zeros(MODEL.shape, dtype=torch.float64, requires_grad=True)
    steps = torch.optim.LBFGS(
        [best], max_iter=300, line_search_fn="strong_wolfe", tolerance_change=1e-12
    )

    def closure():
        steps.zero_grad()
        # off the kink at D L = 0
        value = cost(best + 1e-9 * torch.arange(best.numel()).reshape(best.shape))
        value.backward()
        return value

    steps.step(closure)
    assert cost(torch.tensor(found)).item() <= 1.001 * cost(best.detach()).item()


@given(
    st.lists(
        st.tuples(st.integers(0, 999), st.integers(0, 6), st.integers(0, 4), st.integers(0, 1)),
        max_size=40,
    )
)
@settings(max_examples=30, deadline=None)
def test_contrast_frames(rows):
    t, x, y, p = np.ascontiguousarray(np.array(sorted(rows), np.int64).reshape(-1, 4).T)
    frames = np.empty((K, 5, 7))
    contrast_frames(
        t, x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8), 1_000, 1.25, 0.8, 1, frames
    )
    columns = (torch.from_numpy(np.ascontiguousarray(column)) for column in (t, x, y, p))
    expected = reference.contrast_frames(
        *columns, window_us=1_000, n_frames=K, shape=(5, 7), step_on=1.25, step_off=0.8
    )
    np.testing.assert_allclose(frames, expected.numpy(), atol=1e-12)


def test_cells_average_their_pixels():
    frames = np.empty((K, 2, 3))
    t = np.array([0, 500, 999])
    one = np.ones(3, np.uint8)
    x, y = np.array([[0, 1, 5], [0, 1, 3]], np.uint16)
    contrast_frames(t, x, y, one, 1_000, 2.0, 1.0, 2, frames)
    assert frames[0].tolist() == [[0.5, 0, 0], [0, 0, 0]]
    assert frames[-1].tolist() == [[1.0, 0, 0], [0, 0, 0.5]]


@pytest.mark.parametrize("cell", [1, 2, 5])
def test_noise_is_white_after_whitening(cell):
    """The noise of a cell's mean, which varies less than one pixel's."""
    covariance = reference.noise_covariance(K).numpy() / cell**2
    white = moving_image.MovingImage((340, 260), 1_000, cell).whitening
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(K), atol=1e-12)


def test_pictures_move_as_the_reference_moves_an_image():
    """Between the places of the fine image the light is interpolated: the finer, the nearer."""
    image = np.random.default_rng(1).normal(size=(5, 7))
    path = torch.tensor([[1.3, -0.6]], dtype=torch.float64)
    moved = reference.motion_matrix(path, (5, 7)).numpy() @ image.ravel()
    expected = image + moved.reshape(5, 7)
    places = np.array([[[1, 0, -1.3], [0, 1, 0.6]]])
    frames = np.empty((1, 5, 7))
    errors = []
    for factor in (3, 30):
        move_periodic(frames, finer(image, factor), places, 0, 0.0, factor)
        errors.append(np.abs(frames[0] - expected).max())
    assert errors[0] < 0.25 and errors[1] < 0.003


@pytest.mark.parametrize("shift", [0.5, -3.5, 12.5])
def test_half_a_place_beyond_its_last_row_and_column_a_picture_begins_again(shift):
    """Its light is 10 row + column, of 3 rows and 4 columns. Shifts that differ by multiples of
    both look alike."""
    image = np.add.outer([0.0, 10.0, 20.0], [0.0, 1.0, 2.0, 3.0])
    down = shift if shift > 0 else shift + 12 - 8
    frames = np.empty((1, 4, 5))
    move_periodic(frames, image, np.array([[[1, 0, shift], [0, 1, down]]]), 0, 0.0, 1.0)
    # between two neighbours, or the last place and the first
    columns = [0.5, 1.5, 2.5, 1.5, 0.5]
    rows = [5.0, 15.0, 10.0, 5.0]
    assert frames[0].tolist() == np.add.outer(rows, columns).tolist()
