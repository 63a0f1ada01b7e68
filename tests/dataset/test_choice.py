"""What `async-tnt train DATASET` chooses where no option says it: by the data, once, and the same every time."""

import json
import re

import numpy as np
import pytest
from dataset.gestures import write
from made import events_of

from async_tnt import TNTConfig
from async_tnt.cli import train_choice
from async_tnt.networks.loading import load_model
from async_tnt.training import choice
from async_tnt.training.choice import Candidate, Questions, Trial, choose, grids

ALL = Questions()


def tried_in(start, questions, score):
    """The names of the candidates tried for a short time, and of the best, for a made-up score."""
    names = []

    def try_out(candidate, steps):
        if steps == choice.STEPS:
            names.append(str(candidate))
        value = score(candidate)
        return None if value is None else Trial(candidate, steps, value, 0.0)

    return names, str(choose(start, questions, try_out)[-1].candidate)


def test_one_question_after_another_the_winner_goes_on():
    start = Candidate(TNTConfig(sensor=(120, 100)), "thesis")

    def score(candidate):
        config = candidate.config
        return (
            (config.polarity == "split")
            + 2 * (config.transform == "none" and config.representation == "volume")
            + (config.grid == (34, 28)) / 2
            + (candidate.network == "residual") / 4
            + candidate.mirror / 8
        )

    names, best = tried_in(start, ALL, score)
    assert best == "raw, split, 34x28, residual, mirrored"
    assert names[:3] == [f"raw, {polarity}, 60x50, residual" for polarity in ("signed", "unsigned", "split")]
    assert names[3:6] == [f"TNT, running, {polarity}, 60x50, residual" for polarity in ("signed", "unsigned", "split")]
    assert names[6:9] == [f"count, {polarity}, 60x50, residual" for polarity in ("signed", "unsigned", "split")]
    assert names[9:12] == [f"raw, split, 34x28, {network}" for network in ("residual", "thesis", "conv4")]
    assert names[12:] == [best]


def test_the_best_three_are_compared_again_after_more_steps():
    """The one that learns fastest need not learn most."""
    start = Candidate(TNTConfig(sensor=(34, 34), grid=(34, 34)), "thesis")
    first = {"signed": 0.5, "unsigned": 0.6, "split": 0.7}
    later = {"signed": 0.95, "unsigned": 0.9, "split": 0.8}

    def try_out(candidate, steps):
        transform, polarity = candidate.config.transform, candidate.config.polarity
        score = (first if steps == choice.STEPS else later)[polarity] - (transform == "none")
        return Trial(candidate, steps, score, 0.0)

    only = Questions(True, True, False, False, False)
    *others, third, second, best = choose(start, only, try_out)
    finals = [trial.candidate.config for trial in (third, second, best)]
    assert [config.polarity for config in finals] == ["split", "unsigned", "signed"]
    assert all(config.transform == "tnt" for config in finals)
    assert [trial.steps for trial in (third, second, best)] == 3 * [choice.FINAL_STEPS]
    assert len(others) == 6 and all(trial.steps == choice.STEPS for trial in others)
    assert best.to_dict()["steps"] == choice.FINAL_STEPS


def test_what_was_asked_for_is_not_a_question():
    start = Candidate(TNTConfig(sensor=(120, 100), landmark="center", polarity="unsigned", grid=(20, 20)), "mine.py:f")
    names, _ = tried_in(start, Questions(False, True, False, False, False), lambda c: 0.5)
    assert names == [f"TNT, center, {p}, 20x20, mine.py:f" for p in ("signed", "unsigned", "split")]
    only_grid = Questions(False, False, True, False, False)
    assert tried_in(start, only_grid, lambda c: c.config.grid == (60, 50))[1].endswith("unsigned, 60x50, mine.py:f")
    assert not Questions(False, False, False, False, False) and ALL


