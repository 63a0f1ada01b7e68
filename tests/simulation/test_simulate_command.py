"""`async-tnt simulate`: what it writes and prints, its errors, and that it resumes when stopped at any moment."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_sets import write_small_mnist

from async_tnt.cli import main
from async_tnt.simulation.comparison import compare
from async_tnt.simulation.moving_mnist import build, open_set
from async_tnt.sources.files.nmnist import read_nmnist

compiled_only = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="simulates too much for uncompiled code"
)


@pytest.fixture(autouse=True)
def no_data(monkeypatch):
    monkeypatch.delenv("TNT_DATA", raising=False)


@compiled_only
def test_a_small_set_with_everything(mnist, tmp_path, capsys):
    out, binary = tmp_path / "set", tmp_path / "as-nmnist"
    words = ["--mnist", mnist, "--out", out, "--digits", 3, "--workers", 1, "--bin", binary]
    assert main(["simulate", *map(str, words)]) == 0
    captured = capsys.readouterr()
    assert "90 recordings (3 images x 30 motions) in 30 files" in captured.out
    assert captured.out.splitlines()[2].split() == ["simulated", "this", "set"]
    assert "ON - OFF centroid, along the motion [px]" in captured.out and "nan" not in captured.out
    assert captured.err == "no N-MNIST to compare with; give --nmnist FOLDER\n"

    made = open_set(out)
    n_files = 0
    for shard in made:
        for i in range(len(shard)):
            digit, number = shard.labels[i], shard.image[i] + 1
            path = binary / shard.metadata["motion"]["name"] / str(digit) / f"{number:05}.bin"
            np.testing.assert_array_equal(read_nmnist(path), shard.recording(i))
            n_files += 1
    assert n_files == 90 == len(list(binary.rglob("*.*")))
    assert main(["run", str(binary / "036deg-5px" / "0" / "00001.bin")]) == 0


@compiled_only
def test_json_is_one_object(mnist, tmp_path, capsys):
    argv = ["simulate", "--mnist", str(mnist), "--out", str(tmp_path), "--digits", "2", "--workers", "1", "--json"]
    assert main([*argv, "--motions", "bell", "--split", "train", "--seed", "4"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["recordings"] == 60 and answer["shards"] == 30 and answer["motions"] == "bell"
    assert answer["bytes"] == sum(path.stat().st_size for path in tmp_path.glob("*.safetensors"))
    assert set(answer["statistics"]) == {"simulated", "this set"}
    assert answer["statistics"]["this set"]["ON - OFF centroid, along the motion"] < -2  # ON events trail
    parameters = open_set(tmp_path).parameters
    assert (parameters["seed"], parameters["split"], parameters["kind"]) == (4, "train", "bell")


@compiled_only
def test_the_set_is_compared_with_the_recordings_that_show_the_same_images(mnist, tmp_path, capsys):
    """Simulations in N-MNIST's layout stand for N-MNIST: numbered from 1 under Test, as officially."""
    argv = ["simulate", "--mnist", str(mnist), "--digits", "8", "--workers", "1"]
    assert main([*argv, "--motions", "nmnist", "--out", str(tmp_path / "a"), "--bin", str(tmp_path / "nmnist")]) == 0
    nmnist = tmp_path / "nmnist"
    (nmnist / "nmnist").rename(nmnist / "Test")
    capsys.readouterr()
    assert main([*argv, "--out", str(tmp_path / "b"), "--nmnist", str(nmnist), "--json"]) == 0
    columns = json.loads(capsys.readouterr().out)["statistics"]
    assert list(columns) == ["N-MNIST", "simulated", "this set"]
    for name in ("events per saccade", "active pixels", "ON share", "ON - OFF centroid, along the motion"):
        assert columns["simulated"][name] == pytest.approx(columns["N-MNIST"][name], rel=0.1)  # another seed
    assert columns["this set"]["ON - OFF centroid, along the motion"] < -2
    assert "ON - OFF centroid, saccade 1, x" not in columns["this set"]

    # test recordings may be numbered on from 60,001, even in Train; such numbers mean the same images
    for path in list((nmnist / "Test").glob("*/*.bin")):
        path.rename(path.with_name(f"{60_000 + int(path.stem)}.bin"))
    (nmnist / "Test").rename(nmnist / "Train")
    assert compare(open_set(tmp_path / "b"), mnist, nmnist) == columns

    one = sorted((nmnist / "Train").glob("*/*.bin"))[0]
    one.rename(one.with_name("60024.bin"))  # shows another digit
    assert main([*argv, "--out", str(tmp_path / "b"), "--nmnist", str(nmnist)]) == 2
    assert "60024.bin: MNIST's test image 24, which it should show, is another digit" in capsys.readouterr().err


@compiled_only
def test_real_recordings_and_their_simulations_agree(data, tmp_path):
    if not (data / "mnist").is_dir():
        pytest.skip(f"no mnist in {data}")
    made = build(data / "mnist", tmp_path, digits=20, kind="bell", workers=1)
    columns = compare(made, data / "mnist", data / "nmnist", n_recordings=60)
    real, simulated, moving = columns["N-MNIST"], columns["simulated"], columns["this set"]
    for name in ("events per saccade", "active pixels", "events per active pixel", "ON share"):
        assert simulated[name] == pytest.approx(real[name], rel=0.12)
        assert moving[name] == pytest.approx(real[name], rel=0.25)
    for column in (simulated, moving):
        for way, margin in (("along", 0.6), ("across", 0.4)):
            name = f"ON - OFF centroid, {way} the motion"
            assert column[name] == pytest.approx(real[name], abs=margin)


