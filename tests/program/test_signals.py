"""A signal ends the program in one line with 128 and its number, from its first line of code on."""

import os
import signal
import subprocess
import sys

import pytest

from async_tnt.sources.files.recording import sample_recordings

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
SAMPLE = str(sample_recordings()[3])

# Python runs it first of all, where it is on PYTHONPATH. In a callback of C code an exception would not get far.
SITECUSTOMIZE = """
import ctypes, os, sys
point, number, in_callback = os.environ["POINT"], int(os.environ["NUMBER"]), os.environ["IN_CALLBACK"] == "1"

class Finder:
    def find_spec(self, name, path, target=None):
        if name == point:
            sys.meta_path.remove(self)
            if in_callback:
                ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), number))()
            else:
                os.kill(os.getpid(), number)

sys.meta_path.insert(0, Finder())
"""


def interrupted(folder, words, *, point, number, in_callback=False, ignored=None, stderr=subprocess.PIPE):
    """The program, which gets a signal when it begins to import a module."""
    (folder / "sitecustomize.py").write_text(SITECUSTOMIZE)
    paths = os.pathsep.join([str(folder), *filter(None, sys.path)])
    return subprocess.run(
        [sys.executable, "-m", "async_tnt.cli", *words],
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
        cwd=folder,
        env=os.environ
        | {
            "PYTHONPATH": paths,
            "POINT": point,
            "NUMBER": str(int(number)),
            "IN_CALLBACK": str(int(in_callback)),
        },
        preexec_fn=None if ignored is None else lambda: signal.signal(ignored, signal.SIG_IGN),
    )


@pytest.mark.parametrize(
    "number, line", [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated"), (signal.SIGHUP, "terminated")]
)
@pytest.mark.parametrize("in_callback", [False, True])
@pytest.mark.parametrize("point", ["async_tnt.cli.program", "numpy.linalg", "async_tnt.cli.run"])
def test_a_signal_while_the_program_starts(number, line, in_callback, point, tmp_path):
    done = interrupted(tmp_path, ["run", SAMPLE], point=point, number=number, in_callback=in_callback)
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", f"async-tnt: {line}\n")


@pytest.mark.parametrize("in_callback", [False, True])
def test_a_signal_while_a_command_imports_what_it_needs(in_callback, tmp_path):
    pytest.importorskip("matplotlib")
    done = interrupted(
        tmp_path, ["plot", SAMPLE, "--out", "a.png"], point="matplotlib.colors", number=2, in_callback=in_callback
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "async-tnt: interrupted\n")


def test_a_signal_while_kernels_come_from_the_cache(tmp_path):
    """LLVM calls back, and does not expect an exception."""
    code = (
        "import os, sys; from numba.core.codegen import JITCodeLibrary\n"
        "answer = JITCodeLibrary._object_getbuffer_hook\n"
        "def answer_late(library): os.kill(os.getpid(), 2); return answer(library)\n"
        "JITCodeLibrary._object_getbuffer_hook = answer_late\n"
        "from async_tnt.cli import main; sys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", code, "run", SAMPLE], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "async-tnt: interrupted\n")


@pytest.mark.parametrize("ignored", [signal.SIGINT, signal.SIGHUP])
@pytest.mark.parametrize("point", ["numpy.linalg", "matplotlib.colors"])
def test_a_signal_that_is_ignored_stays_so(ignored, point, tmp_path):
    """A shell's background job ignores Ctrl-C, and nohup SIGHUP."""
    pytest.importorskip("matplotlib")
    words = ["plot", SAMPLE, "--out", "a.png"]
    done = interrupted(tmp_path, words, point=point, number=ignored, ignored=ignored)
    assert done.returncode == 0 and done.stderr == "" and "a.png" in done.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_workers_are_spawned(number, tmp_path):
    """A process that has been spawned waits for what it has to do; were that never sent, it would complain."""
    (tmp_path / "3").mkdir()
    for name in ("a.bin", "b.bin"):
        (tmp_path / "3" / name).symlink_to(SAMPLE)
    code = (
        "import multiprocessing.util as util, os, sys\n"
        "spawn = util.spawnv_passfds\n"
        "def spawned(path, words, handed_over):\n"
        "    made = spawn(path, words, handed_over)\n"
        f"    if 'spawn_main' in str(words): os.kill(os.getpid(), {int(number)})\n"
        "    return made\n"
        "util.spawnv_passfds = spawned\n"
        "from async_tnt.cli import main; sys.exit(main())"
    )
    words = ["evaluate", "digits", str(tmp_path), "--workers", "2"]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert done.returncode == 128 + number and done.stdout == ""
    assert done.stderr == "async-tnt: interrupted: 0 of 2 recordings are done; nothing is kept without --out\n"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize("stderr", ["2>&-", "2>/dev/full"])
@pytest.mark.parametrize(
    "words, code",
    [
        (["run", "--json", SAMPLE], 0),
        (["run", "nowhere.bin"], 2),
        (["run", SAMPLE, "--every-us", "0"], 2),
        (["evaluate", "digits", "nowhere", "--workers", "2"], 2),
        (["run", "--start-us", "200000", "--json", SAMPLE], 0),  # says on stderr what was dropped
    ],
)
def test_where_nobody_can_be_told_the_exit_code_is_the_same(words, code, stderr):
    program = f'"{sys.executable}" -m async_tnt.cli {" ".join(words)}'
    done = subprocess.run(f"{program} {stderr}", shell=True, stdout=subprocess.PIPE, text=True)
    assert done.returncode == code and all(line.startswith("{") for line in done.stdout.splitlines())
    assert bool(done.stdout) == (code == 0)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize("point", ["numpy.linalg", "matplotlib.colors"])
def test_where_nobody_can_be_told_a_signal_ends_it_all_the_same(point, tmp_path):
    pytest.importorskip("matplotlib")
    with open("/dev/full", "w") as full:
        words = ["plot", SAMPLE, "--out", "a.png"]
        assert interrupted(tmp_path, words, point=point, number=signal.SIGINT, stderr=full).returncode == 130
