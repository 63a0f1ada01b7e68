"""The rooms of the package stand one above the other, and imports point only downwards."""

import ast
from pathlib import Path

import async_tnt

# A room imports rooms before it. ARCHITECTURE.md says what each is for.
ROOMS = """
kernels lazy_names checks files signals progress checked_tensors decision config event_forms events representations
volume_state deferred_landmark volume windows triggers networks processor compile_ahead engines streams sources
checking archive simulation training views cli
""".split()

PACKAGE = Path(async_tnt.__file__).parent


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else "async_tnt"


def modules() -> dict[str, ast.Module]:
    names = {path: ".".join(("async_tnt", *path.relative_to(PACKAGE).with_suffix("").parts)) for path in paths()}
    return {name.removesuffix(".__init__"): ast.parse(path.read_text()) for path, name in names.items()}


def paths():
    return [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


def imported(name: str, module: ast.Module, known) -> set[str]:
    """Modules of the package that one imports, anywhere in it."""
    found = set()
    for node in ast.walk(module):
        if isinstance(node, ast.ImportFrom):
            base = name.rpartition(".")[0] + ("." + node.module if node.module else "") if node.level else node.module
            parts = {f"{base}.{alias.name}" for alias in node.names} & set(known)
            found |= parts or ({base} & set(known))
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & set(known)
    return found


def test_every_import_points_downwards():
    known = modules()
    wrong = [
        f"{name} imports {other}"
        for name, module in known.items()
        for other in imported(name, module, known)
        if ROOMS.index(room_of(other)) > ROOMS.index(room_of(name))
    ]
    assert wrong == []


def test_no_module_imports_itself_by_way_of_others():
    known = modules()
    arrows = {name: imported(name, module, known) for name, module in known.items() if module_is_plain(name)}
    while removable := [name for name, others in arrows.items() if not others & arrows.keys()]:
        for name in removable:
            del arrows[name]
    assert sorted(arrows) == []


def module_is_plain(name: str) -> bool:
    return not (PACKAGE.parent / name.replace(".", "/")).is_dir()  # an __init__ names what its modules hold


def test_argparse_is_imported_by_the_command_line_alone():
    users = {room_of(name) for name, module in modules().items() if "argparse" in plain_imports(module)}
    assert users == {"cli"}


def plain_imports(module: ast.Module) -> set[str]:
    names = {alias.name for node in ast.walk(module) if isinstance(node, ast.Import) for alias in node.names}
    return names | {node.module or "" for node in ast.walk(module) if isinstance(node, ast.ImportFrom)}


def test_the_kernels_and_the_reference_import_nothing_of_the_package():
    import tnt_reference

    for folder in (PACKAGE / "kernels", Path(tnt_reference.__file__).parent):
        for path in folder.glob("*.py"):
            source = path.read_text()
            assert "from .." not in source and "import async_tnt" not in source and "from async_tnt" not in source
