"""Public names of the release before that are gone say what to write instead."""

import ast
import importlib
import re
from pathlib import Path

import pytest

PACKAGES = ["", ".sources", ".networks", ".training", ".simulation", ".resynthesis"]


def advice_of(package):
    """The table `instead` of a package: its old names, and what is said of them."""
    tree = ast.parse(Path(package.__file__).read_text(encoding="utf-8"))
    keywords = [node for node in ast.walk(tree) if isinstance(node, ast.keyword)]
    tables = [ast.literal_eval(node.value) for node in keywords if node.arg == "instead"]
    return tables[0] if tables else {}


REMOVED = [
    pytest.param(package, name, advice, id=f"{package.__name__}.{name}")
    for package in (importlib.import_module(f"async_tnt{name}") for name in PACKAGES)
    for name, advice in advice_of(package).items()
]


@pytest.mark.parametrize(("package", "name", "advice"), REMOVED)
def test_a_removed_name_says_what_to_write_instead(package, name, advice):
    message = f"{package.__name__} has no '{name}' any more: {advice}"
    with pytest.raises(AttributeError, match=f"^{re.escape(message)}$"):
        getattr(package, name)
    assert not hasattr(package, name)
    assert name not in dir(package)
    assert name not in getattr(package, "__all__", [])


@pytest.mark.parametrize(("package", "name", "advice"), REMOVED)
def test_it_is_where_the_error_says(package, name, advice):
    """The name is in a module, or is another public name of the same package."""
    modules = re.findall(r"`(async_tnt\.[\w.]+)`", advice)
    names = re.findall(r"`(\w+)(?:\(.*?\)|\.\w+\(.*?\))?`", advice)
    assert modules or names
    for module in modules:
        assert name == "config" or hasattr(importlib.import_module(module), name)
    for public in names:
        assert public in package.__all__


def test_another_name_is_an_ordinary_mistake():
    for package in {param.values[0] for param in REMOVED}:
        message = f"^module '{package.__name__}' has no attribute 'nam'$"
        with pytest.raises(AttributeError, match=message):
            package.nam  # noqa: B018
