"""The thesis' table: what is compared, the numbers brought together, and `async-tnt table`."""

import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from async_tnt import Processor, cli, load_model  # noqa: E402
from async_tnt.simulation.moving_mnist import build, open_set  # noqa: E402
from async_tnt.training.table import COLUMNS, ROWS, aggregate, markdown_table, motions_table, text_table  # noqa: E402
from async_tnt.training.table_data import (  # noqa: E402
    RealFolder,
    saccade,
    shown_test_images,
    trained_on,
)
from async_tnt.training.table_runs import Run  # noqa: E402


def test_rows_differ_only_in_what_they_are_named_for():
    plain = {name: row for name, row in ROWS.items() if row.motions is None}
    assert list(plain) == ["baseline", "tnt", "regress", "running", "line"]
    for name in ROWS.keys() - plain.keys():
        without = ROWS[name.split("-")[0]]
        assert (ROWS[name].config, ROWS[name].augmentation) == (without.config, without.augmentation)
    for name in ("tnt", "regress", "running", "line"):
        assert (ROWS[name].config.transform, ROWS[name].config.t_max) == ("tnt", ROWS["tnt"].config.t_max)
    assert ROWS["baseline"].config.transform == "none" and ROWS["line"].config.remove_flow
    thinned = ROWS["baseline"].augmentation
    assert [row.augmentation == thinned for row in plain.values()] == [True, True, False, True, True]


def test_images_seen_in_training_are_read_from_the_names():
    names = ["3/00001.bin", "3/60000.bin", "7/60001.bin", "7/60026.bin", "1/70000.bin", "1/other.bin", "1/70001.bin"]
    assert shown_test_images(names).tolist() == [0, 25, 9999]


@pytest.fixture(scope="module")
def moving(mnist, tmp_path_factory):
    """45 images under 30 motions; the small N-MNIST's Train shows all but the first 5."""
    folder = tmp_path_factory.mktemp("moving")
    build(mnist, folder, workers=1)
    return folder


def test_real_windows_by_saccade(nmnist):
    data = RealFolder(nmnist, validation=0.25).read()
    assert data.description["split"].startswith("not the official one")
    counts = [data.description[f"{part}_recordings"] for part in ("training", "held_out", "test")]
    assert counts == [30, 10, 10] and np.bincount(saccade(data.test)).tolist() == [10, 10, 10]
    assert len(trained_on(data.training, "1")) == 30
    assert not set(data.training.recording) & set(data.held_out.recording)
    assert data.seen_images.tolist() == list(range(5, 45))


def test_numbers_and_tables_by_hand():
    def run(row, seed, **accuracies):
        columns = {
            column.replace("_", "/"): {"accuracy": a, "windows": 4, "per_motion": {"saccade 1": a, "saccade 2": a / 2}}
            for column, a in accuracies.items()
        }
        return {"row": row, "seed": seed, "columns": columns}

    runs = [run("tnt", 0, all_all=0.96, all_sim=0.6), run("baseline", 1, all_all=1.0), run("baseline", 0, all_all=0.98)]
    table = aggregate(runs)
    assert list(table) == ["baseline", "tnt"] and list(table["tnt"]) == ["all/all", "all/sim"]
    part = table["baseline"]["all/all"]
    assert part["mean"] == pytest.approx(0.99) and part["deviation"] == pytest.approx(0.01 * 2**0.5)
    assert part["seeds"] == {"0": 0.98, "1": 1.0} and part["thesis"] == 0.991
    assert part["per_motion"]["saccade 2"]["mean"] == pytest.approx(0.495)
    assert table["tnt"]["all/sim"]["deviation"] is None
    lines = text_table(table).splitlines()
    assert lines[0].split() == list(COLUMNS)[:5]  # those of the thesis; ours where they occur
    assert lines[1].split() == ["Baseline", ".990", "±", ".014", "-", "-", "-", "-"]
    markdown = markdown_table(table).splitlines()
    assert markdown[2] == "| Baseline | .990 ± .014 (.991) | - (.437) | - (.442) | - (.396) | - (.207) |"
    assert motions_table(table, "all/all").splitlines()[-1] == "| saccade 2 | .495 | .480 |"


@pytest.fixture(scope="module")
def words(nmnist, moving):
    """A small table of two rows."""
    words = ["--nmnist", nmnist, "--simulated", moving, "--rows", "baseline", "regress", "--seeds", 3]
    return ["table", *words, "--iterations", 3, "--batch", 16, "--workers", 1, "--out"]


@pytest.fixture(scope="module")
def done(words, tmp_path_factory):
    out = tmp_path_factory.mktemp("table")
    assert cli.main([*map(str, words), str(out)]) == 0
    return out


