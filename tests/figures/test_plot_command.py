"""`async-tnt plot`: pictures in files, and one clear line for whatever is wrong."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

image = pytest.importorskip("matplotlib.image", reason="figures need matplotlib (extra: plot)")

from made import events_of, random_events, random_model  # noqa: E402

from async_tnt import TNTConfig  # noqa: E402
from async_tnt.cli import main  # noqa: E402
from async_tnt.cli.plot import FIGURES  # noqa: E402
from async_tnt.sources.files.nmnist import write_nmnist  # noqa: E402
from async_tnt.sources.files.recording import sample_recordings  # noqa: E402

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
LABELS = {
    "overview": [
        "3.bin: “3”, mean probability",
        "events as they came",
        "after TNT (running, t_max 3)",
        "v (px)",
        "event volume of window 1",
        "52 ms",
        "class probability",
        "others",
        "events / ms",
        "decisions of digits (running, t_max 3) every 2.5 ms",
    ],
    "events": [
        "3.bin, window 1",
        "events as they came",
        "time in the window (ms)",
        "x (px)",
        "u (px)",
        "ON (brighter)",
    ],
    "slices": ["bin 8", "105 ms", "raw", "TNT", "events / cell", "ON minus OFF"],
    "probabilities": ["“3”", "window 3", "class probability", "time in the recording (ms)"],
    "motions": ["window 1: moving down", "window 2: moving up", "y, after TNT v (px)", "mean place", "52 ms"],
    "pipeline": [
        "recording",
        "raw events",
        "landmark: running",
        "transformed events",
        "event volume",
        "network",
        "class probabilities",
        "64 to 10 fully connected",
    ],
}


@pytest.fixture(autouse=True)
def in_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def plot(*words):
    return main(["plot", *map(str, words)])


def is_a_picture(path, least_colours=30):
    pixels = image.imread(path)
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > least_colours
    blank = (pixels[..., :3] == 1).all(axis=2)
    assert 0.3 < blank.mean() < 0.98
    # every quarter of the page has something on it
    height, width = blank.shape
    for rows in (slice(0, height // 2), slice(height // 2, height)):
        for columns in (slice(0, width // 2), slice(width // 2, width)):
            assert not blank[rows, columns].all()
    return pixels.shape[1], pixels.shape[0]


@pytest.mark.parametrize("figure", FIGURES)
def test_every_figure_as_png_and_svg(figure, capsys):
    assert plot("--figure", figure, "--dpi", 50) == 0
    png = Path(f"3-{figure}.png")
    width, height = is_a_picture(png)
    assert width == 520
    assert capsys.readouterr().out == f"{png} ({width} x {height} pixels, {png.stat().st_size / 1e3:.0f} kB)\n"

    svg = Path("figure.svg")
    assert plot("--figure", figure, "--out", svg) == 0
    text = " ".join("".join(ElementTree.parse(svg).getroot().itertext()).split())
    for label in LABELS[figure]:
        assert label in text
    assert svg.stat().st_size < 1_000_000
    assert sorted(path.name for path in Path().iterdir()) == sorted([png.name, svg.name])  # and no .part


def test_pdf_falls_out():
    assert plot("--figure", "slices", "--out", "slices.pdf") == 0
    assert Path("slices.pdf").read_bytes().startswith(b"%PDF")


def test_the_same_command_gives_the_same_bytes():
    for suffix in ("svg", "png"):
        written = []
        for _ in range(2):
            assert plot("--figure", "slices", "--out", f"a.{suffix}", "--dpi", 40) == 0
            written.append(Path(f"a.{suffix}").read_bytes())
        assert written[0] == written[1]


@pytest.mark.parametrize(
    ("name", "words"),
    [("what_happens", []), ("motions", ["--figure", "motions"]), ("pipeline", ["--figure", "pipeline"])],
)
def test_the_pictures_in_the_documentation_are_what_the_command_draws(name, words):
    """Up to the dots that one matplotlib puts elsewhere than the next. When this fails: draw them again."""
    assert plot(*words, "--out", "again.png") == 0
    kept, again = (in_squares(image.imread(path)) for path in (IMAGES / f"{name}.png", "again.png"))
    assert kept.shape == again.shape
    assert np.abs(kept - again).max() < 0.2  # another landmark makes 0.35, another recording 0.6
    assert (IMAGES / f"{name}.png").stat().st_size < 200_000


def in_squares(pixels, side=20):
    """Mean colour of each square of a picture."""
    height, width = (n // side for n in pixels.shape[:2])
    cut = pixels[: height * side, : width * side, :3]
    return cut.reshape(height, side, width, side, 3).mean(axis=(1, 3))


def test_options_reach_the_picture():
    words = [
        "--figure",
        "slices",
        "--landmark",
        "line",
        "--remove-flow",
        "--t-max",
        2,
        "--polarity",
        "unsigned",
        "--bins",
        5,
        "--window-us",
        50_000,
        "--grid",
        "20x30",
        "--window",
        2,
        "--slices",
        1,
        4,
    ]
    assert plot(5, *words, "--out", "s.svg") == 0
    text = " ".join("".join(ElementTree.parse("s.svg").getroot().itertext()).split())
    for label in (
        "5.bin, window 2",
        "line, flow removed, t_max 2",
        "20 x 30 pixels, 5 time bins; ink",
        "bin 4",
        "50 ms",
    ):
        assert label in text
    assert "bin 2" not in text


def test_two_recordings_are_two_motions():
    for name, step in (("right", 1), ("left", -1)):
        events = random_events(600, seed=1)
        events["x"] = np.clip(17 + step * (events["t"] - 52_500) // 8_000 + events["x"] // 6, 0, 33)
        write_nmnist(f"{name}.bin", events)
    assert plot("right.bin", "left.bin", "--figure", "motions", "--dpi", 40) == 0
    is_a_picture("right-left-motions.png")
    assert plot("right.bin", "left.bin", "--figure", "motions", "--out", "m.svg") == 0
    text = "".join(ElementTree.parse("m.svg").getroot().itertext())
    assert "right.bin: moving right" in text and "left.bin: moving left" in text


def test_a_recording_of_another_camera_needs_no_model(capsys):
    """Its own sensor from the file or the option; the model's network has no say."""
    events = random_events(30_000, sensor=(120, 80))
    np.savez("camera.npz", events=events, sensor=np.array([120, 80]))
    assert plot("camera.npz", "--dpi", 40) == 0
    captured = capsys.readouterr()
    assert captured.err == "async-tnt: camera.npz: no decisions, model digits is not for 120x80 pixels (--model)\n"
    is_a_picture("camera-overview.png")
    np.save("camera.npy", events)
    assert plot("camera.npy", "--figure", "events", "--dpi", 40) == 2
    assert "events reach pixel (119, 79); give its size with --sensor WxH" in capsys.readouterr().err
    assert plot("camera.npy", "--figure", "events", "--sensor", "120x80", "--out", "e.svg") == 0
    assert capsys.readouterr().err == ""
    assert Path("e.svg").stat().st_size < 1_000_000  # a cloud of dots is one picture


