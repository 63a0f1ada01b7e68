"""The package is built in floors: a module imports modules of its own room and of lower floors, and nothing else."""

import ast
from pathlib import Path

import async_tnt

# from the ground up; ARCHITECTURE.md says what each room is for
FLOORS = [
    {"kernels", "checks", "decision", "files", "lazy_names", "process", "progress", "version"},
    {"checked_tensors", "config", "event_forms"},
    {"events", "networks", "triggers", "volume_state"},
    {"compile_ahead", "replay_buffer", "representations", "sources"},
    {"volume"},
    {"window_classifier", "windows"},
    {"processor"},
    {"checking", "engines", "streams"},
    {"archive", "views"},
    {"simulation"},
    {"resynthesis"},
    {"training"},
    {"cli"},
]
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}

PACKAGE = Path(async_tnt.__file__).parent
SOURCES = {
    ".".join(("async_tnt", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
}
del SOURCES["async_tnt"]  # the public names of all floors: nothing inside imports it


def room_of(module):
    return module.split(".")[1]


def imports_of(path):
    """Names of all modules that a file imports, or imports names from, also inside its functions."""
    package = ".".join(("async_tnt", *path.relative_to(PACKAGE).parent.parts))
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = f"{package}.{node.module}" if node.level and node.module else node.module or package
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


IMPORTS = {module: set(imports_of(path)) for module, path in SOURCES.items()}


def test_imports_point_downwards():
    pairs = [(module, other) for module, names in IMPORTS.items() for other in names & SOURCES.keys()]
    outwards = [pair for pair in pairs if room_of(pair[0]) != room_of(pair[1])]
    assert not any("async_tnt" in names for names in IMPORTS.values())
    assert [pair for pair in outwards if FLOOR[room_of(pair[0])] <= FLOOR[room_of(pair[1])]] == []


def test_there_is_no_circle():
    plain = {module for module, path in SOURCES.items() if path.name != "__init__.py"}
    left = {module: IMPORTS[module] & plain for module in plain}
    while ends := {module for module, others in left.items() if not others & left.keys()}:
        left = {module: others for module, others in left.items() if module not in ends}
    assert left == {}


def test_the_command_line_alone_uses_argparse():
    assert {room_of(module) for module in SOURCES if "argparse" in IMPORTS[module]} == {"cli"}
