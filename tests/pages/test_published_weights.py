"""Models of published weights answer as the published networks do.

Most weights here are made: random, in the published files' forms. The published files themselves
are read where the folder of data has them.
"""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="networks are read with torch (extra `reference`)")

import torch
from made import events_of, random_events

import async_tnt
from async_tnt.sources import sample_recordings

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NIR = runpy.run_path(str(EXAMPLES / "nir_cnn.py"))
ROSHAMBO = runpy.run_path(str(EXAMPLES / "roshambo_cnn.py"))


def logits_of(model, events):
    """The model's answer to the events of one window."""
    processor = async_tnt.Processor(model)
    processor.push(events)
    return processor.fire().logits


def refusal(capsys, monkeypatch, name, *words):
    """The line with which an example ends."""
    monkeypatch.setattr("sys.argv", [name, *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert capsys.readouterr().out == "" and "\n" not in ended.value.code
    return ended.value.code


# -- NIR -------------------------------------------------------------------------------------------


def write_made_weights(path, make):
    """Write random weights of one of the two networks; returns the network.

    They are as large as keeps numbers from dying out from layer to layer.
    """
    torch.manual_seed(5)
    network = make()
    for weight in network.parameters():
        torch.nn.init.kaiming_normal_(weight)
    state = network.state_dict()
    if path.suffix == ".ckpt":
        state = {"epoch": 4, "state_dict": {f"model.{name}": w for name, w in state.items()}}
    torch.save(state, path)
    return network


@pytest.mark.parametrize(
    "name, make",
    [("weights.pth", "paper_network"), ("best.ckpt", "checkpoint_network")],
)
def test_a_model_of_on_first_answers_as_the_network_of_off_first(tmp_path, name, make):
    network = write_made_weights(tmp_path / name, NIR[make])
    model, _ = NIR["convert"](tmp_path / name)
    events = random_events(2000)
    events["p"] = events["x"] > 8  # more ON than OFF, and at other places
    counts = np.zeros((1, 2, 34, 34), np.float32)  # channel 0 is OFF, as in the published images
    np.add.at(counts, (0, events["p"].astype(int), events["y"], events["x"]), 1)
    with torch.no_grad():
        expected = network(torch.from_numpy(counts))[0].numpy()
        swapped = network(torch.from_numpy(counts[:, ::-1].copy()))[0].numpy()
    scale = np.abs(expected).max()
    assert np.abs(swapped - expected).max() > 0.1 * scale > 0
    # float32 sums in another order
    np.testing.assert_allclose(logits_of(model, events), expected, atol=1e-5 * scale)


def test_pooling_of_the_papers_network_is_a_sum():
    (pooled,) = NIR["sum_pooling"]()(torch.ones(1, 1, 2, 2)).flatten().tolist()
    assert pooled == 4


def test_windows_and_recordings_are_counted_and_published_numbers_stand_beside(
    tmp_path, monkeypatch, capsys
):
    write_made_weights(tmp_path / "weights.pth", NIR["paper_network"])
    for digit, path in sample_recordings().items():
        (tmp_path / "Test" / str(digit)).mkdir(parents=True)
        (tmp_path / "Test" / str(digit) / "1.bin").write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["nir_cnn.py", "weights.pth", "nir.safetensors", "Test"])
    runpy.run_path(str(EXAMPLES / "nir_cnn.py"), run_name="__main__")
    saved, published, windows, recordings = capsys.readouterr().out.splitlines()
    assert saved.startswith("nir.safetensors: Model(10 classes, 34x34 -> 2x34x34")
    assert ".985 (sinabs)" in published
    model = async_tnt.load_model("nir.safetensors")
    assert model.record == {"weights": "weights.pth"}
    windows_right = 0
    recordings_right = 0
    for digit, path in sample_recordings().items():
        decisions = list(async_tnt.stream(async_tnt.sources.open_recording(path), model))
        assert len(decisions) == 3
        windows_right += sum(decision.index == digit for decision in decisions)
        recordings_right += sum(decision.logits for decision in decisions).argmax() == digit
    assert windows == f"{windows_right / 30:.4f} of 30 windows are right"
    assert recordings == f"{recordings_right / 10:.4f} of 10 recordings are right"


def test_other_files_than_the_nir_papers_are_refused_in_a_line(tmp_path, capsys, monkeypatch):
    def refused(path):
        return refusal(capsys, monkeypatch, "nir_cnn.py", path, tmp_path / "out.safetensors")

    expected = r"expected pretrained_ann_weights.pth or the .ckpt of paper/02_cnn/ann_pretraining"
    assert refused(tmp_path / "no.pth").startswith(f"{tmp_path / 'no.pth'}: no such file; expected")
    (tmp_path / "text.pth").write_text("weights")
    assert f"text.pth: no file of torch weights; {expected}" in refused(tmp_path / "text.pth")

    np.savez(tmp_path / "zip.pth", a=1)
    (tmp_path / "zip.pth.npz").rename(tmp_path / "zip.pth")
    assert "zip.pth: torch cannot load it (" in refused(tmp_path / "zip.pth")
    for content in ([1, 2], {"0.weight": 3}, {0: torch.zeros(2)}):
        torch.save(content, tmp_path / "others.pth")
        assert "others.pth: holds other things than weights; " in refused(tmp_path / "others.pth")
    torch.save({"0.weight": torch.zeros(3, 2)}, tmp_path / "other.pth")
    assert "another network, 1 tensors, the first 0.weight (3, 2); " in refused(
        tmp_path / "other.pth"
    )

    # a model that the example has written: its channels would be swapped back
    write_made_weights(tmp_path / "weights.pth", NIR["paper_network"])
    NIR["convert"](tmp_path / "weights.pth")[0].save(tmp_path / "model.safetensors")
    assert "no file of torch weights; " in refused(tmp_path / "model.safetensors")
    assert not (tmp_path / "out.safetensors").exists()


def test_code_in_a_file_of_weights_does_not_run(tmp_path, capsys, monkeypatch):
    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    torch.save({"0.weight": Evil()}, tmp_path / "evil.pth")
    words = ("nir_cnn.py", tmp_path / "evil.pth", tmp_path / "out.safetensors")
    assert "torch cannot load it (UnpicklingError); " in refusal(capsys, monkeypatch, *words)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "name, least",
    [
        ("pretrained_ann_weights.pth", 0.95),
        ("cnn-step=7030-epoch=04-valid_loss=0.06-valid_acc=0.98.ckpt", 0.97),
    ],
)
def test_the_published_nir_weights_recognise_digits(data, name, least):
    weights = data / "nir" / name
    if not weights.is_file():
        pytest.skip(f"no {name} in {weights.parent}")
    model, _ = NIR["convert"](weights)
    paths = [path for n in range(10) for path in sorted(data.glob(f"nmnist/Test/{n}/*.bin"))[:10]]
    counts = NIR["count_right"](model, paths)
    assert counts["windows"] == 300 and counts["recordings"] == 100
    assert counts["windows_right"] / 300 > least - 0.02 and counts["recordings_right"] / 100 > least


