"""The commands of experiments/ run, report every row, and refuse to compare different work."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import experiments
from async_tnt.cli.options import volume_of
from experiments import decisions, edges
from experiments import quick as quick_commands
from experiments.digit_data.mnist import load_mnist
from experiments.digit_data.nmnist_files import write_nmnist
from experiments.digit_data.small_sets import write_small_mnist, write_small_nmnist
from experiments.motions.simulated_digits import simulate_digit
from experiments.records.files import read_numbers
from experiments.tables.parts import results

QUICK_HERE = ("edges", "volumes")
"""Commands that take a few seconds with small made data."""

COMMANDS = [
    path
    for path in Path(experiments.__file__).parent.glob("*.py")
    if "exit_with(main)" in path.read_text()
]


@pytest.mark.parametrize("name", [path.stem for path in COMMANDS])
def test_every_command_has_help_and_stands_in_the_list(name, capsys):
    pytest.importorskip("torch", reason="torch is not installed")
    with pytest.raises(SystemExit, match="0"):
        importlib.import_module(f"experiments.{name}").main(["--help"])
    assert capsys.readouterr().out.startswith(f"usage: python -m experiments.{name} ")
    assert (
        f"`python -m experiments.{name}"
        in (Path(experiments.__file__).parent / "README.md").read_text()
    )


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """One quick run: its report, text and picture."""
    folder = tmp_path_factory.mktemp("decisions")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        words = ["--quick", "--json", str(folder / "d.json"), "--picture", str(folder / "d.png")]
        assert decisions.main(words) == 0
    return (
        read_numbers(folder / "d.json"),
        printed.getvalue(),
        folder / "d.png",
    )


def test_every_row_is_timed_or_left_out_with_a_reason(quick):
    report, text, _ = quick
    for part in ("network", "end_to_end"):
        rows = report[part]["1"]["in_blocks"]["us"]
        assert set(rows) | set(report["left_out"][part]) == set(report["work"][part])
        assert not set(rows) & set(report["left_out"][part])
        assert not [
            work for name, work in report["work"][part].items() if name in rows and work not in text
        ]


def test_the_recorded_run_was_a_full_one_of_this_script(quick):
    recorded = results("decisions")
    assert {k: recorded["settings"][k] for k in decisions.FULL} == decisions.FULL and not recorded[
        "settings"
    ]["quick"]
    assert recorded["left_out"] == {"network": {}, "end_to_end": {}}
    assert recorded["work"] == quick[0]["work"]


def test_events_fall_with_the_angle_between_edge_and_motion(tmp_path):
    """The recordings are simulated, in N-MNIST's layout.

    They are numbered from 1, as the images that they show.
    """
    mnist = write_small_mnist(tmp_path, 20)
    images, labels = load_mnist(mnist, "train")
    for i, (image, label) in enumerate(zip(images, labels, strict=True)):
        path = tmp_path / "nmnist" / "Train" / str(label) / f"{i + 1:05}.bin"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_nmnist(path, simulate_digit(image, np.random.default_rng(i)))
    report = edges.measure(tmp_path / "nmnist", mnist, 20)
    events = report["events_per_gradient"]
    right = report["polarity_as_expected"]
    assert report["recordings"] == 20 and min(right[:4]) > 0.9 > right[-1]
    assert events[0] > events[3] > 2 * events[5]
    assert events[3] / events[0] == pytest.approx(
        report["cosine"][3] / report["cosine"][0], abs=0.15
    )
    for found in report["between_saccades"].values():
        assert 100 < found["angle_deg"] < 130
        assert (
            found["signed"] == pytest.approx(found["expected"], abs=0.2) and found["unsigned"] > 0.3
        )


def test_networks_are_compared_and_drawn(tmp_path, capsys, monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed")
    from experiments import incremental

    two = {name: incremental.NETWORKS[name] for name in ("thesis", "conv4")}
    monkeypatch.setattr(incremental, "NETWORKS", two)
    words = ["--quick", "--json", str(tmp_path / "i.json"), "--picture", str(tmp_path / "i.png")]
    assert incremental.main(words) == 0
    report = read_numbers(tmp_path / "i.json")
    text = capsys.readouterr().out
    assert list(report["networks"]) == list(two) and all(name in text for name in two)
    for row in report["networks"].values():
        counts = [row["touched"][n]["multiplications"] for n in ("1", "10", "100", "1300", "whole")]
        assert counts == sorted(counts) and counts[0] < counts[-1] / 5
        assert {"incremental", "dense", "torch"} <= row["network"]["1"]["in_blocks"]["us"].keys()
    assert report["networks"]["conv4"]["touched"]["whole"]["multiplications"] == pytest.approx(
        12.3e6, rel=0.02
    )
    assert (tmp_path / "i.png").stat().st_size > 10_000


def test_inputs_that_are_compared_are_different_ones():
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    from async_tnt.training.settings import default_config
    from experiments import cars, unseen_motions

    of_cars = [
        words.split()[1] for name, words in cars.RECIPES.items() if name.startswith("equal_")
    ]
    for volumes in (of_cars, [words[1] for words in unseen_motions.VOLUMES.values()]):
        configs = {default_config(**volume_of(volume)) for volume in volumes}
        assert len(configs) == len(volumes)


@pytest.fixture
def small_sets(tmp_path):
    """A folder with small made sets, as `experiments.quick` has it."""
    (tmp_path / "mnist").mkdir()
    write_small_mnist(tmp_path / "mnist", 60)
    first_number = quick_commands.FIRST_NUMBER
    write_small_nmnist(tmp_path / "nmnist", n_train=4, first_number=first_number)
    return tmp_path


class ParsedError(Exception):
    """Raised where a command has understood its options."""


@pytest.mark.parametrize("name, words", quick_commands.commands())
def test_commands_on_the_page_of_results_are_understood(name, words, monkeypatch, tmp_path):
    pytest.importorskip("torch", reason="torch is not installed")
    parse = argparse.ArgumentParser.parse_args

    def parse_only(self, *arguments):
        parse(self, *arguments)
        raise ParsedError

    monkeypatch.chdir(tmp_path)
    for folder in ("experiments/results", "docs/images"):
        Path(folder).mkdir(parents=True)
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_only)
    with pytest.raises(ParsedError):
        importlib.import_module(f"experiments.{name}").main(shlex.split(words))


def test_every_command_on_the_page_of_results_can_be_tried():
    on_page = {name for name, _ in quick_commands.commands()} - {"pages", "digits"}
    assert on_page <= set(quick_commands.QUICK)
    for name, words in quick_commands.QUICK.items():
        assert (Path(experiments.__file__).parent / f"{name}.py").is_file()
        assert set(re.findall(r"{(\w+)}", words)) <= {"out", "nmnist", "mnist"}


@pytest.mark.parametrize("name", QUICK_HERE)
def test_commands_that_take_seconds_run(name, small_sets):
    failure, _ = quick_commands.run(name, small_sets)
    assert failure == ""
