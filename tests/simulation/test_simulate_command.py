"""`async-tnt simulate`: what it writes and prints, its errors, and that it resumes when stopped at any moment."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_sets import write_small_mnist

from async_tnt.cli import simulate as command
from async_tnt.simulation.comparison import compare
from async_tnt.simulation.moving_mnist import build, open_set
from async_tnt.sources.files.nmnist import read_nmnist

ALONG = "ON - OFF centroid, along the motion"


@pytest.fixture(autouse=True)
def no_data(monkeypatch):
    monkeypatch.delenv("TNT_DATA", raising=False)


@pytest.fixture
def simulate(program, mnist, tmp_path):
    """Run the command on the small MNIST, into the folder `set`."""

    def run(*words):
        return program("simulate", "--mnist", mnist, "--out", tmp_path / "set", "--workers", 1, *words)

    return run


def test_a_small_set_with_everything(simulate, program, tmp_path):
    binary = tmp_path / "as-nmnist"
    code, printed, err = simulate("--digits", 3, "--bin", binary)
    assert code == 0 and err == "no N-MNIST to compare with; give --nmnist FOLDER\n"
    assert "90 recordings (3 images x 30 motions) in 30 files" in printed
    assert printed.splitlines()[2].split() == ["simulated", "this", "set"]
    assert f"{ALONG} [px]" in printed and "nan" not in printed
    for shard in open_set(tmp_path / "set"):
        for i in range(len(shard)):
            digit, number = shard.labels[i], shard.image[i] + 1
            path = binary / shard.metadata["motion"]["name"] / str(digit) / f"{number:05}.bin"
            np.testing.assert_array_equal(read_nmnist(path), shard.recording(i))
    assert len(list(binary.rglob("*.*"))) == 90
    assert program("run", binary / "036deg-5px" / "0" / "00001.bin")[0] == 0


def test_the_set_is_compared_with_the_recordings_that_show_the_same_images(simulate, mnist, tmp_path):
    """Simulations in N-MNIST's layout stand for N-MNIST: numbered from 1 under Test, as officially."""
    nmnist, out = tmp_path / "nmnist", tmp_path / "moving"
    assert simulate("--digits", 8, "--motions", "nmnist", "--bin", nmnist)[0] == 0
    (nmnist / "nmnist").rename(nmnist / "Test")
    code, printed, _ = simulate("--digits", 8, "--out", out, "--motions", "bell", "--nmnist", nmnist, "--json")
    answer = json.loads(printed)
    assert (answer["recordings"], answer["shards"], answer["motions"]) == (240, 30, "bell")
    assert answer["bytes"] == sum(path.stat().st_size for path in out.glob("*.safetensors"))
    columns = answer["statistics"]
    assert code == 0 and list(columns) == ["N-MNIST", "simulated", "this set"]
    for name in ("events per saccade", "active pixels", "ON share", ALONG):
        assert columns["simulated"][name] == pytest.approx(columns["N-MNIST"][name], rel=0.1)  # another seed
    assert columns["this set"][ALONG] < -2 and "ON - OFF centroid, saccade 1, x" not in columns["this set"]

    # test recordings may be numbered on from 60,001, even in Train; such numbers mean the same images
    for path in list((nmnist / "Test").glob("*/*.bin")):
        path.rename(path.with_name(f"{60_000 + int(path.stem)}.bin"))
    (nmnist / "Test").rename(nmnist / "Train")
    assert compare(open_set(out), mnist, nmnist) == columns

    one = sorted((nmnist / "Train").glob("*/*.bin"))[0]
    one.rename(one.with_name("60024.bin"))  # shows another digit
    code, _, err = simulate("--digits", 8, "--out", out, "--motions", "bell", "--nmnist", nmnist)
    assert code == 2 and "60024.bin: MNIST's test image 24, which it should show, is another digit" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--motions", "circles"], "--motions"),
        (["--digits", "0"], "must be at least 1, got 0"),
        (["--seed", "-1"], "must be a whole number of at least 0|expected one argument"),
    ],
)
def test_wrong_options_exit_with_2(simulate, tmp_path, options, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        simulate(*options)
    assert stopped.value.code == 2 and not (tmp_path / "set").exists()
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--mnist", "nowhere"], "no folder nowhere; give --mnist FOLDER"),
        (["--mnist", "."], "neither t10k-images-idx3-ubyte.gz nor"),
        (["--mnist", "damaged"], "t10k-images-idx3-ubyte.gz: damaged gzip file"),
        (["--digits", "25"], "`digits` must be at most 24"),
        (["--nmnist", "nowhere"], "no folder nowhere; give --nmnist"),
        (["--nmnist", "damaged"], "no N-MNIST recordings; expected"),
        (["--bin", "file"], "not a folder"),
        (["--out", "file"], "file is not a folder; expected a folder to write to"),
        (["--out", "made", "--digits", "1"], "set.json: made with other parameters: kind is 'nmnist', requested 'cons"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(simulate, mnist, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    Path("damaged").mkdir()
    for path in mnist.glob("t10k*"):
        Path("damaged", path.name).write_bytes(path.read_bytes()[:-20])
    build(mnist, "made", digits=1, kind="nmnist", workers=1, frame_us=50_000.0)
    code, printed, err = simulate(*options)
    assert code == 2 and printed == "" and err.startswith("async-tnt: ") and err.count("\n") == 1
    assert message in err and not (tmp_path / "set").exists()


def descendants(pid):
    """Ids of a process's children and theirs, by Linux's /proc."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [int(child) for child in children] + [pid for child in children for pid in descendants(child)]


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False


def start_and_kill(words, folder):
    """Start the command and kill it when its first shard is there; returns once its workers are gone, too."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, "-m", "async_tnt.cli", *words], **quiet) as process:
        try:
            while not list(folder.glob("*.safetensors")):
                assert process.poll() is None
                time.sleep(0.005)
            family = descendants(process.pid)
        finally:
            process.kill()
    deadline = time.monotonic() + 600
    while any(map(is_running, family)):  # no worker outlives the command
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
def test_a_killed_simulation_resumes_to_the_same_files(tmp_path, program):
    (tmp_path / "mnist").mkdir()
    mnist = write_small_mnist(tmp_path / "mnist", 30)  # so many that there is a middle to be killed in
    for attempt in range(5):  # on a busy machine the kill may come when all is done: then once more
        folder = tmp_path / f"set {attempt}"
        words = ["simulate", "--mnist", str(mnist), "--out", str(folder), "--motions", "bell", "--workers"]
        start_and_kill([*words, "2"], folder)
        n_made = len(list(folder.glob("*.safetensors")))
        if n_made < 30:
            break
    with pytest.raises(ValueError, match=f"{30 - n_made} of 30 shards are missing"):
        open_set(folder)
    assert program(*words, 1)[0] == 0
    build(mnist, tmp_path / "whole", kind="bell", workers=1)
    files = [{path.name: path.read_bytes() for path in one.iterdir()} for one in (folder, tmp_path / "whole")]
    assert files[0] == files[1] and len(files[0]) == 31


def test_ctrl_c_is_answered_in_one_line(simulate, tmp_path, monkeypatch):
    def interrupt(*words, **more):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "build", interrupt)
    code, _, err = simulate()
    assert code == 130 and err == (
        f"async-tnt: interrupted; finished shards are kept in {tmp_path / 'set'}. Give the same command again to "
        "resume.\n"
    )
