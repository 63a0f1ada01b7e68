"""The thesis' table: what is compared, the numbers brought together, and its command."""

import itertools
import json
import shutil
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from experiments.digit_data.small_sets import write_small_mnist

torch = pytest.importorskip("torch")

from scipy import stats  # noqa: E402

from async_tnt import Processor, TNTConfig, load_model  # noqa: E402
from async_tnt.training.recordings import Recordings  # noqa: E402
from async_tnt.training.windows import Windows  # noqa: E402
from async_tnt.volume.events import structured  # noqa: E402
from experiments import thesis_table  # noqa: E402
from experiments.motions.versions import VERSIONS  # noqa: E402
from experiments.moving_set.build import open_set  # noqa: E402
from experiments.records.files import problem_of, read_json, read_numbers  # noqa: E402
from experiments.thesis.data import (  # noqa: E402
    RealFolder,
    saccade,
    scaled,
    shown_test_images,
    trained_on,
)
from experiments.thesis.factors import FACTORS, effects  # noqa: E402
from experiments.thesis.numbers import (  # noqa: E402
    aggregate,
    differences,
    interval,
    markdown_table,
    networks_of,
)
from experiments.thesis.right import packed, unpacked  # noqa: E402
from experiments.thesis.rows import CONTROLS, QUESTIONS, ROWS, SETS, Run  # noqa: E402
from experiments.thesis.table import recorded_networks  # noqa: E402
from experiments.thesis.versions import with_versions  # noqa: E402

CONTROL_ROWS = {f"raw-{name}" for name in CONTROLS}


@pytest.fixture(scope="module")
def mnist(tmp_path_factory):
    """45 images."""
    return write_small_mnist(tmp_path_factory.mktemp("MNIST"), 45)


def test_pairs_that_are_compared_differ_in_one_thing():
    compared = list(itertools.chain.from_iterable(QUESTIONS.values()))
    assert set(itertools.chain.from_iterable(compared)) <= set(ROWS)
    for row, against in compared:
        a = ROWS[row]
        b = ROWS[against]
        assert a.iterations == b.iterations
        if a.config.representation != "volume":  # another input: no transform, and split
            assert (a.augmentation, a.config.transform) == (b.augmentation, "none")
            continue
        if against == "thesis-baseline":  # the thesis itself moves the windows of one row
            assert a.config.t_max == 8 and (a.augmentation == b.augmentation) == (
                row == "thesis-tnt"
            )
            continue
        differ = [
            a.augmentation != b.augmentation,
            a.config.polarity != b.config.polarity,
            a.config.t_max != b.config.t_max and row.split("-")[0] == against.split("-")[0],
            a.config.replace(polarity="signed", t_max=2)
            != b.config.replace(polarity="signed", t_max=2),
            a.motions != b.motions,
            a.versions != b.versions,
        ]
        # all cheap ways together, and re-synthesis against each of them, differ in more
        is_control = against in CONTROL_ROWS or row == "raw-all-ways"
        assert sum(differ) == 1 or is_control, (row, against)


def test_images_seen_in_training_are_read_from_the_names():
    names = [
        "3/00001.bin",
        "3/60000.bin",
        "7/60001.bin",
        "7/60026.bin",
        "1/70000.bin",
        "1/other.bin",
        "1/70001.bin",
    ]
    assert shown_test_images(names).tolist() == [0, 25, 9999]


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
            column.replace("__", " ").replace("_", "/"): {
                "accuracy": a,
                "windows": 4,
                "per_motion": {"saccade 1": a, "saccade 2": a / 2},
                "against_time_ms": {},
            }
            for column, a in accuracies.items()
        }
        return {"row": row, "seed": seed, "columns": columns}

    runs = [
        run("thesis-tnt", 0, all_all=0.96, all_centre__bright=0.6, all_bell=0.5),
        run("raw", 1, all_all=1.0),
        run("raw", 0, all_all=0.98),
        run("raw-translated", 0, all_all=0.94),
        run("raw-translated", 1, all_all=0.98),
    ]
    table = aggregate(runs)
    assert list(table) == ["thesis-tnt", "raw", "raw-translated"]
    assert list(table["thesis-tnt"]) == ["all/all", "all/bell", "all/centre bright"]
    part = table["raw"]["all/all"]
    assert part["mean"] == pytest.approx(0.99) and part["deviation"] == pytest.approx(0.01 * 2**0.5)
    assert part["seeds"] == {"0": 0.98, "1": 1.0}
    assert part["per_motion"]["saccade 2"] == pytest.approx(0.495)
    assert table["thesis-tnt"]["all/bell"]["deviation"] is None
    assert markdown_table(table, ["comparison"]).splitlines()[2] == "| raw | .990 ± .014 |"
    assert (
        markdown_table(table, ["comparison"], with_networks=True).splitlines()[2]
        == "| raw | 2 | .990 ± .014 |"
    )
    assert networks_of({**table["raw"], "1/all": {"seeds": {"0": 0.4}}}) == "2 (all), 1 (1)"
    assert (
        markdown_table(table, ["thesis"]).splitlines()[2]
        == "| TNT | .960 (.981) | .500 | .600 (.592) |"
    )


