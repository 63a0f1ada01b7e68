"""`async-tnt plot`: pictures in files, and one clear line for each mistake."""

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

image = pytest.importorskip("matplotlib.image", reason="figures need matplotlib (extra: plot)")

from made import random_events, random_model, random_regressor_model  # noqa: E402
from views.raw_models import raw_model  # noqa: E402

from async_tnt import TNTConfig  # noqa: E402
from async_tnt.views.figure_style import new_figure, save, styled  # noqa: E402

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"


@pytest.fixture(autouse=True)
def in_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def plot(program):
    return lambda *words: program("plot", *words)


def text_of(svg):
    return " ".join("".join(ElementTree.parse(svg).getroot().itertext()).split())


def test_a_page_as_png_and_svg(plot):
    """The picture of README is what the command draws.

    Dots that one matplotlib puts elsewhere than the next are not compared. When this fails:
    draw it again.
    """
    import matplotlib

    settings = dict(matplotlib.rcParams)
    code, printed, _ = plot()
    assert dict(matplotlib.rcParams) == settings
    assert (code, printed) == (0, f"3.png ({Path('3.png').stat().st_size / 1e3:.0f} kB)\n")
    kept = in_squares(image.imread(IMAGES / "what_happens.png"))
    again = in_squares(image.imread("3.png"))
    assert kept.shape == again.shape
    assert np.abs(kept - again).max() < 0.2  # another landmark makes 0.35, another recording 0.6
    random_regressor_model().save("r.safetensors")
    assert plot("--model", "r.safetensors", "--out", "a.svg")[0] == 0
    labels = [
        "3.bin: “",
        "after TNT (regressor, t_max 8)",
        "event volume of window 1",
        "every 2.5 ms",
    ]
    labels += ["class probability", "time in the recording (ms)"]
    assert not [label for label in labels if label not in text_of("a.svg")]
    assert Path("a.svg").stat().st_size < 1_000_000  # a cloud of dots is one picture
    assert sorted(os.listdir()) == ["3.png", "a.svg", "r.safetensors"]
    assert plot()[0] == 0  # once more
    Path("3.png").write_bytes(b"a photograph")
    code, _, err = plot()
    assert code == 2 and "3.png is of another program" in err
    assert Path("3.png").read_bytes() == b"a photograph"
    assert plot("--out", "3.png")[0] == 0


@pytest.mark.parametrize(
    "name, begin", [("a.pdf", b"%PDF"), ("a.svg", b"<?xml"), ("a.png", b"\x89PNG")]
)
def test_the_same_figure_gives_the_same_bytes(name, begin):
    written = []
    for _ in range(2):
        with styled():
            figure = new_figure(1.0, 2.0)
            figure.subplots().scatter([1, 2], [3, 4], rasterized=True)
            save(figure, Path(name), 40)
        written.append(Path(name).read_bytes())
    assert written[0] == written[1] and written[0].startswith(begin)


def in_squares(pixels, side=20):
    """Mean colour of each square of a picture."""
    height = pixels.shape[0] // side
    width = pixels.shape[1] // side
    cut = pixels[: height * side, : width * side, :3]
    return cut.reshape(height, side, width, side, 3).mean(axis=(1, 3))


def test_options_reach_the_picture(plot):
    volume = (
        "--volume landmark=line,remove_flow=yes,t_max=2,polarity=unsigned,bins=5 --window-us 50000"
    )
    words = "--window 2 --out s.svg"
    assert plot(5, *volume.split(), *words.split())[0] == 0
    text = text_of("s.svg")
    labels = (
        "of window 2",
        "line, flow removed, t_max 2",
        "34 x 34 pixels, 5 time bins, unsigned",
        "bin 4 50 ms",
        "every 2.5 ms",
    )
    assert not [label for label in labels if label not in text]


def test_a_window_that_slides(plot):
    """It is drawn at the ends of stretches as long as it is, and its decisions in all of them."""
    config = TNTConfig(representation="count", last_us=50_000)
    random_model(config).save("m.safetensors")
    assert plot(5, "--model", "m.safetensors", "--window", 2, "--out", "s.svg")[0] == 0
    text = text_of("s.svg")
    assert "of window 2" in text and "decisions of m.safetensors every 2.5 ms" in text
    assert "ends of windows" not in text and "of 7 windows" in text
    random_model(TNTConfig(representation="count", last_events=500)).save("m.safetensors")
    code, _, err = plot(5, "--model", "m.safetensors")
    assert code == 2 and "windows of a duration can be drawn, but not of 500 events" in err


def test_volumes_without_a_picture_are_seen_in_the_viewer(plot):
    """Counts in slices of time, and those of a sensor of one line, which have no transform."""
    slices = TNTConfig(representation="volume", transform="none", last_us=50_000, bins=5)
    assert slices.slice_us == 10_000
    random_model(slices).save("m.safetensors")
    np.savez("line.npz", events=random_events(99, sensor=(40, 1)), sensor=(40, 1))
    for words, message in (
        (
            ("5", "--model", "m.safetensors"),
            "m.safetensors: volumes of counts in slices have no picture here; `async-tnt view` "
            "shows them",
        ),
        (
            ("line.npz",),
            "line.npz: the picture shows volumes after the transform, and a line of 40x1 pixels "
            "has no plane to transform; `async-tnt view` shows it",
        ),
    ):
        code, _, err = plot(*words, "--out", "a.png")
        assert (code, err) == (2, f"async-tnt: {message}\n")
        assert not Path("a.png").exists()