def test_a_model_of_ones_own():
    model = random_model(TNTConfig(landmark="line", remove_flow=True), classes=3)
    model.save("mine.safetensors")
    assert plot("--model", "mine.safetensors", "--figure", "probabilities", "--every-us", 20_000, "--out", "p.svg") == 0
    text = "".join(ElementTree.parse("p.svg").getroot().itertext())
    assert "decisions of mine.safetensors (line, flow removed, t_max 8) every 20 ms" in text and "“class " in text
    assert plot("--model", "mine.safetensors", "--figure", "slices", "--landmark", "center", "--out", "c.svg") == 0
    assert "after TNT (center, t_max 8)" in "".join(ElementTree.parse("c.svg").getroot().itertext())


def written(name, content):
    Path(name).write_bytes(content)
    return name


def saved(name, events, **more):
    np.savez(name, events=events, **more)
    return name


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (lambda: ["missing.bin"], "missing.bin: No such file"),
        (lambda: [written("cut.bin", bytes(7))], "cut.bin: damaged N-MNIST recording of 7 bytes"),
        (lambda: [written("empty.bin", b"")], "empty.bin: no events to draw"),
        (lambda: [written("x.doc", b"hello")], "x.doc: unknown suffix '.doc'"),
        (lambda: ["--out", "figure.jpg"], "--out must end in .png, .svg, .pdf, got figure.jpg"),
        (lambda: ["--out", "nowhere/figure.png"], "no folder nowhere to write figure.png to"),
        (lambda: ["--window", 4], "3.bin: no window 4; the recording has 3 windows of 105000 us"),
        (lambda: ["--figure", "motions", "--windows", 1, 9], "3.bin: no window 9"),
        (lambda: ["--start-us", 10**9], "3.bin: no event at or after the first window's start, 1000000000 us"),
        (lambda: ["--model", "digitz"], "no model file digitz"),
        (
            lambda: [saved("h.npz", random_events(9), sensor=np.array([40, 40])), "--model", "digits"],
            "h.npz: a sensor of 40x40 pixels, but the model is for 34x34",
        ),
        (
            lambda: [saved("h.npz", random_events(9), sensor=np.array([40, 40])), "--figure", "pipeline"],
            "h.npz: a sensor of 40x40 pixels, but the model is for 34x34; give another --model than digits",
        ),
        (
            lambda: [saved("h.npz", random_events(9), sensor=np.array([40, 40])), "--sensor", "50x50"],
            "h.npz: a sensor of 40x40 pixels, got --sensor 50x50",
        ),
        (
            lambda: [saved("h.npz", events_of([5], [40], [1], [1])), "--sensor", "40x40"],
            "h.npz: `x` must be in [0, 40), got 40 at event 0",
        ),
        (lambda: ["--remove-flow"], '`remove_flow` needs landmark="line"'),
        (lambda: ["--t-max", "nan"], "`t_max` must be in [1e-6, 1e6], got nan"),
        (lambda: ["--landmark", "regressor"], "needs a model with a landmark network, but model digits has none"),
        (lambda: ["--slices", 9], "--slices must be in [0, 9), the volume's bins, got 9"),
        (lambda: ["--figure", "motions", "--slices", -1], "--slices must be in [0, 9), the volume's bins, got -1"),
        (
            lambda: ["--figure", "pipeline", "--t-max", 2],
            "--t-max has no effect on --figure pipeline, only on overview, events, slices, motions",
        ),
        (lambda: ["--window", 2, "--figure", "motions"], "--window has no effect on --figure motions"),
        (lambda: ["--windows", 1, 2], "--windows has no effect on --figure overview, only on motions"),
        (lambda: ["3", "4"], "--figure overview draws 1 recording, got 2"),
        (lambda: ["3", "4", "5", "--figure", "motions"], "--figure motions draws 2 recordings, got 3"),
        (
            lambda: ["3", saved("h.npz", random_events(9), sensor=np.array([40, 40])), "--figure", "motions"],
            "two motions are drawn with one configuration, got sensors of 34x34 pixels and 40x40 pixels",
        ),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(words, message, capsys):
    assert plot(*words()) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("async-tnt: ") and message in captured.err and captured.err.count("\n") == 1
    assert captured.out == "" and not list(Path().glob("*.p*g*")) and not list(Path().glob("*.part"))


