"""N-MOVING-MNIST's command: what it writes and prints."""

import json

import pytest

ALONG = "ON - OFF centroid, along the motion"


@pytest.fixture(autouse=True)
def no_data(monkeypatch):
    monkeypatch.delenv("TNT_DATA", raising=False)


@pytest.fixture
def simulate(experiment, mnist, tmp_path):
    """Run the command on the small MNIST, into the folder `set`."""

    def run(*words):
        return experiment(
            "moving_mnist", "--mnist", mnist, "--out", tmp_path / "set", "--workers", 1, *words
        )

    return run


def test_the_set_is_compared_with_the_recordings_that_show_the_same_images(simulate, tmp_path):
    """Simulations in N-MNIST's layout stand for N-MNIST.

    They are numbered from 1 under Test, as in the official set.
    """
    nmnist = tmp_path / "nmnist"
    out = tmp_path / "moving"
    assert simulate("--digits", 8, "--motions", "nmnist", "--bin", nmnist)[0] == 0
    (nmnist / "nmnist").rename(nmnist / "Test")
    code, printed, _ = simulate(
        "--digits", 8, "--out", out, "--motions", "bell", "--nmnist", nmnist, "--json"
    )
    answer = json.loads(printed)
    assert (answer["recordings"], answer["shards"], answer["motions"]) == (240, 30, "bell")
    assert answer["bytes"] == sum(path.stat().st_size for path in out.glob("*.safetensors"))
    columns = answer["statistics"]
    assert code == 0 and list(columns) == ["N-MNIST", "simulated", "this set"]
    for name in ("events per window", "active pixels", "ON share", ALONG):
        # another seed
        assert columns["simulated"][name] == pytest.approx(columns["N-MNIST"][name], rel=0.1)
    assert columns["this set"][ALONG] < -2

    one = sorted((nmnist / "Test").glob("*/*.bin"))[0]
    # numbered on from the training images, and shows another digit
    one.rename(one.with_name("60024.bin"))
    code, _, err = simulate("--digits", 8, "--out", out, "--motions", "bell", "--nmnist", nmnist)
    assert (
        code == 2
        and "60024.bin: MNIST's test image 24, which it should show, is another digit" in err
    )