def test_what_cannot_be_trained_is_left_out():
    start = Candidate(TNTConfig(sensor=(34, 34)), "thesis")
    names, best = tried_in(start, ALL, lambda c: None if c.network == "conv4" or c.config.transform == "none" else 1.0)
    assert best.startswith("TNT") and len(names) == 12
    names, best = tried_in(start, ALL, lambda c: None if c.network == "residual" else len(c.config.polarity))
    assert len(names) == 9 + 9 + 1 + 1 and best == "count, unsigned, 34x34, conv4, mirrored"  # of equals, the last
    with pytest.raises(ValueError, match="none of the volumes and networks can be trained"):
        tried_in(start, ALL, lambda c: None)


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        ((34, 34), [(34, 34)]),
        ((40, 30), [(40, 30)]),
        ((50, 25), [(50, 25), (34, 17)]),
        ((1280, 720), [(60, 34), (34, 19)]),
        ((16, 640), [(8, 60), (8, 34)]),
        ((40, 3), [(40, 8)]),
    ],
)
def test_grids_have_the_shape_of_the_sensor(sensor, expected):
    assert list(grids(sensor)) == expected


def spot(rng, x, y, p):
    """Events about a place, of these polarities, on 24 x 24 pixels in 20 ms."""
    n = 120
    t = np.sort(rng.integers(0, 20_000, n))
    x, y = (np.clip(rng.normal(centre, 2, n).round(), 0, 23).astype(int) for centre in (x, y))
    return events_of(t, x, y, np.full(n, p))


def bar(rng, x, y, slope, p):
    n = 120
    along = rng.uniform(-5, 5, n)
    dx, dy = (along, rng.normal(0, 0.5, n)) if slope else (rng.normal(0, 0.5, n), along)
    x, y = (np.clip((centre + d).round(), 0, 23).astype(int) for centre, d in ((x, dx), (y, dy)))
    return events_of(np.sort(rng.integers(0, 20_000, n)), x, y, np.full(n, p))


def made_set(folder, kind):
    """Classes that differ in place, in polarity, or in shape. The latter two are held out at another place, shapes with
    the other polarity."""
    rng = np.random.default_rng(0)
    rows = ["recording,group"]
    for k in range(40):
        learned = k < 30
        for label in (0, 1):
            y = rng.uniform(6, 18)
            if kind == "place":
                events = spot(rng, 7 + 10 * label, y, k % 2)
            elif kind == "polarity":
                events = spot(rng, 6 if learned else 17, y, label)
            else:
                events = bar(rng, 6 if learned else 17, 6 + 12 * (k % 2), label, learned)
            name = f"{'ab'[label]}{k:02d}.npy"
            write(folder / "ab"[label] / name, events)
            rows.append(f"{name},{'learned' if learned else 'held out'}")
    if kind != "place":
        (folder / "groups.csv").write_text("\n".join(rows))
    return folder


WINNERS = {  # a different candidate wins each set
    "place": "raw|count",
    "polarity": "TNT, running, (signed|split)",
    "shape": "TNT, running, unsigned",
}


@pytest.mark.parametrize("kind", WINNERS)
def test_each_set_is_won_by_what_suits_it(tmp_path, program, monkeypatch, kind):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(choice, "STEPS", 60)
    monkeypatch.setattr(choice, "FINAL_STEPS", 80)
    monkeypatch.setattr(choice, "NETWORKS", ("thesis",))
    folder = made_set(tmp_path / kind, kind)
    words = ("train", folder, "--sensor", "24x24", "--epochs", 1, "--no-augmentation", "--seed", 0)
    code, _, err = program(*words)
    model = load_model("model.safetensors")
    assert code == 0, err
    assert "windows of 20000 us, as no recording is longer" in err and model.config.window_us == 20_000
    trials = {trial["tried"]: trial["accuracy"] for trial in model.record["data"]["choice"]}
    best = list(trials)[-1]
    assert len(trials) == 9 and f"chosen: {best}\n" in err and trials[best] >= 0.9
    assert re.match(WINNERS[kind], best), trials
    lost = {"place": "TNT", "polarity": "unsigned", "shape": "raw"}[kind]  # less by far, on average
    assert np.mean([accuracy for name, accuracy in trials.items() if lost in name]) < trials[best] - 0.1, trials
    assert model.config.grid == (24, 24)
    again = (tmp_path / "model.safetensors").read_bytes()
    code, _, err = program(*words, "--quick", "--run", tmp_path / "quick")
    assert code == 0 and "trying" not in err and not (tmp_path / "quick" / "choice.json").exists()
    (tmp_path / "model.safetensors").write_bytes(again)
    (tmp_path / "runs" / "model" / "choice-of-another-time").mkdir()
    code, _, err = program(*words)  # finished: neither chosen nor trained again
    assert not list((tmp_path / "runs" / "model").glob("choice-*"))
    assert code == 0 and "chosen" not in err and (tmp_path / "model.safetensors").read_bytes() == again