def test_an_interval_by_hand():
    """Two seeds with means .2 and .4, and two digits with means .1 and .5.

    So the variances are .02 / 2 and .08 / 2.
    """
    found = interval(np.array([[0.0, 0.4], [0.2, 0.6]]))
    freedom = 0.05**2 / (0.01**2 + 0.04**2)
    half = stats.t.ppf(0.975, freedom) * 0.05**0.5
    assert [found[name] for name in ("mean", "low", "high")] == pytest.approx(
        [0.3, 0.3 - half, 0.3 + half]
    )
    assert found["p"] == pytest.approx(2 * stats.t.sf(0.3 / 0.05**0.5, freedom))
    assert interval(np.zeros((2, 3)))["p"] == 1 and interval(np.ones((2, 3)))["p"] == 0


def test_an_interval_holds_the_truth_in_19_of_20_cases():
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(400):
        values = (
            0.1
            + rng.normal(0, 0.02, (5, 1))
            + rng.normal(0, 0.2, (1, 100))
            + rng.normal(0, 0.2, (5, 100))
        )
        found = interval(values)
        held += found["low"] <= 0.1 <= found["high"]
    assert 0.92 < held / 400 < 0.985


def test_differences_are_taken_digit_by_digit_and_adjusted_within_their_question():
    """Two motions of three digits, one of which has no window in one motion."""
    better = np.array([[1, 1, 1], [1, 0, -1]], np.int8)
    worse = np.array([[0, 1, 0], [0, 0, -1]], np.int8)
    right = {
        (row, "all/sim"): {seed: of for seed in range(3)}
        for row, of in (
            ("thesis-tnt", better),
            ("thesis-baseline", worse),
            ("thesis-regress", worse),
            ("raw", worse),
        )
    }
    tnt, regress = differences(right)
    assert (tnt["row"], tnt["against"], tnt["column"], tnt["seeds"]) == (
        "thesis-tnt",
        "thesis-baseline",
        "all/sim",
        3,
    )
    assert tnt["mean"] == pytest.approx((1 + 0 + 1) / 3)  # 1, 1/2, 1 against 0, 1/2, 0
    assert (regress["mean"], regress["p"]) == (0, 1) and tnt["holm"] == pytest.approx(2 * tnt["p"])


def test_effects_of_factors_by_hand():
    """TNT gains .2 on bright digits, .1 from the centre, and nothing else.

    Where digits are bright and start from the centre, it gains .3, and then .4.
    """
    for together in (0.0, 0.1):
        right = {}
        rng = np.random.default_rng(0)
        for name, (kind, dark) in SETS.items():
            gain = (
                0.2 * (not dark)
                + 0.1 * kind.endswith("from-centre")
                + together * (not dark and "from" in kind)
            )
            for seed in range(3):
                base = rng.random((30, 2_000)) < 0.4
                right.setdefault(("thesis-baseline", f"all/{name}"), {})[seed] = base.astype(
                    np.int8
                )
                gained = base | (rng.random(base.shape) < gain / 0.6)
                right.setdefault(("thesis-tnt", f"all/{name}"), {})[seed] = gained.astype(np.int8)
        found = {effect["effect"]: effect for effect in effects(right)}
        bright, centre = list(FACTORS)[:2]
        expected = dict.fromkeys(found, 0.0) | {
            "mean": 0.15 + together / 4,
            f"{bright} and {centre}": together / 2,
        }
        expected |= {bright: 0.2 + together / 2, centre: 0.1 + together / 2}
        for name, effect in found.items():
            assert effect["mean"] == pytest.approx(expected[name], abs=0.005), name
            assert (effect["holm"] < 0.05) == (abs(expected[name]) > 0), name


