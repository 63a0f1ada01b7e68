"""The recipes of ARCHITECTURE.md name the files in which an existing one of a kind is found."""

import functools
import io
import itertools
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")

RECIPE = re.compile(
    r"^(\*\*An? [^*]+\*\*, such as `\w+`)(.*?)(?=^\*\*|\Z)", re.MULTILINE | re.DOTALL
)
RECIPES = dict(RECIPE.findall(PAGE))
"""Title of a recipe, with its example -> its text."""

FOUND_BY = {
    "gelu": r"(_|write_)?gelu(_tanh)?|\"gelu\"",
    "every_events": r"every_events|\"(--)?every[_-]events\"|EVERY_EVENTS|BY_EVENTS",
    "count_time": r"\"count_time\"|COMBINE_NEWEST|count_timestamp_image",
    "aedat": r"Aedat[23]Source",
    "line": r"\"line\"|MODE_LINE|displace_line",
    "bench": r"\"bench\"",
}
"""Example -> the names and the strings, in their quotes, by which it is found in the code."""

USERS = {
    "every_events": {
        "checking/equality.py": "checks streams with every trigger",
        "checking/sliding.py": "checks a decision after every event",
        "streaming/compile_ahead.py": "makes streams with every kind of trigger",
        "cli/bench.py": "measures a decision after every event",
        "sources/queues/keep_up.py": "makes decisions rarer",
        "views/figure_objects.py": "decides before each panel",
    },
    "line": {
        "checking/equality.py": "checks streams with every landmark",
        "cli/plot.py": "explains what is drawn",
    },
}
"""Example -> files that use it as any program could, and why they do."""

ALTERNATIVES = {
    "gelu": {
        "networks/layers/linear.py",
        "networks/layers/pooling.py",
        "networks/layers/joining.py",
        "tests/networks/test_operations.py",
        "tests/networks/random_networks.py",
        "tests/networks/test_incremental_laws.py",
        "tests/networks/test_random_networks.py",
        "tests/networks/test_from_onnx.py",
    },
    "aedat": {"sources/files/library_readers.py", "sources/files/worker_source.py"},
    "every_events": {"kernels/decisions/classify.py", "kernels/spiking/decide.py"},
}
"""Example -> files that the recipe names for other ones of its kind."""


@functools.cache
def code_of(path):
    """The names, and the strings in their quotes, of a file without its comments and docstrings."""
    tokens = list(tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline))
    words = set()
    depth = 0
    for before, token in itertools.pairwise(tokens):
        if token.type == tokenize.OP:
            depth += (token.string in "([{") - (token.string in ")]}")
        starts_line = before.type in (tokenize.NEWLINE, tokenize.INDENT, tokenize.NL)
        is_docstring = token.type == tokenize.STRING and starts_line and depth == 0
        if token.type in (tokenize.NAME, tokenize.STRING) and not is_docstring:
            words.add(token.string)
    return words


def named_in(recipe):
    """The Python files of the package and of the reference that a recipe names."""
    names = set(re.findall(r"`([\w/]+\.py)`", recipe))
    return {name for name in names if not name.startswith("tests/")}


def found(example):
    """Files of the package and of the reference that have its name or in whose code it is."""
    pattern = re.compile(FOUND_BY[example])
    names = {path: path.relative_to(ROOT / "async_tnt") for path in ROOT.glob("async_tnt/**/*.py")}
    names |= {path: path.relative_to(ROOT) for path in ROOT.glob("reference/**/*.py")}
    return {
        name.as_posix()
        for path, name in names.items()
        if path.stem == example or any(map(pattern.fullmatch, code_of(path)))
    }


@pytest.mark.parametrize("title", RECIPES, ids=[title.split("`")[1] for title in RECIPES])
def test_a_recipe_names_the_files_that_an_existing_one_touches(title):
    example = title.split("`")[1]
    named = named_in(RECIPES[title])
    others = ALTERNATIVES.get(example, set())
    for name in re.findall(r"`((?:tests|docs)/[\w/]+\.\w+)`", RECIPES[title]):
        text = (ROOT / name).read_text(encoding="utf-8").lower()
        assert name in others or example in text, name
    there = found(example) - USERS.get(example, {}).keys()
    assert named - others == there


def test_there_is_a_recipe_for_each_kind():
    kinds = [re.search(r"\*\*An? (.*?)\*\*", title)[1] for title in RECIPES]
    assert {"layer", "trigger", "representation", "file format", "command"} <= set(kinds)
