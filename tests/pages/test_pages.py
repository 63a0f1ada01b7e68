"""The pages: snippets run, commands exist, links work, numbers and names are those of the code."""

import contextlib
import doctest
import functools
import importlib
import io
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from pages.snippets import ROOT, blocks
from small_sets import write_pictures
from training.gestures import bar, write

from async_tnt.cli import main
from async_tnt.cli.program import COMMANDS, build_parser
from async_tnt.sources import READERS, sample_recordings
from async_tnt.training import simulated_pictures
from experiments.digit_data.small_sets import write_small_mnist
from experiments.moving_set.build import build
from experiments.records.files import read_numbers
from experiments.tables.parts import results

PAGES = [
    page for folder in (".", "docs", "experiments") for page in sorted(ROOT.glob(f"{folder}/*.md"))
]
README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "guide.md").read_text(encoding="utf-8")
REFERENCE = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
THEORY = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
# section -> packages that its snippets need
NEEDS = {
    "Viewing": ("rerun",),
    "Other networks and engines": ("torch", "onnx", "onnxruntime"),
}


def sections(page):
    """(title, text) of each section: what follows a heading of the second level.

    The text before the first one has the title "".
    """
    before, *rest = re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return [("", before), *(part.split("\n", 1) for part in rest)]


def commands(text):
    """The lines of `async-tnt` in shell blocks, as lists of words."""
    found = []
    for line in "".join(blocks(text, "sh")).splitlines():
        if line.startswith("async-tnt "):
            words = shlex.split(line, comments=True)[1:]
            found.append(words[: words.index(">")] if ">" in words else words)
    return found


@functools.cache
def options():
    """All options of all commands."""
    found = set()
    for name in COMMANDS:
        parser = build_parser([name])._subparsers._group_actions[0].choices[name]
        for action in parser._actions:
            found.update(action.option_strings)
    return found


@functools.cache
def help_of(name):
    """What `python -m experiments.NAME --help` prints, as words."""
    with contextlib.redirect_stdout(io.StringIO()) as printed, pytest.raises(SystemExit):
        importlib.import_module(f"experiments.{name}").main(["--help"])
    return set(re.findall(r"--[a-z][a-z-]*", printed.getvalue()))


def sections_with_snippets():
    for page in PAGES:
        for title, text in sections(page):
            if title and blocks(text, "python"):
                yield pytest.param(page, title, id=f"{page.stem}-{title}")


@pytest.mark.parametrize("page, title", list(sections_with_snippets()))
def test_snippets_run_and_print_what_the_page_shows(page, title, tmp_path, monkeypatch, capsys):
    """A section's snippets run after those that stand before the page's first section."""
    monkeypatch.chdir(tmp_path)
    for package in NEEDS.get(title, ()):
        pytest.importorskip(package)
    if title == "N-MOVING-MNIST":
        (tmp_path / "mnist").mkdir()
        mnist = write_small_mnist(tmp_path / "mnist", 8)
        build(mnist, tmp_path / "moving", which=range(8), workers=1, frame_us=10_500.0)
    if title == "Archives":
        for digit, path in sample_recordings().items():
            (tmp_path / "set" / str(digit)).mkdir(parents=True)
            shutil.copy(path, tmp_path / "set" / str(digit))
        assert main(["evaluate", "digits", "set", "--out", "results.jsonl"]) == 0
    texts = dict(sections(page))
    session = {"__name__": "__main__"}
    report = []
    for snippet in blocks(texts[""] + texts[title], "python"):
        if ">>>" not in snippet:
            exec(snippet, session)
            continue
        test = doctest.DocTestParser().get_doctest(snippet, session, title, str(page), 0)
        doctest.DocTestRunner().run(test, out=report.append, clear_globs=False)
        session = test.globs
    assert not report, "".join(report)
    printed = capsys.readouterr().out
    if title == "Use":
        ends = [line for line in printed.splitlines() if line.endswith(("window", "end"))]
        assert [line.split()[2] for line in ends] == ["3", "3", "3"]
    if title == "Archives":
        assert len(session["results"]) == 10 and session["wrong"] == {}
    if title == "N-MOVING-MNIST":
        assert printed.startswith("036deg-5px 7 ")
        assert session["total"] > len(session["events"]) > 10


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_options_exist(page):
    text = page.read_text(encoding="utf-8")
    for words in commands(text):
        build_parser(words).parse_args(words)  # exits where it does not understand
    for name, words in re.findall(r"python -m experiments\.(\w+)((?: [^\s`|]+)*)", text):
        assert set(re.findall(r"--[a-z][a-z-]*", words)) - help_of(name) == set()
    if page.parent.name == "docs":
        assert set(re.findall(r"`(--[a-z][a-z-]*)", text)) - options() == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files_and_headings(page):
    for link in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        if link.startswith("http"):
            continue
        name, _, heading = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        if heading:
            titles = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
            plain = [re.sub(r"[^\w -]", "", title.lower()) for title in titles]
            assert heading in [title.replace(" ", "-") for title in plain], link


def test_ci_runs_the_two_commands_of_the_readme():
    """They are compared to the letter, so that a step that README misses shows here."""
    install = dict(sections(ROOT / "README.md"))["Install"]
    commands = [line for block in blocks(install, "sh") for line in block.splitlines()]
    assert len(commands) == 2
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert set(commands) <= set(ci)