def test_results_record_what_was_done(done):
    record = json.loads((done / "results.json").read_text())
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
    assert "baseline-1-seed3" in record["validation"] and str(done) not in json.dumps(record)
    assert "1/sim, by motion:" in (done / "table.md").read_text()


def test_the_numbers_are_those_of_the_networks_beside_them(done, moving):
    """Counted once more, recording by recording, through the stream's own volumes and compiled network."""
    model = load_model(done / "networks" / Run("baseline", "1", 3).name / "model.safetensors")
    processor, right = Processor(model, start_us=0), []
    for shard in open_set(moving):
        for i in range(5):
            processor.reset()
            processor.push(shard.recording(i))
            right.append(processor.fire().index == shard.labels[i])
    found = json.loads((done / "results.json").read_text())["table"]["baseline"]["1/sim"]["mean"]
    assert np.mean(right) == pytest.approx(found)


def test_given_again_it_trains_what_is_missing_and_refuses_other_settings(done, words, tmp_path, monkeypatch, program):
    before = json.loads((done / "results.json").read_text())
    shutil.copytree(done, tmp_path / "cut")
    shutil.rmtree(tmp_path / "cut" / "networks" / "regress-1-seed3")
    code, printed, _ = program(*words, tmp_path / "cut", "--json")
    assert code == 0 and json.loads(printed)["table"] == before["table"]
    monkeypatch.setattr("torch.optim.AdamW.step", lambda *a, **k: pytest.fail("trained again"))
    code, printed, _ = program(*words, done, "--json")
    assert code == 0 and json.loads(printed)["table"] == before["table"]
    code, _, err = program(*words, done, "--iterations", 4)
    assert code == 2 and "holds a run with other iterations" in err


def test_rows_with_resynthesis(nmnist, moving, tmp_path, program):
    """Motions are made once for both seeds, and counted in the results."""
    words = ["--rows", "baseline", "baseline-moved", "--trained-on", "confounded", "--seeds", 0, 1, "--out", tmp_path]
    words += ["--nmnist", nmnist, "--simulated", moving, "--iterations", 4, "--batch", 16, "--workers", 1]
    code, printed, _ = program("table", *words)
    record = json.loads((tmp_path / "results.json").read_text())
    assert code == 0 and "Re-synthesis only" in printed and "confounded/all" in printed
    motions = record["rows"]["baseline-moved"]["motions"]["confounded"]
    assert motions["windows"] == 40 == motions["with_path"] and motions["variations"] == 2  # no more than epochs
    assert record["rows"]["baseline"]["motions"] == {}
    assert record["table"]["baseline-moved"]["confounded/sim"]["windows"] == 150
    assert sorted(record["validation"]) == [
        f"{row}-confounded-seed{s}" for row in ("baseline", "baseline-moved") for s in (0, 1)
    ]


def test_each_class_is_seen_in_one_saccade(nmnist):
    windows = trained_on(RealFolder(nmnist, validation=0.25).read().training, "confounded")
    pairs = set(zip(windows.labels.tolist(), saccade(windows).tolist(), strict=True))
    assert pairs == {(digit, 0) for digit in range(4)} | {(4, 1), (5, 1), (6, 1), (7, 2), (8, 2), (9, 2)}


def test_smoke_makes_its_own_motions(nmnist, mnist, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--nmnist", nmnist, "--mnist", mnist, "--rows", "line", "--workers", 1, "--iterations", 2]
    code, printed, _ = program("table", "--smoke", *words)
    assert code == 0 and "line, flow removed, unsigned" in printed and "30 motions of 5 MNIST test images" in printed
    assert (tmp_path / "table-smoke" / "results.json").exists()


def test_errors_are_one_line(nmnist, mnist, tmp_path, monkeypatch, program):
    monkeypatch.delenv("TNT_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    seen = shutil.copytree(nmnist, tmp_path / "seen")
    for k, path in enumerate(sorted(seen.glob("Train/*/*.bin"))):  # of test images from the first on
        path.rename(path.with_name(f"{60_001 + k}-{path.name}"))
    for path in seen.glob("Train/*/*-*.bin"):
        path.rename(path.with_name(path.name[:5] + ".bin"))
    for words, message in (
        ([], "no data: give --nmnist FOLDER"),
        (["--nmnist", nmnist], "no data: give --mnist FOLDER"),
        (["--nmnist", seen, "--mnist", mnist, "--smoke"], "all of its 20 images are shown by training recordings"),
    ):
        code, _, err = program("table", "--workers", 1, *words)
        assert code == 2 and message in err and err.count("\n") == 1
