"""What is known of the package and the machine before anything is imported: version, cores, and
names that are imported when first used, so that programs start at once."""

__version__ = "0.3.0"

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def lazy_names(package: "dict[str, Any]", modules: "dict[str, str]") -> "tuple[Callable, Callable]":
    """`__getattr__` and `__dir__` of a package.

        __getattr__, __dir__ = lazy_names(globals(), {"module": "Name other_name", ...})

    Type checkers do not see through it: for them the package imports the same names `if
    TYPE_CHECKING`, and lists them in `__all__`.

    Parameters
    ----------
    package : its `globals()`.
    modules : submodule -> its public names, separated by spaces.
    """
    module_of = {name: module for module, names in modules.items() for name in names.split()}
    own_name = package["__name__"]

    def get(name: str) -> "Any":
        import importlib

        module = module_of.get(name, name)  # otherwise a submodule
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

    return get, lambda: sorted({*package, *module_of})


def available_cores() -> int:
    """Cores this process may use."""
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
