"""The laboratory has commands at its top, and everything else in folders.

The folders import each other in one direction.
"""

import ast
from pathlib import Path

import pytest

import experiments

ROOT = Path(experiments.__file__).parent
FILES = {
    ".".join(("experiments", *path.relative_to(ROOT).with_suffix("").parts)): path
    for path in ROOT.rglob("*.py")
    if path.name != "__init__.py"
}


def imports_of(path):
    """Names of the modules that a file imports, or imports names from.

    Imports inside of functions count, too.
    """
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def folder_of(module):
    """`experiments.speed` of `experiments.speed.timing`; `experiments` of a command."""
    return module.rpartition(".")[0]


IMPORTS = {module: set(imports_of(path)) & FILES.keys() for module, path in FILES.items()}
COMMANDS = {module for module in FILES if folder_of(module) == "experiments"}
FOLDERS = {folder_of(module) for module in FILES} - {"experiments"}


def circle_in(imports):
    """What is left of a graph when names that import nothing of it are removed again and again.

    The graph has the names that each name imports. Nothing is left if it has no circle.
    """
    left = dict(imports)
    while True:
        ends = {name for name, others in left.items() if not others & left.keys()}
        if not ends:
            return left
        left = {name: others for name, others in left.items() if name not in ends}


def test_a_circle_is_found():
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": set()}) == {}
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": {"b"}}).keys() == {"a", "b", "c"}


@pytest.mark.parametrize("module", sorted(COMMANDS))
def test_the_top_holds_commands_only(module):
    assert "exit_with(main)" in FILES[module].read_text(encoding="utf-8")


def test_nothing_imports_a_command():
    assert [
        (module, IMPORTS[module] & COMMANDS) for module in FILES if IMPORTS[module] & COMMANDS
    ] == []


def test_there_is_no_circle():
    assert sum(map(len, IMPORTS.values())) > 100
    assert circle_in(IMPORTS) == {}


def test_no_folders_import_each_other():
    """Folders import each other neither directly nor by way of other folders."""
    imports = {folder: set() for folder in FOLDERS}
    for module in FILES.keys() - COMMANDS:
        imports[folder_of(module)] |= {folder_of(other) for other in IMPORTS[module]}
    assert circle_in({name: others - {name} for name, others in imports.items()}) == {}


def test_a_folder_has_no_name_of_a_command():
    """`python -m experiments.NAME` runs a file, never a folder."""
    assert not FOLDERS & COMMANDS