def test_time_runs_from_the_first_event_to_the_last(nmnist):
    windows = RealFolder(nmnist, validation=0.25).read().test
    window_us = TNTConfig().window_us
    scaled_windows = scaled(windows)
    assert scaled_windows.labels.tolist() == windows.labels.tolist()
    for i in (0, 7, 29):
        t, *others = windows.events(i, window_us)
        scaled_t, *scaled_others = scaled_windows.events(i, window_us)
        assert (scaled_t[0], scaled_t[-1]) == (0, window_us - 1)
        expected = (t - t[0]) / (t[-1] - t[0]) * (window_us - 1)
        np.testing.assert_allclose(scaled_t, expected, atol=1)  # whole microseconds
        for column, scaled_column in zip(others, scaled_others, strict=True):
            np.testing.assert_array_equal(column, scaled_column)


@pytest.fixture(scope="module")
def words(nmnist, mnist):
    """A small table of two rows."""
    words = [
        "--nmnist",
        nmnist,
        "--mnist",
        mnist,
        "--images",
        2,
        "--rows",
        "raw",
        "thesis-regress",
        "--seeds",
        3,
    ]
    return [*words, "--iterations", 3, "--batch", 16, "--workers", 1, "--out"]


@pytest.fixture(scope="module")
def done(words, tmp_path_factory):
    out = tmp_path_factory.mktemp("table")
    assert thesis_table.main([*map(str, words), str(out)]) == 0
    return out


def test_results_record_what_was_done(done):
    record = json.loads((done / "results.json").read_text())
    assert set(record["table"]) == {"thesis-regress", "raw"}
    for columns in record["table"].values():
        assert list(columns)[:6] == ["all/all", "1/all", "1/others", "1/train", "all/sim", "1/sim"]
        assert list(columns)[6:] == [
            f"{on}/{name}" for name in list(SETS)[1:] for on in ("all", "1")
        ]
        sizes = [columns[c]["windows"] for c in columns]
        # The tests have 40 recordings, and 2 images that no recording shows.
        assert sizes == [30, 30, 20, 120, *[60] * 18]
        assert [len(columns[c]["per_motion"]) for c in columns] == [3, 3, 2, 3, 30, 30, *[0] * 16]
    raw = record["table"]["raw"]
    assert list(raw["1/sim"]["against_time_ms"]) == ["10", "20", "30", "50", "75"]
    network = read_json(done / "networks" / "raw-1-seed3" / "result.json")
    assert network["run"]["command"].startswith("python -m experiments.thesis_table")
    assert network["run"]["machine"]["cores"] > 0
    # this checkout may have changes
    assert problem_of(network) in ("", "it was made by code that was not committed")
    assert network["numbers"]["settings"]["iterations"] == 3
    assert network["numbers"]["data"]["test_recordings"] == 10
    assert str(done) not in json.dumps(network["numbers"])
    assert "| raw |" in (done / "table.md").read_text()


def test_the_numbers_are_those_of_the_networks_beside_them(done):
    """The windows are counted once more, recording by recording.

    This uses the stream's own volumes and the compiled network.
    """
    model = load_model(done / "networks" / Run("raw", "1", 3).name / "model.safetensors")
    processor = Processor(model, start_us=0)
    right = []
    early = []
    for shard in open_set(done / "simulated" / "sim"):
        for i in range(len(shard)):
            events = shard.recording(i)
            for part, counted in ((events, right), (events[events["t"] < 30_000], early)):
                processor.reset()
                processor.push(part)
                counted.append(processor.fire().index == shard.labels[i])
    found = json.loads((done / "results.json").read_text())["table"]["raw"]["1/sim"]
    assert np.mean(right) == pytest.approx(found["mean"])
    assert np.mean(early) == pytest.approx(found["against_time_ms"]["30"], abs=1e-5)


