"""Every function that takes a path knows `~`, and every reader names a pointer of Git LFS."""

import shutil

import numpy as np
import pytest

from async_tnt import TNTConfig, load_model
from async_tnt.base.files import user_path
from async_tnt.evaluation.object_tables import read_table
from async_tnt.networks.onnx.network import OnnxClassifier
from async_tnt.simulation.pictures import read_picture
from async_tnt.sources import (
    READERS,
    PixelFilter,
    load_mask,
    open_recording,
    open_source,
    replay,
    sample_recordings,
    save_mask,
)
from async_tnt.sources.files.labelled_recordings import find_recordings
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.recording_summary import summarize
from async_tnt.training.dataset import read_dataset

POINTER = (
    b"version https://git-lfs.github.com/spec/v1\n"
    b"oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\nsize 12345\n"
)
NAMED = (
    r"a{}: .*only a Git LFS pointer to the file, not the file itself; fetch it with "
    r"`git lfs pull` in its repository"
)
MASK = np.zeros((34, 34), bool)
CONFIG = TNTConfig()


def read_labels(path):
    """A session with this table of labels."""
    table = path.rename(path.with_name("a_labels.csv"))
    np.savez(path.with_name("a.npz"), events=open_recording(sample_recordings()[3]).read())
    return find_recordings(table.parent)


READ = {
    **{suffix: open_recording for suffix in READERS},
    ".BIN": open_recording,
    ".lfs": open_recording,  # this is the suffix of no format
    ".safetensors": load_model,
    ".onnx": lambda path: load_model(path, config=CONFIG),
    ".Onnx": OnnxClassifier,
    ".mask.npy": load_mask,
    ".filter.npy": lambda path: PixelFilter((34, 34), mask=path),
    ".nmnist.bin": read_nmnist,
    ".png": read_picture,
    "_objects.csv": lambda path: read_table(path, ["a"]),
    "_bbox.npy": lambda path: read_table(path, ["a"]),
    "_labels.csv": read_labels,
}
"""How a file's name ends -> what reads such a file."""


@pytest.mark.parametrize("ending", READ)
def test_a_pointer_of_git_lfs_is_named_whatever_it_stands_for(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    path.write_bytes(POINTER)
    with pytest.raises(ValueError, match=NAMED.format(ending)) as raised:
        READ[ending](path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("words", [("run",), ("info",), ("info", "--json")], ids=" ".join)
@pytest.mark.parametrize("name", ["a.npz", "a.raw", "model.safetensors"])
def test_the_program_says_so_too(program, tmp_path, words, name):
    (tmp_path / name).write_bytes(POINTER)
    command = (
        ("run", sample_recordings()[3], "--model")
        if name.endswith("s") and words[0] == "run"
        else words
    )
    code, _, err = program(*command, tmp_path / name)
    assert code == 2 and "git lfs pull" in err and err.count("\n") == 1


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home folder with a recording, a model, a mask and a data set."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    monkeypatch.chdir(tmp_path.parent)
    shutil.copy(sample_recordings()[3], tmp_path / "3.bin")
    load_model("digits").save(tmp_path / "model.safetensors")
    save_mask(tmp_path / "mask.npy", MASK)
    for label in ("3", "7"):
        (tmp_path / "set" / label).mkdir(parents=True)
        shutil.copy(sample_recordings()[int(label)], tmp_path / "set" / label / "a.bin")
    return tmp_path


def test_a_tilde_is_the_home_folder_wherever_a_path_is_taken(home):
    events = open_recording(sample_recordings()[3]).read()
    for read in (
        open_recording("~/3.bin").read(),
        open_source("~/3.bin").read(),
        read_nmnist("~/3.bin"),
    ):
        np.testing.assert_array_equal(read, events)
    np.testing.assert_array_equal(np.concatenate(list(replay("~/3.bin", speed=np.inf))), events)
    assert summarize("~/3.bin").events == len(events)
    model = load_model("~/model.safetensors")
    assert model.classes == load_model("digits").classes
    assert model.save("~/saved.safetensors") == home / "saved.safetensors"
    assert (home / "saved.safetensors").is_file()
    np.testing.assert_array_equal(load_mask("~/mask.npy"), MASK)
    assert PixelFilter((34, 34), mask="~/mask.npy")(events).tolist() == events.tolist()
    save_mask("~/other.npy", MASK)
    assert (home / "other.npy").is_file()
    assert [*find_recordings("~/set")] == ["3", "7"] and read_dataset("~/set").classes == ("3", "7")
    assert open_recording("~/3.bin").path == home / "3.bin"


@pytest.mark.parametrize(
    "words",
    [
        ("run", "~/3.bin", "--mask=~/mask.npy", "--model=~/model.safetensors"),
        ("info", "~/3.bin"),
        ("info", "~/set"),
        ("info", "~/model.safetensors"),
        ("plot", "~/3.bin", "--out=~/out/a.png"),
        ("mask", "~/3.bin", "--out=~/out/mask.npy"),
        (
            "evaluate",
            "~/model.safetensors",
            "~/set",
            "--out=~/out/results.jsonl",
            "--mask=~/mask.npy",
        ),
        ("check", "~/3.bin", "--prefixes=1"),
        ("view", "~/3.bin", "--out=~/out/a.rrd"),
    ],
    ids=" ".join,
)
def test_the_program_expands_what_a_shell_does_not(program, home, words):
    pytest.importorskip({"view": "rerun", "plot": "matplotlib"}.get(words[0], "numpy"))
    (home / "out").mkdir()
    code, _, err = program(*words)
    assert code == 0, err
    outs = [word.rpartition("/")[2] for word in words if word.startswith("--out=")]
    assert [path.name for path in (home / "out").iterdir() if path.name in outs] == outs
    assert not (home.parent / "~").exists()


def test_a_name_that_is_no_user_stays_as_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(sample_recordings()[3], tmp_path / "~nobody here.bin")
    assert open_recording("~nobody here.bin").n_events > 1_000
    assert str(user_path("a/~/b")) == "a/~/b"
