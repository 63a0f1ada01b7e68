"""The thesis' table: what is compared, the numbers brought together, and its command."""

import json
import shutil
from dataclasses import asdict

import numpy as np
import pytest
from small_sets import write_small_mnist

torch = pytest.importorskip("torch")

from async_tnt import Processor, TNTConfig, load_model  # noqa: E402
from experiments import thesis_table  # noqa: E402
from experiments.moving_mnist_set import build, open_set  # noqa: E402
from experiments.page_parts import results  # noqa: E402
from experiments.table_data import (  # noqa: E402
    RealFolder,
    saccade,
    shown_test_images,
    trained_on,
)
from experiments.table_numbers import aggregate, differences, markdown_table, text_table  # noqa: E402
from experiments.table_rows import DIFFERENCES, ROWS, Run  # noqa: E402


@pytest.fixture(scope="module")
def mnist(tmp_path_factory):
    """45 images."""
    return write_small_mnist(tmp_path_factory.mktemp("MNIST"), 45)


def test_pairs_that_are_compared_differ_in_one_thing():
    assert {name for pair in DIFFERENCES for name in pair} <= set(ROWS)
    for row, against in DIFFERENCES:
        a, b = ROWS[row], ROWS[against]
        assert (a.iterations, a.recordings) == (b.iterations, b.recordings)
        if a.config.representation != "volume":  # another input: no transform, and split
            assert (a.augmentation, a.config.transform) == (b.augmentation, "none")
            continue
        differ = [
            a.augmentation != b.augmentation,
            a.config.polarity != b.config.polarity,
            a.config.t_max != b.config.t_max and row.split("-")[0] == against.split("-")[0],
            a.config.replace(polarity="signed", t_max=2) != b.config.replace(polarity="signed", t_max=2),
            a.motions != b.motions,
        ]
        assert sum(differ) == 1, (row, against)


def test_images_seen_in_training_are_read_from_the_names():
    names = ["3/00001.bin", "3/60000.bin", "7/60001.bin", "7/60026.bin", "1/70000.bin", "1/other.bin", "1/70001.bin"]
    assert shown_test_images(names).tolist() == [0, 25, 9999]


@pytest.fixture(scope="module")
def moving(mnist, tmp_path_factory):
    """45 images under 30 motions, three shards each; the small N-MNIST's Train shows all but the first 5."""
    folder = tmp_path_factory.mktemp("moving")
    build(mnist, folder, workers=1, recordings_per_shard=20)
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

    runs = [
        run("thesis-tnt", 0, all_all=0.96, all_sim=0.6, all_bell=0.5),
        run("raw", 1, all_all=1.0),
        run("raw", 0, all_all=0.98),
        run("raw-translated", 0, all_all=0.94),
        run("raw-translated", 1, all_all=0.98),
    ]
    table = aggregate(runs)
    assert list(table) == ["raw", "raw-translated", "thesis-tnt"]
    assert list(table["thesis-tnt"]) == ["all/all", "all/sim", "all/bell"]
    part = table["raw"]["all/all"]
    assert part["mean"] == pytest.approx(0.99) and part["deviation"] == pytest.approx(0.01 * 2**0.5)
    assert part["seeds"] == {"0": 0.98, "1": 1.0}
    assert part["per_motion"]["saccade 2"]["mean"] == pytest.approx(0.495)
    assert table["thesis-tnt"]["all/sim"]["deviation"] is None
    lines = text_table(table).splitlines()
    assert lines[0].split() == ["comparison", "all/all"] and lines[1].split() == ["raw", ".990", "±", ".014"]
    assert lines[-1].split() == ["in", "the", "thesis", ".981", ".592"]
    assert markdown_table(table, "comparison").splitlines()[2] == "| raw | .990 ± .014 |"
    assert markdown_table(table, "thesis").splitlines()[2] == "| TNT | .960 (.981) | .600 (.592) | .500 |"
    (found,) = differences(table)  # -.04 and -.02: mean -.03, deviation .01414, 12.706 x .01414 / sqrt 2 = .12706
    assert (found["row"], found["against"], found["column"], found["seeds"]) == ("raw-translated", "raw", "all/all", 2)
    assert [found[name] for name in ("mean", "low", "high")] == pytest.approx([-0.03, -0.15706, 0.09706])


@pytest.fixture(scope="module")
def words(nmnist, moving):
    """A small table of two rows."""
    words = ["--nmnist", nmnist, "--simulated", moving, "--rows", "raw", "regressor-translated", "--seeds", 3]
    return [*words, "--iterations", 3, "--batch", 16, "--workers", 1, "--out"]