def test_help_teaches(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", "--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    for word in ("examples:", "--mnist", "--bin", "10 directions", "Ctrl-C", "train-images-idx3-ubyte.gz"):
        assert word in text


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--split", "val"], "--split"),
        (["--motions", "circles"], "--motions"),
        (["--digits", "0"], "must be at least 1, got 0"),
        (["--digits", "some"], "must be a whole number, got 'some'"),
        (["--seed", "-1"], "must be a whole number of at least 0|expected one argument"),
        (["--workers", "0"], "must be at least 1, got 0"),
        (["--fly"], "unrecognized arguments: --fly"),
    ],
)
def test_wrong_flags_exit_with_2(mnist, tmp_path, options, complaint, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", "--mnist", str(mnist), "--out", str(tmp_path / "set"), *options])
    assert stopped.value.code == 2 and not (tmp_path / "set").exists()
    assert re.search(complaint, capsys.readouterr().err)


def test_an_output_folder_is_required(mnist, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", "--mnist", str(mnist)])
    assert stopped.value.code == 2 and "--out" in capsys.readouterr().err


def damaged(mnist, tmp_path):
    for path in mnist.iterdir():
        raw = path.read_bytes()
        (tmp_path / path.name).write_bytes(raw[: len(raw) // 2] if "images" in path.name else raw)
    return tmp_path


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (lambda mnist, tmp: [], "no data: give --mnist FOLDER, or set TNT_DATA"),
        (lambda mnist, tmp: ["--mnist", str(tmp / "nowhere")], "no folder .*nowhere; give --mnist FOLDER"),
        (lambda mnist, tmp: ["--mnist", str(tmp)], "neither t10k-images-idx3-ubyte.gz nor"),
        (lambda mnist, tmp: ["--mnist", str(damaged(mnist, tmp))], "t10k-images-idx3-ubyte.gz: damaged gzip file"),
        (lambda mnist, tmp: ["--mnist", str(mnist), "--digits", "25"], "`digits` must be at most 24"),
        (
            lambda mnist, tmp: ["--mnist", str(mnist), "--nmnist", str(tmp / "nowhere")],
            "no folder .*nowhere; give --nmnist",
        ),
        (lambda mnist, tmp: ["--mnist", str(mnist), "--nmnist", str(mnist)], "no N-MNIST recordings; expected"),
        (lambda mnist, tmp: ["--mnist", str(mnist), "--bin", str(mnist / "t10k-labels-idx1-ubyte.gz")], "not a folder"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(mnist, tmp_path, options, complaint, capsys):
    assert main(["simulate", "--out", str(tmp_path / "set"), *options(mnist, tmp_path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("async-tnt: ") and captured.err.count("\n") == 1
    assert re.search(complaint, captured.err)
    assert not (tmp_path / "set").exists()


def test_output_that_is_a_file_or_another_set_is_refused(mnist, tmp_path, capsys):
    (tmp_path / "file").write_bytes(b"")
    assert main(["simulate", "--mnist", str(mnist), "--out", str(tmp_path / "file")]) == 2
    assert "file is not a folder; expected a folder to write to" in capsys.readouterr().err
    build(mnist, tmp_path / "set", digits=1, kind="nmnist", workers=1, frame_us=50_000.0)
    assert main(["simulate", "--mnist", str(mnist), "--out", str(tmp_path / "set"), "--digits", "1"]) == 2
    captured = capsys.readouterr()
    assert "set.json: made with other parameters: kind is 'nmnist', requested 'constant'" in captured.err
    assert captured.err.count("\n") == 1


def descendants(pid):
    """Ids of a process' children and theirs, by Linux' /proc."""
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


def start_and_stop(argv, folder, stop):
    """Start the command, stop it when its first shard is there; (exit code, stderr), once all of it is gone."""
    command = [sys.executable, "-m", "async_tnt.cli", *argv]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, text=True
    ) as process:
        try:
            while not list(folder.glob("*.safetensors")):
                assert process.poll() is None
                time.sleep(0.005)
            family = descendants(process.pid)
            if stop == signal.SIGINT:
                os.killpg(process.pid, stop)  # Ctrl-C in a terminal: every process of the group gets it
            else:
                process.kill()
            _, err = process.communicate()
        finally:
            process.kill()
    deadline = time.monotonic() + 600
    while any(map(is_running, family)):  # no worker outlives the command
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return process.returncode, err


@compiled_only
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_a_stopped_simulation_resumes_to_the_same_files(tmp_path, stop):
    (tmp_path / "mnist").mkdir()
    mnist = write_small_mnist(tmp_path / "mnist", 30)  # so many that there is a middle to be stopped in
    for attempt in range(5):  # on a busy machine the stop may come when all is done: then once more
        folder = tmp_path / f"set {attempt}"
        argv = ["simulate", "--mnist", str(mnist), "--out", str(folder), "--motions", "bell"]
        code, err = start_and_stop([*argv, "--workers", "2"], folder, stop)
        n_made = len(list(folder.glob("*.safetensors")))
        if n_made < 30:
            break
    assert 0 < n_made < 30
    if stop == signal.SIGINT:
        assert code == 130
        assert err == (
            f"async-tnt: interrupted; finished shards are kept in {folder}. Give the same command again to resume.\n"
        )
    with pytest.raises(ValueError, match=f"{30 - n_made} of 30 shards are missing"):
        open_set(folder)

    assert main([*argv, "--workers", "1"]) == 0
    build(mnist, tmp_path / "whole", kind="bell", workers=1)
    files = [{path.name: path.read_bytes() for path in one.iterdir()} for one in (folder, tmp_path / "whole")]
    assert files[0] == files[1] and len(files[0]) == 31