def test_a_dollar_in_a_files_name_is_no_formula(plot):
    np.save("a^$b^$.npy", random_events(300))  # as a formula it would be an error
    assert plot("a^$b^$.npy", "--sensor", "34x34", "--out", "a.svg")[0] == 0
    assert "a^$b^$.npy" in text_of("a.svg")


def test_a_models_flow_removal_goes_with_its_line(plot):
    random_model(TNTConfig(landmark="line", remove_flow=True, t_max=2.0)).save("m.safetensors")
    for landmark, words in (("line", "line, flow removed, t_max 2"), ("center", "center, t_max 2")):
        volume = "--volume", f"landmark={landmark}"
        assert plot(5, "--model", "m.safetensors", *volume, "--out", "s.svg")[0] == 0
        assert f"after TNT ({words})" in text_of("s.svg")
    code, _, err = plot(5, "--volume", "landmark=center,remove_flow=yes")
    assert (code, err.count("\n")) == (2, 1) and "remove_flow" in err


def test_a_recording_of_another_camera_needs_no_model(plot):
    """Its sensor comes from the file or the option."""
    events = random_events(30_000, sensor=(120, 80))
    np.savez("camera.npz", events=events, sensor=np.array([120, 80]))
    code, _, err = plot("camera.npz")
    assert code == 0
    expected = "no decisions, model digits is not for 120x80 pixels (--model)"
    assert err == f"async-tnt: camera.npz: {expected}\n"
    np.save("camera.npy", events)
    code, _, err = plot("camera.npy")
    assert code == 2
    assert "; the file states none, --sensor, the model or another recording does" in err
    assert plot("camera.npy", "--sensor", "120x80")[0] == 0
    code, _, err = plot("camera.npz", "--volume", "transform=none")
    assert code == 2 and "the volume without the transform is drawn anyway" in err


def test_a_model_of_raw_outputs(plot):
    """Its volume may be drawn otherwise; the outputs are of its own volume."""
    config = TNTConfig(sensor=(8, 6), grid=(8, 6), window_us=50_000, bins=1, polarity="unsigned")
    raw_model(config).save("net.safetensors")
    np.savez("a.npz", events=random_events(900, sensor=(8, 6)), sensor=(8, 6))
    for volume in ([], ["--volume", "bins=3"]):
        words = "--model", "net.safetensors", "--window", 2, "--out", "a.svg", *volume
        code, printed, err = plot("a.npz", *words)
        assert (code, err) == (0, "") and printed.startswith("a.svg (")
        text = text_of("a.svg")
        labels = ["after TNT (running, t_max 8)", "event volume of window 2"]
        labels += ["outputs of net.safetensors at the ends of windows", "window 3"]
        labels += ["flow (2x6x8): two channels as directions", "channel 1", "total (2): numbers"]
        assert not [label for label in labels if label not in text]
        assert "class probability" not in text
    np.savez("b.npz", events=random_events(9), sensor=(34, 34))
    code, _, err = plot("b.npz", "--model", "net.safetensors")
    assert code == 2 and err.count("\n") == 1
    assert "b.npz: a sensor of 34x34 pixels, but the model is for 8x6" in err


@pytest.mark.parametrize(
    "words, message",
    [
        ("missing.bin", "missing.bin: No such file"),
        ("empty.bin", "empty.bin: no events to draw"),
        ("--out figure.jpg", "figure.jpg: its name must end in .png, .svg, .pdf"),
        (
            "--window 4",
            "3.bin: no events in window 4, from 318075 us on; the recording ends in window 3",
        ),
        ("h.npz --model digits", "h.npz: a sensor of 40x40 pixels, but the model is for 34x34"),
        ("h.npz --sensor 50x50", "h.npz: a sensor of 40x40 pixels, but --sensor says 50x50"),
        (
            "--volume landmark=regressor",
            "needs a model with a landmark network, but model digits has none",
        ),
        (
            "3 --model times.safetensors",
            "event volumes and counts can be drawn, but not mean_time (--model, --volume)",
        ),
        (
            "--volume representation=count_time",
            "event volumes and counts can be drawn, but not count_time",
        ),
        (
            "3 --model of_events.safetensors",
            "windows of a duration can be drawn, but not of 500 events",
        ),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(words, message, plot):
    Path("empty.bin").touch()
    random_model(TNTConfig(window_events=500)).save("of_events.safetensors")
    random_model(TNTConfig(representation="mean_time")).save("times.safetensors")
    np.savez("h.npz", events=random_events(9), sensor=np.array([40, 40]))
    before = sorted(os.listdir())
    code, printed, err = plot(*words.split())
    assert (code, printed) == (2, "")
    assert err.startswith("async-tnt: ") and message in err and err.count("\n") == 1
    assert sorted(os.listdir()) == before