@pytest.fixture(scope="module")
def done(words, tmp_path_factory):
    out = tmp_path_factory.mktemp("table")
    assert thesis_table.main([*map(str, words), str(out)]) == 0
    return out


def test_results_record_what_was_done(done):
    record = json.loads((done / "results.json").read_text())
    assert record["command"] == (
        "python -m experiments.thesis_table --nmnist N-MNIST --simulated MOVING-MNIST "
        "--rows raw regressor-translated --seeds 3 --iterations 3 --batch 16"
    )
    assert set(record["table"]) == {"raw", "regressor-translated"}
    for columns in record["table"].values():
        assert list(columns) == ["all/all", "1/all", "1/others", "1/train", "all/sim", "1/sim"]
        assert [columns[c]["windows"] for c in columns] == [30, 30, 20, 120, 150, 150]  # 40 recordings; 5 unseen images
        assert [len(columns[c]["per_motion"]) for c in columns] == [3, 3, 2, 3, 30, 30]
    assert record["data"]["simulated"]["sim"]["images_tested_on"] == 5
    assert record["rows"]["regressor-translated"]["augmentation"]["translate_px"] == 4
    assert record["rows"]["raw"]["iterations"] == 3
    assert "raw-1-seed3" in record["validation"] and str(done) not in json.dumps(record)
    assert "| raw |" in (done / "table.md").read_text()


def test_the_numbers_are_those_of_the_networks_beside_them(done, moving):
    """Counted once more, recording by recording, through the stream's own volumes and compiled network."""
    model = load_model(done / "networks" / Run("raw", "1", 3).name / "model.safetensors")
    processor, right = Processor(model, start_us=0), []
    for shard in open_set(moving):
        for i in np.flatnonzero(shard.image < 5):
            processor.reset()
            processor.push(shard.recording(i))
            right.append(processor.fire().index == shard.labels[i])
    found = json.loads((done / "results.json").read_text())["table"]["raw"]["1/sim"]["mean"]
    assert np.mean(right) == pytest.approx(found)


def test_given_again_it_trains_what_is_missing_and_refuses_other_settings(
    done, words, tmp_path, monkeypatch, experiment
):
    before = json.loads((done / "results.json").read_text())
    shutil.copytree(done, tmp_path / "cut")
    shutil.rmtree(tmp_path / "cut" / "networks" / "regressor-translated-1-seed3")
    code, printed, _ = experiment("thesis_table", *words, tmp_path / "cut", "--json")
    assert code == 0 and json.loads(printed)["table"] == before["table"]
    monkeypatch.setattr("torch.optim.AdamW.step", lambda *a, **k: pytest.fail("trained again"))
    code, printed, _ = experiment("thesis_table", *words, done, "--json")
    assert code == 0 and json.loads(printed)["table"] == before["table"]
    code, _, err = experiment("thesis_table", *words, done, "--iterations", 4)
    assert code == 2 and "holds a run with other iterations" in err


def test_rows_with_resynthesis(nmnist, moving, tmp_path, experiment):
    """Motions are made once for both seeds, and counted in the results."""
    words = ["--rows", "raw-moved", "--trained-on", "confounded", "--seeds", 0, 1, "--out", tmp_path]
    words += ["--nmnist", nmnist, "--simulated", moving, "--iterations", 4, "--batch", 16, "--workers", 1]
    code, printed, _ = experiment("thesis_table", *words)
    record = json.loads((tmp_path / "results.json").read_text())
    assert code == 0 and "conf./all" in printed
    motions = record["rows"]["raw-moved"]["motions"]["confounded"]
    assert motions["windows"] == 40 == motions["with_path"] and motions["variations"] == 2  # no more than epochs
    assert record["table"]["raw-moved"]["confounded/sim"]["windows"] == 150
    assert sorted(record["validation"]) == [f"raw-moved-confounded-seed{s}" for s in (0, 1)]


def test_the_committed_table_is_that_of_the_code():
    record = results("table")
    assert record["rows"].keys() - ROWS.keys() == {"hats-translated"}  # measured when the stream still had HATS
    for name, row in record["rows"].items():
        if (of := ROWS.get(name)) is None:
            continue
        assert (of.config, asdict(of.augmentation), of.iterations) == (
            TNTConfig.from_dict(row["config"]),
            row["augmentation"],
            row["iterations"],
        ), name
    comparison = [row for row in ROWS.values() if row.group == "comparison"]
    assert len(comparison) == 24 and {row.name for row in comparison} <= set(record["table"])
    for row in comparison:
        columns = record["table"][row.name]
        assert {column.split("/")[0] for column in columns} == set(row.trained_on)
        assert all(len(part["seeds"]) == 5 for part in columns.values()), row.name
