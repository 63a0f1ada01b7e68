"""What official training recordings tell of the constants of the simulated pixels."""

import numpy as np
import pytest

from async_tnt.simulation.simulator import PixelModel
from experiments import fit_pixels
from experiments.digit_data.mnist import load_mnist
from experiments.digit_data.nmnist_files import write_nmnist
from experiments.motions.scene import Scene
from experiments.motions.simulated_digits import simulate_digit
from experiments.records.files import RESULTS, read_numbers
from experiments.records.run import ROOT


@pytest.fixture(scope="module")
def simulated_nmnist(mnist, tmp_path_factory):
    """20 training recordings, simulated with the present constants but other random numbers."""
    folder = tmp_path_factory.mktemp("simulated")
    images, labels = load_mnist(mnist, "train")
    for i in range(20):
        path = folder / "Train" / str(labels[i]) / f"{i + 1:05}.bin"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_nmnist(path, simulate_digit(images[i], np.random.default_rng((7, i))))
    return folder


def test_each_candidate_differs_in_one_constant():
    present = (Scene(), PixelModel())
    found = fit_pixels.candidates()
    assert found.pop("present") == present
    assert len(found) == len(set(found.values())) == 16
    for scene, pixels in found.values():
        differing = [
            name
            for name in (*fit_pixels.SCENE, *fit_pixels.PIXELS)
            if getattr(scene if name in fit_pixels.SCENE else pixels, name)
            != getattr(present[name not in fit_pixels.SCENE], name)
        ]
        assert len(differing) == 1


def test_the_constants_of_a_simulation_are_told(simulated_nmnist, mnist, experiment, tmp_path):
    """The recordings are simulated with the present constants, so these deviate least of most."""
    report = tmp_path / "fit.json"
    words = ("--nmnist", simulated_nmnist, "--mnist", mnist, "--recordings", 20, "--json", report)
    code, out, _ = experiment("fit_pixels", *words)
    assert code == 0
    assert out.startswith("20 official training recordings, numbers 1 to 20; no test recording")
    numbers = read_numbers(report)
    assert numbers["official_training_recordings"] == [1, 20, 20]
    deviations = numbers["deviations"]
    assert deviations["present"] < 0.06
    for name in ("threshold_on 0.236", "threshold_off 0.154", "blur_px 0.636", "noise_hz 0.25"):
        assert deviations["present"] < deviations[name], name
    # what a change of a constant is seen by
    simulated = numbers["simulated"]
    events = {name: column["events per window"] for name, column in simulated.items()}
    assert events["threshold_on 0.236"] < events["present"] < events["threshold_on 0.164"]
    noise = {name: column["noise of quiet pixels [Hz]"] for name, column in simulated.items()}
    assert noise["noise_hz 0.25"] < noise["present"] < noise["noise_hz 0.36"]


def test_the_table_of_the_theory_has_the_recorded_deviations():
    deviations = read_numbers(RESULTS / "fit_pixels.json")["deviations"]
    shown = [f"{value:.3f}".removeprefix("0") for value in deviations.values()]
    # the present constants come first, and then two changes of each constant
    pairs = [(shown[0], shown[0]), *zip(shown[1::2], shown[2::2], strict=True)]
    page = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
    table = page.split("| constant | divided by 1.2 | times 1.2 |\n|---|---|---|\n")[1]
    rows = [line.split(" | ") for line in table.split("\n\n")[0].splitlines()]
    assert [(smaller, larger.removesuffix(" |")) for _, smaller, larger in rows] == pairs


def test_test_recordings_are_not_read(simulated_nmnist, mnist, experiment, tmp_path):
    """Numbers above 1,000 and the folder Test are left out."""
    for name in ("Test/0/00001.bin", "Train/0/60001.bin", "Train/0/01001.bin"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"damaged")
    assert len(fit_pixels.training_recordings(simulated_nmnist, 20)) == 20
    code, _, err = experiment("fit_pixels", "--nmnist", tmp_path, "--mnist", mnist, "--quick")
    assert code == 2
    assert "expected at least 20 official training recordings" in err and "got 0" in err


def test_a_recording_of_another_digit_is_refused(simulated_nmnist, mnist, experiment, tmp_path):
    source = sorted(simulated_nmnist.glob("Train/*/*.bin"))[0]
    other = tmp_path / "Train" / str((int(source.parent.name) + 1) % 10) / source.name
    other.parent.mkdir(parents=True)
    other.write_bytes(source.read_bytes())
    words = ("--nmnist", tmp_path, "--mnist", mnist, "--recordings", 1)
    code, _, err = experiment("fit_pixels", *words)
    assert code == 2 and "which it should show, is another digit" in err
