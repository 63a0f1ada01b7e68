"""What all tests share: settings, the folder of data, and the program as a function."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent

os.environ.setdefault("OMP_NUM_THREADS", "1")
# No deadline: how long an example takes depends on what else the machine does.
# `HYPOTHESIS_PROFILE=deep pytest` tries many more random streams.
settings.register_profile(
    "ci", deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("few", settings.get_profile("ci"), max_examples=20)
settings.register_profile("deep", settings.get_profile("ci"), max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

# A shell's background job ignores SIGINT. So would the programs that tests start and interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if os.name != "nt" and signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:  # under nohup
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


COMPILE_THE_LAST_FIRST = """
from async_tnt.kernels.entry_points import ENTRY_POINTS, prepare
from async_tnt.kernels.ship import import_all

import_all()
prepare(*reversed(ENTRY_POINTS))
"""


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile all kernels once, before the workers of pytest start.

    Two processes begin at both ends of the list, and load what the other one has compiled.
    """
    is_worker = hasattr(session.config, "workerinput")
    if is_worker or session.config.option.collectonly:
        return
    # imported here, as OMP_NUM_THREADS must be set first
    from async_tnt.kernels.entry_points import ENTRY_POINTS
    from async_tnt.kernels.ship import import_all

    import_all()
    other = None
    for entry in ENTRY_POINTS:
        if other is None and not entry.is_quick:
            other = subprocess.Popen([sys.executable, "-c", COMPILE_THE_LAST_FIRST])
        entry.prepare()
    assert other is None or other.wait() == 0, "see above why kernels were not compiled"


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    """Compile the kernels before the first test.

    Otherwise a program that a test starts would say on stderr that it compiles them.
    """
    from async_tnt import warmup  # imported here, as OMP_NUM_THREADS must be set first

    warmup()


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder with `nmnist/` and `mnist/`. Without it, the test is skipped."""
    folder = Path(os.environ.get("TNT_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "nmnist" / "Test").is_dir():
        pytest.skip(f"no recordings in {folder} (TNT_DATA names another folder)")
    return folder


@pytest.fixture
def program(capsys):
    """A function that runs `async-tnt` with words, and returns exit code, stdout and stderr."""
    from async_tnt.cli import main  # imported here, as OMP_NUM_THREADS must be set first

    def run(*words):
        capsys.readouterr()
        code = main([str(word) for word in words])
        return code, *capsys.readouterr()

    return run
