"""Compiled code in the package: it is used if it fits, and never otherwise."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from async_tnt.kernels import ship, shipped, target
from async_tnt.kernels.target import GENERIC, KINDS, chosen_kind, settings_for

MAKE = """
import sys
from pathlib import Path
from numba.core.serialize import dumps
from async_tnt.kernels.decisions.classify import softmax
from async_tnt.kernels.shipped import write_file
softmax.prepare()
write_file(Path(sys.argv[1]), {softmax.name: dumps(softmax.result._reduce())})
"""
USE = """
import sys
from pathlib import Path
import numpy as np
from numba.core import event
from async_tnt.kernels import shipped
shipped.FOLDER = Path(sys.argv[1])
from async_tnt.kernels.decisions.classify import softmax
compilations = event.RecordingListener()
event.register("numba:compile", compilations)
softmax.prepare()
logits, probabilities = np.array([1, 3, 2], np.float32), np.empty(3)
best = softmax.call(logits, probabilities)
print(bool(compilations.buffer), best, probabilities.tolist(), shipped.shipped().why_not, sep="|")
"""


def run(code, *words, **environment):
    environment = os.environ | environment
    for name, value in list(environment.items()):
        if value is None:
            del environment[name]
    command = [sys.executable, "-c", code, *map(str, words)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with compiled code of one entry point, for this machine."""
    if chosen_kind() is None:
        pytest.skip("this processor is of no kind that a package brings code for")
    folder = tmp_path_factory.mktemp("compiled")
    # Numba cannot write again what it has loaded, from its cache or from the package.
    settings = {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("cache")), "NUMBA_OPT": "3"}
    run(MAKE, folder / f"{chosen_kind()}.code", NUMBA_BOUNDSCHECK=None, **settings)
    return folder


@pytest.fixture
def use(folder, tmp_path):
    """A function: whether a new process compiled, what it computed, and why, in an empty cache."""

    def used(where=folder, **environment):
        settings = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_BOUNDSCHECK": None}
        done = run(USE, where, **settings | environment)
        compiled, best, probabilities, why_not = done.stdout.strip("\n").split("|")
        assert done.stderr == ""
        return compiled == "True", (best, probabilities), why_not

    return used


def test_code_that_fits_is_used_and_gives_the_same_bits(use, tmp_path):
    compiled, answer, why_not = use()
    assert (compiled, why_not) == (False, "")
    compiled, same, why_not = use(tmp_path / "nothing")
    assert (compiled, same) == (True, answer) and "brings no code" in why_not


INGREDIENTS = {
    "kernels": ("shipped.SOURCES", "0123"),
    "numba": ("numba.__version__", "0.1"),
    "llvmlite": ("llvmlite.__version__", "0.1"),
    "python": ("sysconfig.get_config_var", lambda name: "cpython-39"),
    "system": ("platform.machine", lambda: "PDP-11"),
    "processor": ("shipped.chosen_kind", lambda: "nehalem"),
    "numbers in a register": ("shipped.LANES", 4),
}
"""Name in the key -> what it is made of, and another value of that."""


@pytest.mark.parametrize("name", INGREDIENTS)
def test_the_key_names_all_that_code_depends_on(name, monkeypatch):
    before = shipped.own_key()
    assert before.keys() == INGREDIENTS.keys() and "" not in before.values()
    path, other = INGREDIENTS[name]
    path = path.replace("shipped.", "async_tnt.kernels.shipped.")
    monkeypatch.setattr(path, other)
    after = shipped.own_key()
    assert [key for key in before if before[key] != after[key]] == [name]


def test_code_of_one_system_is_not_that_of_another(monkeypatch):
    monkeypatch.setattr(sys, "platform", "plan9")
    assert shipped.own_key()["system"].startswith("plan9 ")


@pytest.mark.parametrize("name", INGREDIENTS)
def test_code_for_something_else_is_not_used(name, folder, tmp_path):
    found = shipped.read_file(made_for_another(name, folder, tmp_path))
    assert not found.code
    assert "other" in found.why_not or found.why_not == "the kernels have been changed"


def made_for_another(name, folder, where):
    """A copy of the file with another value in its key."""
    file = folder / f"{chosen_kind()}.code"
    head, _, body = file.read_bytes().partition(b"\n")
    about = json.loads(head)
    about["key"][name] = "other"
    (where / file.name).write_bytes(json.dumps(about).encode() + b"\n" + body)
    return where / file.name