def test_pages_and_files_that_are_named_exist():
    for path in [
        *ROOT.glob("async_tnt/**/*.py"),
        *ROOT.glob("tests/**/*.py"),
        *ROOT.glob("experiments/**/*.py"),
    ]:
        for name in re.findall(r"docs/\w+\.md", path.read_text(encoding="utf-8")):
            assert (ROOT / name).is_file(), f"{path}: {name}"
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    for name in re.findall(r"`([\w/]+(?:\.py|/))`", text):
        assert any((folder / name).exists() for folder in (ROOT, ROOT / "async_tnt")), name
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert [path.name for path in ROOT.glob("docs/images/*") if path.name not in pages] == []


def test_the_pages_name_all_commands_and_formats():
    missing = [name for name in COMMANDS if f"async-tnt {name}" not in README + GUIDE + THEORY]
    assert missing + [suffix for suffix in READERS if f"`{suffix}`" not in REFERENCE] == []


def test_commands_about_your_own_classes_run_and_the_program_decides(tmp_path, monkeypatch, capsys):
    for package in ("torch", "matplotlib"):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    for folder, n, day in (("gestures", 5, "monday"), ("held_out", 2, "friday")):
        for name, kind in (("wave", "upright"), ("clap", "flat")):
            for k in range(n):
                write(Path(folder, name, f"{day}_{k:02d}.npz"), bar(kind, k + len(folder)))
    for k in range(6):
        write(Path("point", f"{k:02d}.npz"), bar("slanted", k))
    monkeypatch.setattr(simulated_pictures, "RECORDINGS", {"training": 2, "held-out": 1})
    monkeypatch.setattr(simulated_pictures, "N_TAKES", 1)
    monkeypatch.setattr("async_tnt.cli.train.available_cores", lambda: 1)  # no more processes
    write_pictures(Path("pictures"), n=2)
    rng = np.random.default_rng(0)
    # a smaller camera than the guide's
    x = rng.integers(0, 96, 8_000)
    y = rng.integers(0, 72, 8_000)
    p = rng.integers(0, 2, 8_000)
    np.savez("anything.npz", t=np.arange(0, 400_000, 50), x=x, y=y, p=p)
    text = dict(sections(ROOT / "docs" / "guide.md"))["Your own classes"]
    shown = commands(text)
    assert {words[0] for words in shown} == {"train", "mask", "evaluate", "run", "teach"}
    for words in shown:
        once = "pictures" in words or "--motions" in words
        quick = ["--grid", "24x18", "--network", "thesis", "--epochs", "1" if once else "5"]
        capsys.readouterr()
        words = [word.replace("346x260", "96x72") for word in words]
        assert main([*words, *(quick if words[0] == "train" else [])]) == 0, capsys.readouterr().err
        # the reference names every number of an evaluation
        if "--json" in words:
            for name in json.loads(capsys.readouterr().out):
                assert f"`{name}`" in REFERENCE
    for name in ("gestures.json", "gestures.curves.png"):
        assert name in text and Path(name).is_file(), name
    (program,) = blocks(text, "py")
    capsys.readouterr()
    exec(compile(program, "guide.md", "exec"), {})
    assert capsys.readouterr().out.startswith("wave ")


def test_the_numbers_of_the_theory_are_those_that_the_script_prints(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    from experiments import figure_laws

    assert figure_laws.main(["--picture", str(tmp_path / "laws.png")]) == 0
    printed = capsys.readouterr().out.splitlines()
    rows = [line for line in printed if line.startswith("|")]
    assert [line for line in THEORY.splitlines() if line in set(rows)] == rows
    assert len(rows) > 30
    assert (tmp_path / "laws.png").stat().st_size > 10_000
    border = next(line for line in printed if line[:1].isdigit())
    assert f"> {border}\n" in THEORY
    lost = next(line for line in printed if line.startswith("Of the events that are lost"))
    assert lost in " ".join(THEORY.split())


def test_features_move_along_with_the_flow_about_a_fixed_landmark(tmp_path):
    """The theory's figure has no error about the centre for some translations.

    These are multiples of the layer's stride.
    """
    pytest.importorskip("matplotlib")
    from experiments import figure_equivariance

    picture = tmp_path / "equivariance.png"
    report = tmp_path / "equivariance.json"
    assert figure_equivariance.main(["--picture", str(picture), "--json", str(report)]) == 0
    found = read_numbers(report)["errors"]
    recorded = results("equivariance")["errors"]
    pixels = {"volume": 1, "convolution 1": 1, "pooling 1": 2, "convolution 2": 2, "pooling 2": 4}
    for name, of_layer in found.items():
        for layer, errors in of_layer.items():
            assert errors == pytest.approx(recorded[name][layer], abs=1e-6) and errors[0] == 0
            for flow, error in zip(figure_equivariance.FLOWS[1:], errors[1:], strict=True):
                moves_along = name == "TNT, center" and flow % (2 * pixels.get(layer, 1_000)) == 0
                assert (error < 1e-12) if moves_along else (error > 0.01), (name, layer, flow)
    assert max(max(errors) for errors in found["TNT, line, flow removed"].values()) < 0.45
    centre = dict(zip(figure_equivariance.FLOWS, found["TNT, center"]["logits"], strict=True))
    # 4 pixels and 6.5
    assert max(centre[flow] for flow in (1, 2, 3, 5, 8)) < 0.2 and centre[13] > 1
    assert picture.stat().st_size > 10_000
