"""The target of a view: a file, a running viewer, or a viewer that is started."""

from __future__ import annotations

import contextlib
import ctypes
import inspect
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from async_tnt.checks import needs_extra
from async_tnt.files import Replacement, check_writable

SUFFIXES = (".rrd",)
DEFAULT_PORT = 9876  # where a Rerun viewer listens
VIEWER_MEMORY = "25%"
PATIENCE_S = 5.0  # for a viewer that does not respond


def import_rerun() -> Any:
    """The module `rerun`.

    Raises
    ------
    ImportError : it is not installed, or so old that it lacks what is used here.
    """
    with needs_extra("view", "views need rerun-sdk 0.23 or newer"):
        import rerun
        import rerun.blueprint

        if not hasattr(rerun, "SeriesLines"):
            raise ImportError(f"got {getattr(rerun, '__version__', 'an unknown version')}")
    return rerun


class FileSink:
    """A .rrd file. Until it is closed it is NAME.rrd.part; then it gets its name, replacing an existing file."""

    def __init__(self, path: Path) -> None:
        check_writable(path, SUFFIXES)
        self._path = path

    def open(self, stream: Any) -> None:
        self._file = Replacement(self._path)
        try:
            with _as_os_error(self._path):
                stream.save(self._file.part)
        except OSError:
            self._file.discard()
            raise

    def close(self, stream: Any, keep: bool) -> None:
        """Complete the file; without `keep`, nothing is left behind.

        If it cannot be completed, for instance because the disk is full, NAME.rrd.part is kept.
        """
        try:
            self.check(stream)
            with _as_os_error(self._path):
                stream.disconnect()
        except OSError as error:
            if not keep:
                raise
            raise OSError(f"{error}; what was written before is in {self._file.part}") from None
        finally:
            if not keep:
                self._file.discard()
        if keep:
            self._file.complete()

    def check(self, stream: Any) -> None:
        """Wait until all is written that was logged.

        Raises
        ------
        OSError : it could not be.
        """
        with _as_os_error(self._path):
            _flush(stream)


class ViewerSink:
    """A running viewer, on this machine or another.

    Parameters
    ----------
    url : such as rerun+http://127.0.0.1:9876/proxy.

    Raises
    ------
    ValueError : no such URL.
    OSError : no viewer listens there.
    """

    _gone = False  # set by `check`

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        try:
            host, port = parts.hostname, parts.port or DEFAULT_PORT
        except ValueError:
            host, port = None, 0
        if parts.scheme not in ("rerun", "rerun+http", "rerun+https") or not host or parts.path != "/proxy":
            raise ValueError(f"--connect expects rerun+http://HOST:{DEFAULT_PORT}/proxy, got {url}")
        if not _listens(host, port):  # the SDK would wait without a message
            raise OSError(f"{url}: no Rerun viewer listens there; `rerun` starts one, or give --out FILE.rrd")
        self._url = url

    def open(self, stream: Any) -> None:
        with _as_os_error(self._url):
            stream.connect_grpc(self._url)

    def close(self, stream: Any, keep: bool) -> None:
        if not self._gone:  # else `check` raised already and would wait again
            self.check(stream)
            stream.disconnect()

    def check(self, stream: Any) -> None:
        """Wait until the viewer has all that was logged.

        Raises
        ------
        OSError : it was closed, or does not respond.
        """
        try:
            with _as_os_error(f"{self._url}: the Rerun viewer was closed or does not respond"):
                _flush(stream)
        except OSError:
            self._gone = True
            _never_free(stream)
            raise


class SpawnedViewer(ViewerSink):
    """Rerun's viewer, started as a process that outlives this program.

    Raises
    ------
    OSError : there is no display.
    """

    def __init__(self) -> None:
        if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise OSError(
                "no display to open the Rerun viewer on: give --out FILE.rrd, or --connect to a viewer elsewhere"
            )
        self._url = f"rerun+http://127.0.0.1:{DEFAULT_PORT}/proxy"

    def open(self, stream: Any) -> None:
        with _as_os_error("the Rerun viewer cannot be started"), _programs_of_this_python():
            stream.spawn(connect=False, memory_limit=VIEWER_MEMORY)
        patience_s = time.monotonic() + PATIENCE_S
        while not _listens("127.0.0.1", DEFAULT_PORT):
            if time.monotonic() > patience_s:
                raise OSError(
                    "the Rerun viewer was started but does not listen (is its display there?): give --out FILE.rrd, or "
                    "--connect to a viewer elsewhere"
                )
            time.sleep(0.05)
        super().open(stream)


def sink_of(out: Path | None, connect: str | None) -> FileSink | ViewerSink:
    """A file, the viewer at a URL, or, without either, a viewer that is started."""
    if out is not None and connect is not None:
        raise ValueError("`out` writes a file and `connect` goes to a viewer: give one of them")
    if out is not None:
        return FileSink(out)
    return SpawnedViewer() if connect is None else ViewerSink(connect)


def _listens(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=PATIENCE_S).close()
    except OSError:
        return False
    return True


@contextlib.contextmanager
def _programs_of_this_python() -> Iterator[None]:
    """Find the viewer that was installed with the SDK, even if its folder is not in PATH."""
    before = os.environ.get("PATH")
    os.environ["PATH"] = os.pathsep.join((*([before] if before else []), str(Path(sys.executable).parent)))
    try:
        yield
    finally:
        if before is None:
            del os.environ["PATH"]
        else:
            os.environ["PATH"] = before


@contextlib.contextmanager
def _as_os_error(what: object) -> Iterator[None]:
    """Turn an error of the SDK (a full disk, a viewer that was closed) into an OSError of one line."""
    try:
        yield
    except RuntimeError as error:
        raise OSError(f"{what}: {' '.join(str(error).split())}") from None


def _never_free(stream: Any) -> None:
    """Keep a stream whose viewer hangs or whose network is down.

    When a stream is freed, and for all streams when the program ends, the SDK waits until all is sent: here forever.
    This prevents both; other Rerun recordings of the same program must then be flushed by their owners.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(stream))
    import_rerun().unregister_shutdown()


def _flush(stream: Any) -> None:
    if "timeout_sec" in inspect.signature(stream.flush).parameters:
        stream.flush(timeout_sec=PATIENCE_S)
    else:  # before rerun 0.26 or so a sink had its own patience
        stream.flush()
