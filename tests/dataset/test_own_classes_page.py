"""docs/own_classes.md: its commands and its program run, and its tables name what there is."""

import json
import re
from pathlib import Path

import pytest
from dataset.gestures import bar, write
from made import random_model

from async_tnt import Model, TNTConfig
from async_tnt.cli import main

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "own_classes.md").read_text(encoding="utf-8")


def test_its_commands_run_and_its_program_decides(tmp_path, monkeypatch, capsys):
    for package in ("torch", "matplotlib"):
        pytest.importorskip(package, reason=f"the page uses {package}")
    monkeypatch.chdir(tmp_path)
    for folder, n, day in (("gestures", 5, "monday"), ("held_out", 2, "friday")):
        for name, kind in (("wave", "upright"), ("clap", "flat")):
            for k in range(n):
                write(Path(folder, name, f"{day}_{k:02d}.npz"), bar(kind, k + len(folder)))
    commands = re.findall(
        r"^async-tnt ([^#\n]+)", "".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)), re.MULTILINE
    )
    expected = ["train", "mask", "train", "evaluate", "run", "evaluate", "evaluate", "run"]
    assert [command.split()[0] for command in commands] == expected
    for command in commands:
        quick = ["--epochs", "8", "--batch", "2"] if command.startswith("train") else []  # the page's takes 7 s
        assert main(command.split() + quick) == 0, capsys.readouterr().err
    for name in ("gestures.json", "gestures.confusion.png", "gestures.curves.png", "confusion.png"):
        assert name in PAGE and Path(name).is_file(), name
    (program,) = re.findall(r"```py\n(.*?)```", PAGE, re.DOTALL)
    capsys.readouterr()
    exec(compile(program, "own_classes.md", "exec"), {})
    assert capsys.readouterr().out.startswith("wave ")


def test_it_names_every_number_of_the_report(tmp_path, capsys):
    made = random_model(TNTConfig(sensor=(128, 128)), classes=2)
    Model(made.config, made.weights, ("wave", "clap")).save(tmp_path / "m.safetensors")
    write(tmp_path / "set" / "wave" / "a.npz", bar("flat", 0))
    assert main(["evaluate", str(tmp_path / "m.safetensors"), str(tmp_path / "set"), "--json"]) == 0
    assert [name for name in json.loads(capsys.readouterr().out) if f"`{name}`" not in PAGE] == []