@pytest.mark.parametrize(
    "damage",
    [
        lambda whole: whole[:-1],
        lambda whole: whole[:-100] + bytes(100),
        lambda whole: whole[: len(whole) // 2],
        lambda whole: b"",
        lambda whole: b"{}\n" + whole,
        lambda whole: b"[1]\n" + whole,
        lambda whole: b'{"key": 1, "sha256": "", "code": {}}\n' + whole,
        lambda whole: b"\xff\xfe\n" + whole,
    ],
)
def test_a_damaged_or_foreign_file_is_not_used(damage, folder, tmp_path):
    file = folder / f"{chosen_kind()}.code"
    (tmp_path / file.name).write_bytes(damage(file.read_bytes()))
    found = shipped.read_file(tmp_path / file.name)
    assert not found.code and found.why_not == f"{file.name} is damaged"


def test_where_a_file_is_not_used_the_kernel_is_compiled(use, folder, tmp_path):
    """A file for something else, then one that was cut short."""
    file = made_for_another("kernels", folder, tmp_path)
    compiled, (best, _), why_not = use(tmp_path)
    assert (compiled, best, why_not) == (True, "1", "the kernels have been changed")
    file.write_bytes((folder / file.name).read_bytes()[:-1])
    compiled, (best, _), why_not = use(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "other cache"))
    assert (compiled, best, why_not) == (True, "1", f"{file.name} is damaged")


def test_code_that_cannot_be_read_is_compiled(use, tmp_path):
    """Its checksum is right, but it is no code."""
    name = "decisions.classify.softmax"
    shipped.write_file(tmp_path / f"{chosen_kind()}.code", {name: b"not what Numba writes"})
    compiled, (best, _), _ = use(tmp_path)
    assert (compiled, best) == (True, "1")


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"NUMBA_BOUNDSCHECK": "1"}, "NUMBA_BOUNDSCHECK is set"),
        ({"NUMBA_OPT": "1"}, "NUMBA_OPT is set"),
        ({"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": "+sse4.2"}, "this processor"),
    ],
)
def test_where_numba_compiles_otherwise_no_code_is_used(settings, reason, use):
    compiled, (best, _), why_not = use(**settings)
    assert (compiled, best) == (True, "1") and reason in why_not


def test_code_without_checks_is_not_loaded_where_indices_are_checked(use, tmp_path):
    """Both are kept in one cache."""
    nowhere = tmp_path / "nothing"
    assert use(nowhere)[0]
    assert use(nowhere, NUMBA_BOUNDSCHECK="1")[0]


@pytest.mark.parametrize(
    "name", ["NUMBA_BOUNDSCHECK", "NUMBA_DEBUGINFO", "NUMBA_ENABLE_AVX", "NUMBA_OPT"]
)
def test_every_variable_that_changes_code_is_known(name, monkeypatch):
    for known in target.OTHERWISE:
        monkeypatch.delenv(known, raising=False)
    assert target.other_settings() == []
    monkeypatch.setenv(name, "1")
    assert target.other_settings() == [name]


V3 = {"avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt"}
V4 = V3 | {"avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl"}
"""The instructions of LLVM's kinds, as the System V ABI for x86-64 lists them."""


def test_a_processor_is_of_the_best_kind_all_of_whose_instructions_it_has(monkeypatch):
    has = set()
    monkeypatch.setattr(target, "is_x86", lambda: True)
    monkeypatch.setattr(
        target.llvm, "get_host_cpu_features", lambda: {name: name in has for name in V4}
    )
    kinds = {"x86-64-v4": V4, "x86-64-v3": V3, None: set()}
    for kind, needs in kinds.items():
        has = needs | {"sse4.2"}
        assert target.best_kind() == kind
        for missing in needs:
            has = needs - {missing}
            assert target.best_kind() == (None if missing in V3 else "x86-64-v3")
    monkeypatch.setattr(target, "is_x86", lambda: False)
    assert target.best_kind() == GENERIC


def test_whether_code_is_used_is_told_in_words(monkeypatch):
    monkeypatch.setattr(shipped, "chosen_kind", lambda: "x86-64-v3")
    monkeypatch.setattr(shipped, "shipped", lambda: shipped.Shipped({"a": memoryview(b"a")}))
    assert shipped.state_of_kernels() == "compiled code of the package, for x86-64-v3 processors"
    monkeypatch.setattr(shipped, "shipped", lambda: shipped.Shipped(why_not="NUMBA_OPT is set"))
    assert shipped.state_of_kernels() == "compiled on this machine: NUMBA_OPT is set"