# -- RoShamBo --------------------------------------------------------------------------------------


def write_made_numbers(folder, seed=3):
    """Write random weights in the published form; returns them as floats, in Keras' order."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    n = len(ROSHAMBO["KERNELS"])
    digits = {"kernel": rng.integers(13, 15, n), "bias": rng.integers(8, 15, n)}
    layers = []
    for k, shape in enumerate(ROSHAMBO["KERNELS"]):
        layer = {}
        # numbers that neither die out nor explode from layer to layer
        sizes = {"kernel": np.sqrt(2 / np.prod(shape[:-1])), "bias": 0.1}
        for part, part_shape in (("kernel", shape), ("bias", shape[-1:])):
            scale = 2.0 ** digits[part][k]
            whole = np.round(rng.normal(0, sizes[part], part_shape) * scale).astype(np.int32)
            np.save(folder / f"layer{k + 1}_{part}.npy", whole)
            layer[part] = whole / scale
        layers.append(layer)
    for part, numbers in digits.items():
        np.save(folder / f"shift_per_layer_{part}.npy", numbers.astype(np.int16))
    return layers


def keras_logits(layers, image):
    """The published layers in NumPy, on maps (height, width, channels): float64."""
    x = image[..., None]
    for layer in layers[:-1]:
        kernel = layer["kernel"]
        patches = np.lib.stride_tricks.sliding_window_view(x, kernel.shape[:2], axis=(0, 1))
        x = np.maximum(np.einsum("yxcij,ijco->yxo", patches, kernel) + layer["bias"], 0)
        height, width = x.shape[0] // 2, x.shape[1] // 2
        x = x[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1).mean(axis=(1, 3))
    return x.ravel() @ layers[-1]["kernel"] + layers[-1]["bias"]


def hand_events(n=5_000, sensor=(240, 180)):
    """Events that are dense enough for pixels of more than 16."""
    rng = np.random.default_rng(8)
    x, y = (np.clip(rng.normal(side / 2, side / 12, n), 0, side - 1) for side in sensor)
    return events_of(np.arange(n) * 10, x.astype(int), y.astype(int), rng.integers(0, 2, n))


def test_a_roshambo_model_answers_as_the_published_layers(tmp_path):
    layers = write_made_numbers(tmp_path / "numbers")
    model = ROSHAMBO["convert"](tmp_path / "numbers")
    assert model.classes == ("paper", "scissors", "rock", "background")
    events = hand_events()
    # the published program's image: scaled by floor, clipped, and truncated to a byte
    image, _, _ = np.histogram2d(
        np.floor(events["y"] * (64 / 180)),
        np.floor(events["x"] * (64 / 240)),
        bins=64,
        range=((0, 64), (0, 64)),
    )
    assert image.max() > 20 and set(range(17)) <= set(image.ravel())
    image = (255 / 16 * np.minimum(image, 16)).astype(np.uint8) / 256
    expected = keras_logits(layers, image)
    scaled = ROSHAMBO["on_64x64"](events, (240, 180))
    (decision,) = async_tnt.Processor(model).push(scaled)
    # float32 sums in another order
    np.testing.assert_allclose(decision.logits, expected, atol=1e-5 * np.abs(expected).max())
    assert decision.events == 5_000 and np.ptp(expected) > 0.1


def test_roshambo_decides_on_the_recordings_of_a_davis(tmp_path, capsys, monkeypatch):
    write_made_numbers(tmp_path / "numbers")
    events = np.concatenate([hand_events(), hand_events()[:3_000]])
    events["t"] = np.arange(8_000) * 10
    np.savez(tmp_path / "throws.npz", events=events, sensor=(240, 180))
    before = events.copy()
    out = tmp_path / "roshambo.safetensors"
    words = ["roshambo_cnn.py", tmp_path / "numbers", out, tmp_path / "throws.npz"]
    monkeypatch.setattr("sys.argv", list(map(str, words)))
    runpy.run_path(str(EXAMPLES / "roshambo_cnn.py"), run_name="__main__")
    saved, *decisions = capsys.readouterr().out.splitlines()
    assert saved.startswith(f"{out}: Model(4 classes, 64x64 -> 1x64x64")
    model = async_tnt.load_model(out)
    scaled = ROSHAMBO["on_64x64"](events, (240, 180))
    (decision,) = async_tnt.Processor(model).push(scaled)
    assert decisions == [f"     50.0 ms  {decision.label} ({decision.probability:.0%})"]
    np.testing.assert_array_equal(events, before)

    np.savez(tmp_path / "bare.npz", events=events)
    words = ("roshambo_cnn.py", tmp_path / "numbers", out, tmp_path / "bare.npz")
    monkeypatch.setattr("sys.argv", list(map(str, words)))
    with pytest.raises(SystemExit, match=r"bare.npz: does not state its sensor; expected a rec"):
        runpy.run_path(str(EXAMPLES / "roshambo_cnn.py"), run_name="__main__")


def test_other_folders_than_roshambos_are_refused_in_a_line(tmp_path, capsys, monkeypatch):
    folder = tmp_path / "numbers"

    def refused():
        words = ("roshambo_cnn.py", folder, tmp_path / "out.safetensors")
        return refusal(capsys, monkeypatch, *words)

    expected = r"expected model/numpy_weights of https://github.com/SensorsINI/dextra-roshambo"
    assert f"shift_per_layer_kernel.npy: no such file; {expected}" in refused()
    write_made_numbers(folder)
    (folder / "layer3_bias.npy").unlink()
    assert f"layer3_bias.npy: no such file; {expected}" in refused()
    for content in (b"0.5", b"", (folder / "layer2_bias.npy").read_bytes()[:-1]):
        (folder / "layer3_bias.npy").write_bytes(content)
        assert f"layer3_bias.npy: no array of NumPy; {expected}" in refused()
    np.save(folder / "layer3_bias.npy", np.zeros(64, np.float32))
    message = "layer3_bias.npy: must be whole numbers of shape (64,), got float32 of shape (64,); "
    assert message in refused()
    np.save(folder / "layer3_bias.npy", np.zeros(63, int))
    assert "must be whole numbers of shape (64,), got int64 of shape (63,); " in refused()
    assert not (tmp_path / "out.safetensors").exists()


def test_the_published_roshambo_weights_see_their_sample_frames(data):
    """The frames have no labels; we looked at some of each of these runs."""
    weights = data / "roshambo" / "numpy_weights"
    frames = data / "roshambo" / "sample_frames"
    if not (weights.is_dir() and frames.is_dir()):
        pytest.skip(f"no numpy_weights and sample_frames in {weights.parent}")
    image = pytest.importorskip("PIL.Image", reason="pictures are read by Pillow (extra `train`)")
    network = ROSHAMBO["published_network"](weights).eval()
    model = ROSHAMBO["convert"](weights)
    for label, numbers in (
        ("rock", range(20, 50)),
        ("scissors", range(60, 75)),
        ("paper", range(130, 190)),
        ("background", range(230, 280)),
    ):
        for number in numbers[::7]:
            pixels = np.asarray(image.open(frames / f"{number:04}.png"))
            counts = (pixels.astype(int) + 1) // 16
            y, x = (np.repeat(axis, counts[counts > 0]) for axis in np.nonzero(counts))
            config = model.config.replace(window_events=len(x))
            processor = async_tnt.Processor(replace(model, config=config))
            (decision,) = processor.push(events_of(np.arange(len(x)), x, y, x % 2))
            with torch.no_grad():
                expected = network(torch.tensor(pixels[None, None] / 256, dtype=torch.float32))[0]
            assert decision.label == label, number
            np.testing.assert_allclose(decision.logits, expected.numpy(), atol=1e-4)
