"""Pictures for classifiers that see no event, and what they are tested on."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs torch (extra `train`)")
pytest.importorskip("matplotlib", reason="its fonts draw the pictures (extra `plot`)")

from async_tnt import load_model
from async_tnt.simulation.pictures import read_picture
from experiments import few_recordings
from experiments.digit_data.mnist import load_mnist
from experiments.from_pictures import link_official
from experiments.motions.trajectories import nmnist_saccades
from experiments.pictures import made, moving_digits
from experiments.pictures.symbols import PIPS, write_glyphs, write_mnist
from experiments.tables import datasets


def test_fonts_draw_the_same_symbols_each_in_its_way(tmp_path):
    write_glyphs(tmp_path, PIPS, None)
    files = {name: sorted(path.name for path in (tmp_path / name).iterdir()) for name in PIPS}
    assert len(files["cl"]) >= 3 and all(names == files["cl"] for names in files.values())
    drawn = {path.read_bytes() for path in tmp_path.glob("*/*.png")}
    assert len(drawn) > 0.9 * sum(map(len, files.values()))
    heart = read_picture(tmp_path / "he" / files["he"][0]).cover
    spade = read_picture(tmp_path / "sp" / files["he"][0]).cover
    # two lobes, and a tip
    assert heart[: len(heart) // 4].mean() > 0.6 > 0.4 > spade[: len(spade) // 4].mean()
    write_glyphs(tmp_path / "alike", {"a": "a", "also a": "a"}, None)
    assert not (tmp_path / "alike").exists()


def test_made_objects_differ_and_repeat(tmp_path):
    for folder in ("a", "b"):
        made.write_pictures(tmp_path / folder, 1, 0)
    made.write_recordings(tmp_path / "c", 1, 0)
    paths = sorted((tmp_path / "a").glob("*/*.jpg"))
    assert [path.parent.name for path in paths] == list(made.CLASSES)
    for path in paths:
        assert path.read_bytes() == (tmp_path / "b" / path.parent.name / path.name).read_bytes()
        assert read_picture(path).ground is None  # a photograph
        with np.load(tmp_path / "c" / path.parent.name / "000.npz") as events:
            assert len(events["t"]) > 200 and (np.diff(events["t"].astype(np.int64)) >= 0).all()


def test_the_official_test_part_is_gathered_from_both_folders(tmp_path):
    for name in ("Train/3/00001.bin", "Train/3/60001.bin", "Test/3/60002.bin", "Test/4/00002.bin"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    for _ in range(2):
        link_official(tmp_path, tmp_path / "out")
    found = {
        path.relative_to(tmp_path / "out/official").as_posix()
        for path in tmp_path.glob("out/official/*/*")
    }
    assert found == {"3/60001.bin", "3/60002.bin", "4/00002.bin"}


def test_digits_in_other_motions_and_at_other_speeds(real_mnist, monkeypatch):
    faster = moving_digits.Faster(nmnist_saccades(), 4.0)
    assert faster.duration_us == 77_000
    np.testing.assert_allclose(faster.position(20_000), nmnist_saccades().position(80_000))
    motions = moving_digits.motions_of()[1:3]
    monkeypatch.setattr(moving_digits, "motions_of", lambda: motions)
    images, labels = load_mnist(real_mnist, "test")
    found = moving_digits.accuracies([load_model("digits")] * 2, images[:6], labels[:6])
    assert list(found) == ["dark on bright", "bright on dark", "speeds"]
    assert list(found["bright on dark"]) == [motion.name for motion in motions]
    assert all(len(right) == 2 and min(right) > 0.5 for right in found["dark on bright"].values())
    assert min(found["speeds"]["1"]) > 0.8


def test_pictures_and_the_first_recordings_of_each_class(mnist, nmnist, tmp_path):
    write_mnist(tmp_path / "mnist", mnist, 10)
    n = few_recordings.write_set(tmp_path / "both", tmp_path / "mnist", nmnist, 2)
    assert (
        n == 2
        and len(list(tmp_path.glob("both/*/*.bin"))) == 20
        and len(list(tmp_path.glob("both/*/*.png"))) == 10
    )
    assert few_recordings.write_set(tmp_path / "alone", None, nmnist, 10_000) == 4
    rows = [
        {"per_class": n, "networks": [{"accuracy": 0.9, "window_accuracy": 0.8}]} for n in (0, 10)
    ]
    report = {"ways": {"pictures and recordings": rows, "recordings alone": rows[1:]}}
    assert datasets.few_recordings(report).endswith(
        "| 0 | .800 / .900 | - |\n| 10 | .800 / .900 | .800 / .900 |"
    )
    few_recordings.draw(report).savefig(tmp_path / "drawn.png")
