"""Outputs that are there already.

Files are replaced and keep their permissions. Everything else stays as it is.
"""

import os
import stat
from functools import partial

import numpy as np
import pytest
from full_disk import TOO_LARGE, full_after
from made import random_events, random_model

from async_tnt.base.files import (
    Replacement,
    check_folder,
    check_writable,
    locked_folder,
    naming,
    open_locked,
    write_text,
)
from async_tnt.cli import main
from async_tnt.evaluation.job import job_of, task_of
from async_tnt.evaluation.processes import run_all
from async_tnt.evaluation.records import evaluate_recording
from async_tnt.evaluation.results import collect as collect_results
from async_tnt.networks.loading import load_model
from async_tnt.sources.files.recording import sample_recordings
from async_tnt.sources.pixels.pixel_masks import save_mask
from async_tnt.sources.pixels.pixels import Pixels

pytestmark = pytest.mark.skipif(os.name != "posix", reason="FIFOs, devices and links of POSIX")


def draw(path):
    from async_tnt.views.figure_style import new_figure, save

    save(new_figure(1.0, 1.0), path, 50)


def view(path):
    from async_tnt.views.rerun_view import RerunView

    with RerunView(random_model(), out=path) as shown:
        shown.push(random_events(50))


def collect(path):
    sample = sample_recordings()[1]
    task = task_of("1.bin", sample, job_of("digits", load_model("digits"), Pixels()))
    collect_results(evaluate_recording, [task], partial(run_all, workers=1), path)


WRITERS = {
    "model.safetensors": lambda path: random_model().save(path),
    "mask.npy": lambda path: save_mask(path, np.zeros((3, 4), bool)),
    "figure.png": draw,
    "view.rrd": view,
    "results.jsonl": collect,
    "numbers.json": lambda path: write_text(path, "{}"),
}
COMMANDS = {  # nothing that they would read is there: to name it in an error, work must have begun
    "evaluate.jsonl": ["evaluate", "nowhere", "nowhere", "--out", "OUT"],
    "export.onnx": ["export", "nowhere", "--out", "OUT"],
    "mask.npy": ["mask", "nowhere.npy", "--out", "OUT"],
    "plot.svg": ["plot", "nowhere.npy", "--out", "OUT"],
    "view.rrd": ["view", "nowhere.npy", "--model", "nowhere", "--out", "OUT"],
    "train.safetensors": ["train", "nowhere", "--out", "OUT"],
    "train.json": ["train", "nowhere", "--out", "train.safetensors"],
    "runs/m/checkpoint.pt": ["train", "nowhere", "--out", "m.safetensors"],
}


def obstacles(path):
    """Put what must not be replaced at `path` and at its `.part`, one after the other.

    Yields the path of each, which must be as it was.
    """
    path.mkdir()
    yield path
    path.rmdir()
    for place in (path, path.with_name(f"{path.name}.part")):
        os.mkfifo(place)
        yield place
        place.unlink()
        # a link to itself, and one from .part to a file of somebody
        for target in (path.name if place == path else "precious", "/dev"):
            place.symlink_to(target)
            yield place
            place.unlink()


def identity(path):
    status = os.lstat(path)
    return status.st_ino, status.st_mode, status.st_rdev, status.st_size, status.st_mtime_ns


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "precious").write_text("precious")
    return tmp_path


@pytest.mark.parametrize("name", WRITERS)
def test_a_writer_replaces_only_files(name, folder):
    for obstacle in obstacles(folder / name):
        before = identity(obstacle)
        with pytest.raises(OSError, match=r"only those are replaced|Too many levels"):
            WRITERS[name](folder / name)
        assert identity(obstacle) == before
    assert (folder / "precious").read_text() == "precious" and os.listdir(folder) == ["precious"]


@pytest.mark.parametrize("name", WRITERS)
def test_a_link_stays_and_its_file_is_replaced_with_its_permissions(name, folder):
    link = folder / name
    real = folder / "far" / f"real_{name}"
    real.parent.mkdir()
    link.symlink_to(real)  # to nothing yet
    WRITERS[name](link)
    assert link.is_symlink() and real.stat().st_size > 0
    real.chmod(0o640)
    if name != "results.jsonl":  # which goes on with what is there
        real.write_text("before")
    WRITERS[name](link)
    assert link.is_symlink() and real.read_bytes() != b"before"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    assert os.listdir(real.parent) == [real.name]


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "results.jsonl"])
def test_where_the_disk_is_full_the_error_names_the_file_which_stays_as_it_was(name, folder):
    WRITERS[name](folder / name)
    before = (folder / name).read_bytes()
    with full_after(1), pytest.raises(OSError, match=f"{TOO_LARGE}.*{name}|{name}.*{TOO_LARGE}"):
        WRITERS[name](folder / name)
    assert (folder / name).read_bytes() == before


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_refuses_its_output_before_any_work(name, folder, capsys):
    if "train" in COMMANDS[name]:
        pytest.importorskip("torch")
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    for obstacle in obstacles(path):
        before = identity(obstacle)
        assert main([str(path) if word == "OUT" else word for word in COMMANDS[name]]) == 2
        out, err = capsys.readouterr()
        assert err.count("\n") == 1 and name in err and "nowhere" not in err
        assert out == "" and identity(obstacle) == before
    assert [path.name for path in folder.rglob("*") if path.is_file()] == ["precious"]


