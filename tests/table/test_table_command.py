"""`async-tnt table`: from folders to the table, resumed, and its messages."""

import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from async_tnt import cli, load_model  # noqa: E402
from async_tnt.training import table_runs  # noqa: E402
from async_tnt.training.table_runs import Run  # noqa: E402


def table(*words):
    return cli.main(["table", *map(str, words)])


@pytest.fixture(scope="module")
def done(small_nmnist, small_set, tmp_path_factory):
    """One small table of two rows."""
    out = tmp_path_factory.mktemp("table")
    words = ["--nmnist", small_nmnist, "--simulated", small_set, "--rows", "baseline", "regress", "--seeds", 3]
    words += ["--iterations", 3, "--batch", 16, "--workers", 1, "--out", out]
    assert table(*words) == 0
    return words, out


def test_results_record_what_was_done(done):
    _, out = done
    record = json.loads((out / "results.json").read_text())
    assert record["command"] == (
        "async-tnt table --nmnist N-MNIST --simulated MOVING-MNIST --rows baseline regress --seeds 3 --iterations 3 "
        "--batch 16"
    )
    assert set(record["table"]) == {"baseline", "regress"}
    for columns in record["table"].values():
        assert list(columns) == ["all/all", "1/all", "1/train", "all/sim", "1/sim"]
        assert [columns[c]["windows"] for c in columns] == [30, 30, 120, 150, 150]  # 40 recordings; 5 unseen images
        assert [len(columns[c]["per_motion"]) for c in columns] == [3, 3, 3, 30, 30]
    assert record["data"]["simulated"]["images_tested_on"] == 5
    assert record["rows"]["regress"]["augmentation"]["translate_px"] == 4
    assert "baseline-1-seed3" in record["validation"]
    assert str(out) not in json.dumps(record)
    assert "1/sim, by motion:" in (out / "table.md").read_text()


def test_the_numbers_are_those_of_the_networks_beside_them(done, small_set):
    """Counted once more, window by window, through the stream's own volumes and compiled network."""
    from async_tnt import Processor
    from async_tnt.simulation.moving_mnist import open_set

    _, out = done
    model = load_model(out / "networks" / Run("baseline", "1", 3).name / "model.safetensors")
    processor = Processor(model, start_us=0)
    right = []
    for shard in open_set(small_set):
        for i in range(5):
            processor.reset()
            processor.push(shard.recording(i))
            right.append(processor.fire().index == shard.labels[i])
    found = json.loads((out / "results.json").read_text())["table"]["baseline"]["1/sim"]["mean"]
    assert np.mean(right) == pytest.approx(found)


def test_given_again_it_trains_nothing(done, monkeypatch, capsys):
    words, out = done
    before = (out / "results.json").read_text()
    monkeypatch.setattr("torch.optim.AdamW.step", lambda *a, **k: pytest.fail("trained again"))
    assert table(*words, "--json") == 0
    assert json.loads(capsys.readouterr().out)["table"] == json.loads(before)["table"]


def test_other_settings_in_the_same_folder_are_refused(done, capsys):
    words, _ = done
    assert table(*words, "--iterations", 4) == 2
    assert "holds a run with other iterations" in capsys.readouterr().err


def test_an_interrupted_table_resumes_to_the_same_numbers(done, tmp_path, monkeypatch, capsys):
    words, out = done
    words = [*words[:-1], tmp_path]
    real, calls = table_runs.run_network, []

    def stop_at_the_third(*args):
        calls.append(args[0])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*args)

    monkeypatch.setattr(table_runs, "run_network", stop_at_the_third)
    assert table(*words) == 130
    assert capsys.readouterr().err == "async-tnt: interrupted\n"
    assert len(list((tmp_path / "networks").glob("*/result.json"))) == 2
    monkeypatch.undo()
    assert table(*words) == 0
    again, once = (json.loads((folder / "results.json").read_text())["table"] for folder in (tmp_path, out))
    assert again == once


def test_smoke_makes_its_own_motions_in_two_processes(small_nmnist, small_mnist, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--nmnist", small_nmnist, "--mnist", small_mnist, "--rows", "line", "--workers", 2, "--iterations", 2]
    assert table("--smoke", *words) == 0
    printed = capsys.readouterr().out
    assert "line, flow removed, unsigned" in printed and "30 motions of 5 MNIST test images" in printed
    assert (tmp_path / "table-smoke" / "results.json").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "no data: give --nmnist FOLDER"),
        (["--nmnist", "nowhere"], "no folder nowhere; give --nmnist FOLDER"),
        (["--nmnist", "."], "no folder Train in ."),
        (["--nmnist", "NMNIST", "--simulated", "."], "no set.json in it"),
        (["--nmnist", "NMNIST"], "no data: give --mnist FOLDER"),
    ],
)
def test_missing_data_is_one_line(words, text, small_nmnist, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("TNT_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    assert table(*[str(small_nmnist) if word == "NMNIST" else word for word in words]) == 2
    printed = capsys.readouterr().err
    assert text in printed and printed.count("\n") == 1


def test_a_set_without_unseen_images_is_refused(small_nmnist, small_mnist, tmp_path, capsys):
    """With all its images seen in training, it would measure nothing."""
    folder = tmp_path / "nmnist"
    for split in ("Train", "Test"):
        for k, path in enumerate(sorted((small_nmnist / split).glob("*/*.bin"))):
            (folder / split / path.parent.name).mkdir(parents=True, exist_ok=True)
            (folder / split / path.parent.name / f"{60_001 + k}.bin").symlink_to(path)
    assert table("--smoke", "--nmnist", folder, "--mnist", small_mnist, "--workers", 1, "--out", tmp_path) == 2
    assert "all of its 20 images are shown by training recordings" in capsys.readouterr().err


@pytest.mark.filterwarnings("default:left out:UserWarning")
def test_damaged_recordings_are_refused_or_left_out(small_nmnist, small_set, tmp_path, capsys):
    folder = tmp_path / "nmnist"
    shutil.copytree(small_nmnist, folder)
    damaged = next(folder.glob("Train/3/*.bin"))
    damaged.write_bytes(damaged.read_bytes()[:-2])
    words = ["--nmnist", folder, "--simulated", small_set, "--rows", "baseline", "--trained-on", "1", "--seeds", 0]
    words += ["--iterations", 1, "--workers", 1, "--out", tmp_path / "out"]
    assert table(*words) == 2
    printed = capsys.readouterr().err
    assert damaged.name in printed and "--skip-damaged" in printed and printed.count("\n") == 1
    assert table(*words, "--skip-damaged") == 0
    out, err = capsys.readouterr()
    assert "39 recordings to train on" in out
    assert f"async-tnt: warning: left out: {damaged}: damaged N-MNIST recording" in err


@pytest.mark.parametrize("words", [["--rows", "best"], ["--seeds", "-1"], ["--iterations", "0"], ["--precision", "8"]])
def test_wrong_options_are_named(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        table(*words)
    assert stopped.value.code == 2 and words[0] in capsys.readouterr().err
