"""The package's version, its names that are imported when first used, and the machine's cores.

This module imports nothing, so that programs start at once.
"""

__version__ = "0.4.0"

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def lazy_names(
    package: "dict[str, Any]", modules: "dict[str, str]", instead: "dict[str, str] | None" = None
) -> "tuple[Callable, Callable]":
    """The functions `__getattr__` and `__dir__` of a package, which import names when first used.

        __getattr__, __dir__ = lazy_names(globals(), {"module": "Name other_name", ...})

    Type checkers do not know these names. For them the package imports the same names
    `if TYPE_CHECKING`, and lists them in `__all__`.

    Parameters
    ----------
    package : the package's `globals()`.
    modules : submodule -> its public names, separated by spaces.
    instead : public name of the release before -> text to write instead of it. The old name raises
        an AttributeError that says so.
    """
    own_name = package["__name__"]
    module_of = {name: module for module, names in modules.items() for name in names.split()}
    advice = instead or {}

    def get(name: str) -> "Any":
        import importlib

        if name in advice:
            raise AttributeError(f"{own_name} has no {name!r} any more: {advice[name]}")

        # a name that is not in the table may be a submodule
        module = module_of.get(name, name)
        try:
            value: Any = importlib.import_module(f"{own_name}.{module}")
        except ModuleNotFoundError as error:
            if error.name != f"{own_name}.{module}":  # another package is missing
                raise
            raise AttributeError(f"module {own_name!r} has no attribute {name!r}") from None
        if name in module_of:
            value = getattr(value, name)
        package[name] = value
        return value

    def names() -> "list[str]":
        return sorted({*package, *module_of})

    return get, names


def available_cores() -> int:
    """The number of cores that this process may use."""
    import os

    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
