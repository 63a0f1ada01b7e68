"""The package is built in layers, and imports point down.

The table in ARCHITECTURE.md lists the layers.
"""

import ast
import re
import tomllib
from pathlib import Path

import async_tnt

ROOT = Path(__file__).parents[2]
TABLE = re.findall(r"^\| (`.*?) \|", (ROOT / "ARCHITECTURE.md").read_text(), re.MULTILINE)
# "async_tnt/cli/", "streaming/windows.py"
LAYERS = [Path(name).stem for row in TABLE for name in re.findall("`(.*?)`", row)]

PACKAGE = Path(async_tnt.__file__).parent
SOURCES = {
    ".".join(("async_tnt", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(
        ".__init__"
    ): path
    for path in PACKAGE.rglob("*.py")
}
del SOURCES["async_tnt"]  # the public names of all layers: nothing inside imports it
del SOURCES["async_tnt.__main__"]  # the program


def layer_of(module):
    return module.split(".")[1]


def imports_of(path, root=PACKAGE.parent):
    """Names of all modules that a file imports, or imports names from.

    Imports inside of functions count, too.
    """
    package = ".".join(path.relative_to(root).parent.parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = (
                f"{package}.{node.module}" if node.level and node.module else node.module or package
            )
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


IMPORTS = {module: set(imports_of(path)) for module, path in SOURCES.items()}


def in_circles(imports):
    """The names that are in a circle, or import one that is.

    imports : name -> the names that it imports.
    """
    left = dict(imports)
    while True:
        ends = {name for name, others in left.items() if not others & left.keys()}
        if not ends:
            return set(left)
        for name in ends:
            del left[name]


def test_imports_point_downwards():
    pairs = [
        (module, other) for module, names in IMPORTS.items() for other in names & SOURCES.keys()
    ]
    helpers = {layer_of(module) for module in SOURCES} - set(LAYERS)  # which the page does not list
    place = {layer: number for number, layer in enumerate(LAYERS)} | dict.fromkeys(
        helpers, len(LAYERS)
    )
    assert not any("async_tnt" in names for names in IMPORTS.values())
    assert [
        (a, b)
        for a, b in pairs
        if layer_of(a) != layer_of(b) and place[layer_of(a)] > place[layer_of(b)]
    ] == []
    assert set(LAYERS) <= {layer_of(module) for module in SOURCES}


def test_sources_know_nothing_of_what_is_done_with_their_events():
    known = {
        layer_of(name)
        for module in SOURCES
        if layer_of(module) == "sources"
        for name in IMPORTS[module] & SOURCES.keys()
    }
    assert known & set(LAYERS) <= {"sources", "volume", "kernels", "base"}


def test_there_is_no_circle():
    plain = {module for module, path in SOURCES.items() if path.name != "__init__.py"}
    assert in_circles({module: IMPORTS[module] & plain for module in plain}) == set()


def test_no_folders_import_each_other():
    """Folders import each other neither directly nor by way of other folders.

    A folder within another folder is a folder of its own.
    """
    folder_of = {
        module: module.rpartition(".")[0]
        for module, path in SOURCES.items()
        if path.name != "__init__.py"
    }
    imports = {folder: set() for folder in folder_of.values()}
    for module, folder in folder_of.items():
        imported = {folder_of[name] for name in IMPORTS[module] & folder_of.keys()}
        imports[folder] |= imported - {folder}
    assert in_circles(imports) == set()


def test_what_is_installed_does_not_know_the_laboratory():
    imports = {name for names in IMPORTS.values() for name in names}
    for folder in (ROOT / "reference", ROOT / "examples"):
        imports |= {name for path in folder.rglob("*.py") for name in imports_of(path, folder)}
    assert len(imports) > 500 and not any(name.split(".")[0] == "experiments" for name in imports)
    built = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"][
        "targets"
    ]["wheel"]
    assert not any("experiments" in package for package in built["packages"])


def test_the_command_line_alone_names_options():
    """Elsewhere an error names a `parameter`, which the program prints as its option."""
    option = re.compile(r"(?<![\w-])--[a-z]")
    strings = {
        module: [
            node.value
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Constant)
        ]
        for module, path in SOURCES.items()
        if layer_of(module) != "cli"
    }
    assert {
        m: text
        for m, texts in strings.items()
        for text in texts
        if isinstance(text, str) and option.search(text)
    } == {}


def test_the_command_line_alone_uses_argparse():
    assert {layer_of(module) for module in SOURCES if "argparse" in IMPORTS[module]} == {"cli"}


def test_messages_tell_how_to_install_extras_that_exist():
    texts = "".join(path.read_text() for path in SOURCES.values())
    extras = re.findall(
        r"""needs_extra\("(\w+)"|async_tnt\[(\w+)\]|\(extra(?:: | `)(\w+)[`)]""", texts
    )
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert len(extras) > 20 and {name for names in extras for name in names if name} <= set(known)


def test_the_pages_name_the_release():
    """The newest entry of the changelog, and what a citation names."""
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search("^## (.+)$", changes, re.MULTILINE)[1] == async_tnt.__version__
    assert f"\nversion: {async_tnt.__version__}\n" in citation