@pytest.mark.parametrize("words", [["--dpi", 5], ["--sensor", "34"], ["--figure", "cube"], ["--window", 0]])
def test_bad_usage_exits_with_2(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        plot(*words)
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("async-tnt plot: argument --")


def test_help_teaches_without_matplotlib(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(SystemExit) as stopped:
        plot("--help")
    assert stopped.value.code == 0
    captured = capsys.readouterr().out
    assert all(f"  {name} " in captured for name in FIGURES) and "async-tnt plot 8 --figure pipeline" in captured


def test_without_matplotlib_one_line_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert plot() == 2
    err = capsys.readouterr().err
    assert err.startswith("async-tnt: plot draws with matplotlib: pip install '.[plot]'") and err.count("\n") == 1


def test_an_interrupted_save_leaves_the_old_picture(monkeypatch, capsys):
    from matplotlib.figure import Figure

    Path("3-slices.png").write_bytes(b"old")

    def interrupt(self, path, **settings):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", interrupt)
    assert plot("--figure", "slices") == 130
    assert Path("3-slices.png").read_bytes() == b"old" and len(list(Path().iterdir())) == 1


def test_a_digit_is_a_sample_unless_a_file_has_that_name(capsys):
    assert plot(7, "--figure", "slices", "--dpi", 40) == 0
    assert Path("7-slices.png").exists()
    write_nmnist("7.bin", random_events(50))
    Path("7.bin").rename("7")
    assert plot(7, "--figure", "slices") == 2  # a file without a suffix is no recording
    assert "unknown suffix" in capsys.readouterr().err


def test_drawing_needs_no_torch_no_pyplot_and_changes_no_settings():
    code = (
        "import sys, matplotlib; matplotlib.rcParams['font.size'] = 23; from async_tnt.cli import main; "
        f"main(['plot', {str(sample_recordings()[1])!r}, '--dpi', '40']); "
        "print({'torch', 'matplotlib.pyplot', 'tnt_reference'} & set(sys.modules), matplotlib.rcParams['font.size'])"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=120, env=os.environ
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert done.stdout.splitlines()[-1] == "set() 23.0"


def test_the_package_and_its_help_import_no_matplotlib():
    code = (
        "import sys, async_tnt, async_tnt.cli.plot, async_tnt.views.figure_overview, async_tnt.views.figure_motions, "
        "async_tnt.views.figure_pipeline; print('matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout == "False\n"
