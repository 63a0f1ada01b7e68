"""The bundled samples are what the package simulates."""

from async_tnt.sources.files.recording import sample_recordings
from experiments import samples


def test_bundled_samples_are_those_of_seed_0(real_mnist, tmp_path):
    assert samples.main(["--mnist", str(real_mnist), "--out", str(tmp_path)]) == 0
    for digit, bundled in sample_recordings().items():
        assert bundled.read_bytes() == (tmp_path / f"{digit}.bin").read_bytes(), (
            f"sample {digit} is not what this version simulates"
        )
