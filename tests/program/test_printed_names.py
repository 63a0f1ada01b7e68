"""Names of classes and files are data.

Whatever they contain, a command prints them on one line, without escapes.
"""

import ast
import os
from dataclasses import replace
from pathlib import Path

import pytest
from made import random_model
from training.gestures import bar, write

from async_tnt import TNTConfig
from async_tnt import cli as package

pytestmark = pytest.mark.skipif(os.name != "posix", reason="names that only POSIX allows")
RED = "\x1b[31mred\nnext"
"""A name that a terminal obeys, with a line break."""
SHOWN = r"[31mred\nnext"
"""What is printed of it, behind the escape, which JSON writes in another way."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A model and recordings with this name for a class, one of them damaged."""
    monkeypatch.chdir(tmp_path)
    config = TNTConfig(sensor=(40, 40), window_us=50_000)
    replace(random_model(config, classes=2, widths=(2, 2, 4)), classes=(RED, "b")).save(
        f"{RED}.safetensors"
    )
    for name, kind in ((RED, "flat"), ("b", "upright")):
        for k in range(3):
            write(
                Path("set", name, f"{name}{k}.npz"), bar(kind, k, side=40, n=300), sensor=(40, 40)
            )
    Path("set", RED, f"{RED}.npz").write_bytes(b"damaged")
    write(Path(f"{RED}.npz"), bar("flat", 9, side=40), sensor=(40, 40))
    return tmp_path


COMMANDS = {
    "run": "run RECORDING --model MODEL",
    "json": "run RECORDING --model MODEL --json",
    "evaluate": "evaluate MODEL set --out NAME.jsonl",
    "mask": "mask RECORDING --out NAME.npy",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_prints_a_name_as_it_is(command, folder, program):
    places = {"RECORDING": f"{RED}.npz", "MODEL": f"{RED}.safetensors"}
    words = [places.get(word, word.replace("NAME", RED)) for word in COMMANDS[command].split()]
    code, out, err = program(*words)
    if "pip install 'async_tnt[" in err:
        pytest.skip(err)
    assert code == 0, err
    assert SHOWN in out + err
    for line in (out + err).splitlines():
        assert line.isprintable() and not line.startswith("next")


def test_commands_print_by_one_function():
    """The law that the test above samples."""
    for path in Path(package.__file__).parent.glob("*.py"):
        calls = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call)]
        printing = [n.lineno for n in calls if ast.unparse(n.func) == "print"]
        assert not printing or path.name == "output.py", f"{path.name}: {printing}"