def test_an_interrupted_choice_goes_on_and_ends_with_the_same_model(tmp_path, program, monkeypatch):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    monkeypatch.setattr(choice, "STEPS", 10)
    monkeypatch.setattr(choice, "FINAL_STEPS", 20)
    monkeypatch.setattr(choice, "NETWORKS", ("thesis",))
    folder = made_set(tmp_path / "set", "place")
    words = ("train", folder, "--sensor", "24x24", "--epochs", 1, "--polarity", "signed")
    models = []
    for stop in (False, True):
        run = tmp_path / f"run {stop}"
        out = tmp_path / f"{stop}.safetensors"
        if stop:
            with monkeypatch.context() as interrupted:
                interrupted.setattr(train_choice, "Trial", interrupt_at_second())
                assert program(*words, "--out", out, "--run", run)[0] == 130
            assert list(run.glob("choice-*/*/checkpoint.pt"))
        code, _, err = program(*words, "--out", out, "--run", run)
        assert code == 0 and not list(run.glob("choice-*")), err
        models.append(load_model(out))
    assert models[0].weights.keys() == models[1].weights.keys()
    for name, w in models[0].weights.items():
        np.testing.assert_array_equal(w, models[1].weights[name])
    others = (
        ["--polarity", "unsigned"],
        ["--partial", 0.5],
        ["--landmark", "running"],
        ["--quick"],
        ["--window-us", 100_000],
        ["--sensor", "30x30"],
    )
    for other in others:  # one that is chosen or trained otherwise is another run
        code, _, err = program(*words, *other, "--out", out, "--run", tmp_path / "run False")
        assert code == 2 and "holds a run with other" in err, other
    (folder / "a" / "a00.npy").rename(folder / "a" / "new.npy")
    code, _, err = program(*words, "--out", out, "--run", tmp_path / "run False")
    assert code == 2 and "recordings (a/new.npy is new" in err
    (folder / "a" / "new.npy").rename(folder / "a" / "a00.npy")
    (folder / "groups.csv").write_text("recording,group\na/a00.npy,x\n")
    code, _, err = program(*words, "--out", out, "--run", tmp_path / "run False")
    assert code == 2 and "holds a run with other groups (None, now groups.csv " in err
    (folder / "groups.csv").unlink()
    damaged = tmp_path / "run True" / "choice.json"
    assert [trial["tried"] for trial in json.loads(damaged.read_text())["trials"]] == [
        trial["tried"] for trial in models[0].record["data"]["choice"]
    ]
    for content in ("{", "[]", "{}"):
        damaged.write_text(content)
        code, _, err = program(*words, "--out", out, "--run", run)
        assert code == 2 and "choice.json: damaged" in err and err.count("\n") == 1


def test_where_nothing_is_held_out_the_defaults_are_taken(tmp_path, program):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    rng = np.random.default_rng(0)
    for label in "ab":
        write(tmp_path / "set" / label / "one.npy", spot(rng, 7, 12, 1))
    words = ("--sensor", "24x24", "--epochs", 1, "--out", tmp_path / "m.safetensors", "--run", tmp_path / "run")
    code, _, err = program("train", tmp_path / "set", *words)
    assert code == 0 and "takes its default" in err and "chosen" not in err
    code, _, err = program("train", tmp_path / "set", *words)
    assert code == 0 and "takes its default" not in err  # the same run, finished
    write(tmp_path / "set" / "a" / "two.npy", spot(rng, 7, 12, 1))
    more = ("--validation", 0, "--run", tmp_path / "another")
    code, _, err = program("train", tmp_path / "set", *words, *more)
    assert code == 0 and "takes its default" in err and "chosen" not in err


def interrupt_at_second():
    n = 0

    def trial(*values):
        nonlocal n
        n += 1
        if n == 2:
            raise KeyboardInterrupt
        return Trial(*values)

    return trial


def test_options_that_belong_to_others(program, tmp_path):
    code, _, err = program("train", "--nmnist", tmp_path, "--quick")
    assert code == 2 and "--quick must come with DATASET" in err