def test_given_again_it_trains_what_is_missing_and_refuses_other_settings(
    done, words, tmp_path, monkeypatch, experiment
):
    before = json.loads((done / "results.json").read_text())
    shutil.copytree(done, tmp_path / "cut")
    shutil.rmtree(tmp_path / "cut" / "networks" / "thesis-regress-1-seed3")
    code, printed, _ = experiment("thesis_table", *words, tmp_path / "cut", "--json")
    assert code == 0 and json.loads(printed)["table"] == before["table"]
    monkeypatch.setattr("torch.optim.AdamW.step", lambda *a, **k: pytest.fail("trained again"))
    code, printed, _ = experiment("thesis_table", *words, done, "--json")
    assert code == 0 and json.loads(printed)["table"] == before["table"]
    code, _, err = experiment("thesis_table", *words, done, "--iterations", 4)
    assert code == 2 and "holds a run with other iterations" in err


def test_rows_with_resynthesis(nmnist, mnist, tmp_path, experiment):
    """Motions are made once for both seeds, and counted in the results."""
    words = ["--rows", "raw-motions", "running-t3", "--trained-on", "1", "--seeds", 0, 1]
    words += ["--nmnist", nmnist, "--mnist", mnist, "--images", 2, "--iterations", 4]
    words += ["--batch", 16, "--workers", 1, "--out", tmp_path, "--into", tmp_path / "into"]
    code, printed, _ = experiment("thesis_table", *words)
    assert code == 0 and "1/all" in printed
    names = sorted(path.stem for path in (tmp_path / "into").iterdir())
    assert names == [f"{row}-1-seed{k}" for row in ("raw-motions", "running-t3") for k in (0, 1)]
    moved = read_numbers(tmp_path / "into" / "raw-motions-1-seed1.json")
    # no more than epochs
    assert moved["motions"]["windows"] == 40 == moved["motions"]["with_path"]
    assert moved["motions"]["variations"] == 2
    assert moved["columns"]["1/sim"]["windows"] == 60
    validated = read_numbers(tmp_path / "into" / "running-t3-1-seed0.json")
    assert validated["columns"] == {} and validated["history"]


def test_versions_of_windows_by_hand():
    recordings = Recordings.from_events(
        [structured([[0, 10, 99, 100], [1, 2, 3, 4], [0, 5, 9, 9], [0, 1, 1, 0]])], [7], ["a"]
    )
    windows = Windows(recordings, np.array([0]), np.array([0]))
    versions = with_versions(windows, ("flipped y", "reversed"), (8, 10), 100)
    assert versions.labels.tolist() == [7] * 4 and len(versions) == 4
    seen = [[column.tolist() for column in versions.events(i, 100)] for i in range(4)]
    recorded = [[0, 10, 99], [1, 2, 3], [0, 5, 9], [0, 1, 1]]
    backwards = [[0, 89, 99], [3, 2, 1], [9, 5, 0], [0, 0, 1]]
    flipped = [[0, 10, 99], [1, 2, 3], [9, 4, 0], [0, 1, 1]]
    both = [[0, 89, 99], [3, 2, 1], [0, 4, 9], [0, 0, 1]]
    assert seen == [recorded, backwards, flipped, both]
    assert len(with_versions(windows, VERSIONS, (8, 10), 100)) == 8
    both_axes = with_versions(windows, ("flipped x and y",), (8, 10), 100).events(1, 100)
    assert [column.tolist() for column in both_axes[1:3]] == [[6, 5, 4], [9, 4, 0]]


@settings(max_examples=50)
@given(arrays(np.int8, array_shapes(min_dims=2, max_dims=2), elements=st.integers(-1, 1)))
def test_which_windows_were_right_comes_back_from_its_text(right):
    text = json.loads(json.dumps(packed(right)))
    np.testing.assert_array_equal(unpacked(text), right)
    assert ("windows" in text) == bool((right < 0).any())


def test_the_recorded_networks_are_those_of_the_code():
    for network in recorded_networks():
        row = ROWS[network["row"]]
        assert network["trained_on"] in row.trained_on
        assert TNTConfig.from_dict(network["config"]) == row.config
        assert network["settings"]["augmentation"] == asdict(row.augmentation)
        assert network["settings"]["iterations"] == row.iterations
        assert (tuple(network["versions"]), network["is_scaled"]) == (row.versions, row.is_scaled)
        tested = {column.split("/")[0] for column in network["columns"]}
        assert tested == ({network["trained_on"]} if row.is_tested else set())
