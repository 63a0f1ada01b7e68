"""Entry points: the kernels that Python calls, each for one tuple of argument types.

    Python                  EntryPoint.call       compiled code, nothing is checked
    Python, foreign arrays  EntryPoint.checked    Numba looks at each argument first (100 to 150 ns)
    another kernel          the same name         a call of the code that is there, see `_call_of`

An entry point is compiled once, or loaded: from the package (`shipped`), or from Numba's cache on
disk. All other functions in `kernels` are parts of entry points, and are compiled into them.
"""

from __future__ import annotations

import contextlib
import gc
import inspect
import logging
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import llvmlite.binding as llvm
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from async_tnt.kernels.jit import cached, compiling
from async_tnt.kernels.shipped import load_shipped, shipped

ENTRY_POINTS: list[EntryPoint] = []
"""All entry points of the modules that have been imported, callees before their callers."""

WARN_AFTER_S = 1.0
"""Seconds of compilation after which a line says what this process is doing."""

_logger = logging.getLogger("async_tnt")


class EntryPoint:
    """A kernel for arguments of fixed types.

    Parameters
    ----------
    function : the kernel.
    types : Numba's types of its arguments.
    calls : the entry points that it calls.
    options : options of Numba's `njit`.

    Attributes
    ----------
    name : the kernel's module, without the package's name, and its own name.
    kernel : Numba's dispatcher.
    call : calls the compiled code. As nothing is checked, a wrong argument may end the process.
    checked : calls the compiled code after Numba has looked at the type of each argument. It raises
        a TypeError if the code is not compiled for one of the types.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        types: tuple[Any, ...],
        calls: tuple[EntryPoint, ...],
        **options: Any,
    ) -> None:
        module = function.__module__.removeprefix("async_tnt.kernels.")
        self.name = f"{module}.{function.__name__}"
        self.types = types
        self.calls = calls
        self.is_ready = False
        self.call: Callable[..., Any] = self._prepare_and_call
        self.checked: Callable[..., Any] = self._prepare_and_check
        self.kernel = cached(function, **options)
        self.kernel._cache = _Cache(self.name, self.kernel._cache)
        self._called_by_kernels = _call_of(self, function)
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__
        ENTRY_POINTS.append(self)

    def __repr__(self) -> str:
        return f"<entry point {self.name}>"

    @property
    def _numba_type_(self) -> Any:
        """What other kernels see under the entry point's name."""
        return cpu_target.typing_context.resolve_value_type(self._called_by_kernels)

    @property
    def symbol(self) -> str:
        """The name under which the code of other kernels finds this one."""
        return f"async_tnt.kernels.{self.name}"

    @property
    def result(self) -> Any:
        """What Numba knows of the compiled code."""
        return self.kernel.overloads[self.types]

    def prepare(self) -> None:
        """Compile the kernel and those that it calls, or load them, unless that has been done."""
        if self.is_ready:
            return
        with compiling:
            if self.is_ready:  # the thread that held the lock before has prepared it
                return
            for called in self.calls:
                called.prepare()
            with _not_collecting():
                self.kernel.compile(self.types)
            self.kernel.disable_compile()
            result = self.result
            address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
            llvm.add_symbol(self.symbol, address)
            self.call = result.entry_point
            self.checked = self.kernel
            self.is_ready = True

    @property
    def is_quick(self) -> bool:
        """Whether `prepare` need not compile: the code is here, in the package or in a cache."""
        with compiling:
            return self.is_ready or self.kernel._cache.find(self.types) is not None

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel with checked types, as `checked` does.

        It takes a tenth of a microsecond more than `checked`.
        """
        return self.checked(*arguments)

    def _prepare_and_call(self, *arguments: Any) -> Any:
        self.prepare()
        return self.call(*arguments)

    def _prepare_and_check(self, *arguments: Any) -> Any:
        self.prepare()
        return self.checked(*arguments)


@contextlib.contextmanager
def _not_collecting() -> Iterator[None]:
    """Run the block without garbage collection, which takes a tenth of the time of a compilation.

    Numba makes no garbage in the block, so nothing is lost by that.
    """
    was_collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_collecting:
            gc.enable()


class _Waiting:
    """How long this process has compiled kernels, and whether it has said so."""

    def __init__(self) -> None:
        self._seconds = 0.0
        self._began_s = 0.0
        self._is_said = False

    def begin(self, has_folder: bool) -> None:
        """Start to measure a compilation, and say why this process waits if it has waited long.

        has_folder : whether there is a folder for the code.
        """
        self._say(has_folder)
        self._began_s = time.perf_counter()

    def end(self) -> None:
        """Add the time of the compilation that ends now."""
        self._seconds += time.perf_counter() - self._began_s

    def _say(self, has_folder: bool) -> None:
        """Say, once, why this process waits, if it has waited long enough."""
        if self._is_said or self._seconds < WARN_AFTER_S:
            return
        self._is_said = True
        how_often = "once on this machine"
        if not has_folder:
            how_often = "in every process, as no cache folder can be written (see NUMBA_CACHE_DIR)"
        _logger.warning(
            "async_tnt: compiling kernels for some seconds, %s (%s)", how_often, shipped().why_not
        )


_waiting = _Waiting()


class _Cache:
    """A kernel's compiled code: in the package, or in Numba's cache on disk.

    Numba calls these methods where a dispatcher compiles.

    Parameters
    ----------
    name : the entry point's name.
    on_disk : Numba's own cache of the kernel.
    """

    def __init__(self, name: str, on_disk: Any) -> None:
        self._name = name
        self._on_disk = on_disk

    @property
    def cache_path(self) -> Any:
        return self._on_disk.cache_path

    def find(self, types: Any) -> Any:
        """The code in the package or on disk; None if there is none."""
        context = cpu_target.target_context
        code = load_shipped(self._name, context)
        return self._on_disk.load_overload(types, context) if code is None else code

    def load_overload(self, types: Any, context: Any) -> Any:
        code = self.find(types)
        if code is None:
            _waiting.begin(self.cache_path is not None)
        return code

    def save_overload(self, types: Any, result: Any) -> None:
        _waiting.end()
        self._on_disk.save_overload(types, result)

    def enable(self) -> None:
        self._on_disk.enable()

    def disable(self) -> None:
        self._on_disk.disable()

    def flush(self) -> None:
        self._on_disk.flush()


def entry_point(
    *types: Any, calls: tuple[EntryPoint, ...] = (), nogil: bool = False
) -> Callable[[Callable[..., Any]], EntryPoint]:
    """Decorate a kernel that Python calls.

    Parameters
    ----------
    types : Numba's types of its arguments.
    calls : the entry points that the kernel calls, itself or through its parts.
    nogil : release Python's lock in each call. It is for work that always takes longer than the
        release.
    """
    return partial(EntryPoint, types=types, calls=calls, nogil=nogil)


def prepare(*entry_points: EntryPoint) -> None:
    """Compile entry points, or load them, so that no later call waits for that."""
    for entry in entry_points:
        entry.prepare()


def _call_of(entry: EntryPoint, function: Callable[..., Any]) -> Any:
    """What Numba compiles where a kernel calls an entry point: a call of the entry point's symbol.

    So the code of the entry point is not compiled once more into each kernel that calls it.
    """

    def call(typingctx: Any, *arguments: Any) -> Any:
        entry.prepare()
        returns = entry.result.signature.return_type

        def codegen(context: Any, builder: Any, signature: Any, values: list) -> Any:
            convention = context.call_conv
            function_type = convention.get_function_type(returns, entry.types)
            callee = cgutils.get_or_insert_function(builder.module, function_type, entry.symbol)
            status, result = convention.call_function(builder, callee, returns, entry.types, values)
            # Where indices are checked, an index may be out of bounds in the callee. Its error is
            # passed on.
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return result

        return returns(*entry.types), codegen

    # Numba reads the number and the names of the arguments from this signature.
    signature = inspect.signature(call)
    context, _ = signature.parameters.values()
    parameters = inspect.signature(function).parameters.values()
    call.__signature__ = signature.replace(parameters=[context, *parameters])  # type: ignore[attr-defined]
    return intrinsic(call)