def test_a_new_file_has_the_usual_permissions_and_a_private_one_is_private_all_the_while(folder):
    umask = os.umask(0o027)
    try:
        write_text(folder / "new", "")
        assert stat.S_IMODE((folder / "new").stat().st_mode) == 0o640
        (folder / "new").chmod(0o600)
        file = Replacement(folder / "new")
        assert stat.S_IMODE(file.part.stat().st_mode) == 0o600
        file.discard()
    finally:
        os.umask(umask)


def test_what_a_kill_has_left_is_written_afresh_and_not_into(folder):
    """A second name of the left-over file keeps what it holds."""
    (folder / "new.part").write_text("left")
    os.link(folder / "new.part", folder / "linked")
    write_text(folder / "new", "new")
    assert (folder / "linked").read_text() == "left" and (folder / "new").read_text() == "new"
    assert sorted(os.listdir(folder)) == ["linked", "new", "precious"]


def test_text_is_written_in_utf_8_and_a_suffix_may_be_in_upper_case(folder):
    path = check_writable(folder / "a.JSON", (".txt", ".json"))
    write_text(path, "μs → 5")
    assert path.read_bytes().decode("utf-8") == "μs → 5"
    with pytest.raises(ValueError, match=r"a\.svg: its name must end in \.txt, \.json$"):
        check_writable(folder / "a.svg", (".txt", ".json"))


@pytest.mark.parametrize("locked", ["", "precious"])
def test_without_permission_nothing_is_begun(locked, folder, monkeypatch):
    """Neither in a folder nor in place of a file that must not be written; root may write both."""
    access = os.access
    monkeypatch.setattr(
        os, "access", lambda path, mode: path != folder / locked and access(path, mode)
    )
    with pytest.raises(PermissionError, match="precious cannot be written: no permission"):
        check_writable(folder / "precious")
    for path in (folder, folder / "new" / "newer"):
        if locked:
            check_folder(path)
            continue
        with pytest.raises(PermissionError, match=f"{path.name} cannot be written: no permission"):
            check_folder(path)


def test_a_folder_below_a_file_is_refused_and_below_new_folders_it_is_not(folder):
    check_folder(folder / "a" / "b" / "c")
    check_folder(folder, ["precious", "new"])
    for path in (folder / "precious", folder / "precious" / "b" / "c"):
        with pytest.raises(NotADirectoryError, match=r"precious is not a folder; expected a fold"):
            check_folder(path)
    (folder / "new").mkdir()
    with pytest.raises(FileExistsError, match="new is not a regular file"):
        check_folder(folder, ["precious", "new"])
    assert sorted(os.listdir(folder)) == ["new", "precious"]


def test_an_error_gets_the_name_of_a_file_only_if_it_has_none(folder):
    for raised, named in ((OSError(28, "full"), "mine"), (OSError(28, "full", "theirs"), "theirs")):
        with pytest.raises(OSError, match="full") as caught, naming(folder / "mine"):
            raise raised
        assert os.path.basename(caught.value.filename) == named and caught.value.errno == 28


@pytest.mark.parametrize("replaced", [False, True])
def test_a_file_that_is_deleted_or_replaced_while_it_is_being_locked_counts_as_busy(
    replaced, folder, monkeypatch
):
    import fcntl

    path = folder / "lock"
    flock = fcntl.flock

    def lock_late(*given):
        path.unlink()
        if replaced:
            path.write_text("of another process")
        flock(*given)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    with pytest.raises(BlockingIOError, match="at work"):
        open_locked(path, "at work")
    monkeypatch.setattr(fcntl, "flock", flock)
    path.write_text("content")
    with open_locked(path, "at work") as file:
        assert file.read() == b"content"


def test_a_locked_folder_is_held_once_and_stays_only_with_files_in_it(folder):
    for name in ("empty", "kept"):
        held = folder / "runs" / name
        with locked_folder(held, "lock"):
            with (
                pytest.raises(BlockingIOError, match=f"{name}: another program is at"),
                locked_folder(held, "lock"),
            ):
                pytest.fail("held twice")
            if name == "kept":
                (held / "file").touch()
        assert held.exists() == (folder / "runs").exists() == (name == "kept")
    assert os.listdir(held) == ["file"]