@pytest.mark.parametrize(
    ("words", "best", "is_x86", "kinds"),
    [
        (["new"], "x86-64-v3", True, ["x86-64-v3"]),
        (["new"], None, True, []),
        (["new", "all"], "x86-64-v3", True, ["x86-64-v4", "x86-64-v3"]),
        (["new", "all"], GENERIC, False, [GENERIC]),
        ([], "x86-64-v3", True, None),
        (["new", "some"], "x86-64-v3", True, None),
        (["new", "all", "all"], "x86-64-v3", True, None),
    ],
)
def test_the_command_that_makes_the_files(
    words, best, is_x86, kinds, monkeypatch, tmp_path, capsys
):
    """Its usage is told if it is called in another way."""
    made = []

    def made_here(kinds, folder):
        made.append((kinds, folder))
        (tmp_path / "made.code").write_bytes(bytes(2_345_678))
        return [tmp_path / "made.code"] * len(kinds)

    monkeypatch.setattr(ship, "ship", made_here)
    monkeypatch.setattr(ship, "best_kind", lambda: best)
    monkeypatch.setattr(ship, "is_x86", lambda: is_x86)
    monkeypatch.setattr(sys, "argv", ["ship", *words])
    code = ship.main()
    out, err = capsys.readouterr()
    if kinds is None:
        assert (code, made, out) == (2, [], "") and err.startswith("usage: python -m ")
    else:
        assert (code, made, err) == (0, [(kinds, Path("new"))], "")
        assert out == f"{tmp_path / 'made.code'}: 2.3 MB\n" * len(kinds)


def test_each_kind_is_compiled_by_itself_with_an_empty_cache(monkeypatch, tmp_path):
    """Numba cannot write what it has loaded from a cache, or from a package."""
    calls = []

    def run_instead(command, env, check):
        assert check and list(Path(env["NUMBA_CACHE_DIR"]).iterdir()) == []
        assert env["NUMBA_OPT"] == "3"  # where it is set, code of the package is not loaded
        about = {name: env[name] for name in settings_for("x86-64-v3")}
        calls.append((command[-1], about, env["NUMBA_CACHE_DIR"]))

    monkeypatch.setattr(ship.subprocess, "run", run_instead)
    kinds = ["x86-64-v4", "x86-64-v3"]
    files = [tmp_path / f"{kind}.code" for kind in kinds]
    assert ship.ship(kinds, tmp_path) == files
    expected = [(str(f), settings_for(kind)) for f, kind in zip(files, kinds, strict=True)]
    assert [call[:2] for call in calls] == expected
    assert len({cache for *_, cache in calls}) == 2


@pytest.mark.parametrize("kind", [*KINDS, GENERIC])
def test_the_settings_for_a_kind_choose_it(kind):
    code = "from async_tnt.kernels.target import LANES, chosen_kind; print(chosen_kind(), LANES)"
    done = run(code, **settings_for(kind))
    assert done.stdout == f"{kind} {16 if kind == 'x86-64-v4' else 8}\n"


COMMANDS = """
import shutil, sys
from pathlib import Path
from numba.core import event
from async_tnt.cli import main
from async_tnt.kernels.entry_points import ENTRY_POINTS
from async_tnt.kernels.ship import import_all
from async_tnt.sources import sample_recordings
import_all()
for entry in ENTRY_POINTS:
    entry.prepare()
compilations = event.RecordingListener()
event.register("numba:compile", compilations)
samples = sample_recordings()
dataset = Path(sys.argv[1])
(dataset / "3").mkdir()
shutil.copy(samples[3], dataset / "3")
for words in (
    ["run", "--every-us", "20000"],
    ["run", "--model", "digits-everywhere", str(samples[3])],
    ["run", "--every-events", "100", "--roi", "0,0,30,30", str(samples[3])],
    ["info", str(samples[3])],
    ["mask", str(samples[3]), "--out", str(dataset / "mask.npy")],
    ["evaluate", "digits", str(dataset)],
):
    print(words[0], main(words), file=sys.stderr)
found = [e.data["dispatcher"].py_func for (_, e) in compilations.buffer if e.is_start]
print("\\n", [f"{f.__module__}.{f.__name__}" for f in found])
"""


def test_the_entry_points_are_all_that_commands_call(tmp_path):
    """So a package that brings them all brings enough: no command compiles anything else."""
    done = run(COMMANDS, tmp_path)
    assert done.stdout.splitlines()[-1] == " []", done.stderr
    codes = [line.split() for line in done.stderr.splitlines() if line.endswith((" 0", " 2"))]
    assert [code for _, code in codes] == ["0"] * 6, done.stderr
