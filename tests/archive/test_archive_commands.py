"""`async-tnt run --out` and `evaluate --out`: killed, interrupted, on several workers, and on a cluster."""

import json
import signal

import numpy as np
import pytest

from async_tnt.archive.collect import journal_of

TIMES = {"seconds", "decisions_per_second", "events_per_second"}


def report_of(printed):
    return {name: value for name, value in json.loads(printed).items() if name not in TIMES}


@pytest.fixture(scope="module")
def few(samples, tmp_path_factory):
    """Two recordings of each digit."""
    folder = tmp_path_factory.mktemp("few") / "digits"
    for path in samples.glob("*/0[01].bin"):
        (folder / path.parent.name).mkdir(parents=True, exist_ok=True)
        (folder / path.parent.name / path.name).write_bytes(path.read_bytes())
    return folder


@pytest.fixture(scope="module")
def plain(samples, tmp_path_factory):
    """Result file and report of an evaluation that nothing has disturbed."""
    from contextlib import redirect_stdout
    from io import StringIO

    from async_tnt.cli import main

    out = tmp_path_factory.mktemp("plain") / "plain.jsonl"
    with redirect_stdout(StringIO()) as printed:
        assert main(["evaluate", "digits", str(samples), "--out", str(out), "--json"]) == 0
    return out, report_of(printed.getvalue())


def check_same(out, plain, printed):
    expected, report = plain
    assert out.read_bytes() == expected.read_bytes() and report_of(printed) == report
    names = [json.loads(line)["recording"] for line in out.read_text().splitlines()]
    assert names == sorted(set(names)) and len(names) == 300


@pytest.mark.parametrize("where", ["here", "workers", "dask"])
def test_killed_in_the_middle_a_rerun_ends_with_the_same(
    where, samples, plain, tmp_path, program, start, wait_for_lines, request
):
    places = {"here": (), "workers": ("--workers", 2)}
    place = places[where] if where in places else ("--dask", request.getfixturevalue("cluster"))
    out = tmp_path / "r.jsonl"
    words = "evaluate", "digits", samples, "--out", out, "--json", *place
    process = start(*words)
    wait_for_lines(journal_of(out), 10, process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    n_before = journal_of(out).read_bytes().count(b"\n") - 1
    assert not out.exists() and 9 <= n_before < 300
    code, printed, told = program(*words)
    assert code == 0 and f"{n_before} of 300 recordings are done, going on" in told
    assert not journal_of(out).exists()
    check_same(out, plain, printed)


def test_interrupted_it_says_what_is_done(samples, plain, tmp_path, program, start, wait_for_lines):
    out = tmp_path / "r.jsonl"
    words = "evaluate", "digits", samples, "--out", out, "--json", "--workers", 2
    process = start(*words)
    wait_for_lines(journal_of(out), 10, process)
    process.send_signal(signal.SIGINT)
    printed, told = process.communicate(timeout=30)
    assert process.returncode == 130 and printed == "" and told.count("\n") == 1
    assert "interrupted: " in told and "of 300 recordings are done; the same command goes on" in told
    code, printed, _ = program(*words)
    assert code == 0
    check_same(out, plain, printed)


def test_a_second_program_is_refused(samples, tmp_path, program, start, wait_for_lines):
    out = tmp_path / "r.jsonl"
    process = start("evaluate", "digits", samples, "--out", out)
    wait_for_lines(journal_of(out), 3, process)
    process.send_signal(signal.SIGSTOP)
    code, _, told = program("evaluate", "digits", samples, "--out", out)
    assert (
        code == 2
        and told == f"async-tnt: {out}: another program is writing it; wait for that one, or give another --out\n"
    )


def test_evaluate_reports_the_same_with_a_file_and_without(few, tmp_path, program):
    pytest.importorskip("pyarrow", reason="Parquet needs pyarrow (extra `cluster`)")
    reports = [
        report_of(program("evaluate", "digits", few, "--json", *words)[1])
        for words in (
            (),
            ("--workers", 2),
            ("--out", tmp_path / "r.jsonl"),
            ("--out", tmp_path / "r.parquet"),
            ("--out", tmp_path / "r.parquet"),
        )
    ]
    assert all(report == reports[0] for report in reports) and reports[0]["recordings"] == 20
    again = json.loads(program("evaluate", "digits", few, "--json", "--out", tmp_path / "r.jsonl")[1])
    assert [again[name] for name in TIMES] == [None] * 3
    assert "all streamed by an earlier run" in program("evaluate", "digits", few, "--out", tmp_path / "r.jsonl")[1]


def test_run_writes_the_decisions_that_run_prints(few, tmp_path, program):
    settings = "--every-us", 5000, "--hop-us", 40_000, "--confidence", 0.9
    code, printed, told = program("run", few, "--out", tmp_path / "r.jsonl", "--workers", 2, *settings)
    assert code == 0 and told == "" and "20 recordings" in printed
    records = [json.loads(line) for line in (tmp_path / "r.jsonl").read_text().splitlines()]
    assert len(records) == 20
    _, lines, _ = program("run", *sorted(few.glob("*/*")), "--json", *settings)
    expected: dict = {}
    for line in map(json.loads, lines.splitlines()):
        del line["latency_us"]
        expected.setdefault(line.pop("recording"), []).append(line)
    assert {record["recording"]: record["decisions"] for record in records} == expected
    for record in records:
        closed = [d["probabilities"] for d in record["decisions"] if d["complete"] or d["trigger"] == "end"]
        np.testing.assert_allclose(record["probabilities"], np.mean(closed, axis=0), atol=2e-6)
        assert record["windows"] == len(closed) and record["label"] == str(np.argmax(record["probabilities"]))


def test_run_to_parquet_here_and_on_workers_is_the_same_file(few, tmp_path, program):
    parquet = pytest.importorskip("pyarrow.parquet", reason="Parquet needs pyarrow (extra `cluster`)")
    for name, words in (("a", ()), ("b", ("--workers", 2))):
        assert program("run", few, "--out", tmp_path / f"{name}.parquet", *words)[0] == 0
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.num_rows == 20 and table["label"].to_pylist() == [path.parent.name for path in sorted(few.glob("*/*"))]


def test_damaged_recordings_are_named_and_kept_as_errors(few, tmp_path, program):
    import shutil

    folder = shutil.copytree(few, tmp_path / "set")
    (folder / "3" / "torn.npz").write_bytes(b"PK torn")
    (folder / "4" / "empty.bin").write_bytes(b"")
    out = tmp_path / "r.jsonl"
    code, printed, told = program("run", folder, "--out", out, "--workers", 2)
    assert code == 2 and told.count("\n") == 2 and "torn.npz" in told and "empty.bin" in told
    errors = {r["recording"]: r["error"] for r in map(json.loads, out.read_text().splitlines()) if r["error"]}
    assert errors.keys() == {str(folder / "3" / "torn.npz"), str(folder / "4" / "empty.bin")}
    assert "not a readable NumPy file" in errors[str(folder / "3" / "torn.npz")]
    report = json.loads(program("evaluate", "digits", folder, "--json", "--out", tmp_path / "e.jsonl")[1])
    assert report["recordings"] == 20 and len(report["skipped"]) == 2
    (folder / "3" / "torn.npz").unlink()
    shutil.copy(few / "4" / "00.bin", folder / "4" / "empty.bin")
    code, printed, told = program("run", folder, "--out", out)
    assert code == 0 and "1 recording is no longer there, and left out" in told and "21 recordings, " in printed


def test_the_summary_of_unreadable_recordings_counts_them_as_such(tmp_path, program):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "torn.npz").write_bytes(b"PK torn")
    out = tmp_path / "r.jsonl"
    code, printed, told = program("run", tmp_path / "set", "--out", out)
    first, second = printed.splitlines()
    assert code == 2 and first == f"{out}: 1 recording (1 of them with an error), 0 decisions, 0 events"
    assert second.startswith("1 recording streamed now, ")
    assert told.count("\n") == 1 and "torn.npz" in told


def test_another_dataset_or_folder_does_not_throw_results_away(few, tmp_path, program, monkeypatch):
    import shutil

    for name in ("a", "b", "c"):
        shutil.copytree(few, tmp_path / name / "set")
    for path in (tmp_path / "b").glob("set/*/*"):  # another dataset, where recordings are called the same
        path.write_bytes(path.read_bytes()[:-5])
    for path in (tmp_path / "c").glob("set/*/*"):
        path.rename(path.with_stem(f"c{path.stem}"))
    out = tmp_path / "r.jsonl"
    monkeypatch.chdir(tmp_path / "a")
    for words in (("evaluate", "digits", "set"), ("run", "set")):
        out.unlink(missing_ok=True)
        assert program(*words, "--out", out)[0] == 0
        before = out.read_bytes()
        for other in ("b", "c"):
            monkeypatch.chdir(tmp_path / other)
            code, _, told = program(*words, "--out", out)
            assert code == 2 and f"{out} holds 20 results, none of a recording as it is here: another folder's?" in told
            assert told.count("\n") == 1 and out.read_bytes() == before and not journal_of(out).exists()
        monkeypatch.chdir(tmp_path / "a")
        assert program(*words, "--out", out)[0] == 0 and out.read_bytes() == before
    monkeypatch.chdir(tmp_path / "b")
    assert program("run", "set", "--out", out, "--restart")[0] == 0 and out.read_bytes() != before


@pytest.mark.parametrize("words", [("evaluate", "digits", "set"), ("run", "set")])
def test_an_interrupted_run_is_not_gone_on_with_in_another_folder(words, few, tmp_path, program, monkeypatch):
    """Not even where all recordings look the same."""
    import shutil

    from async_tnt.archive import collect

    for name in ("a", "b"):
        shutil.copytree(few, tmp_path / name / "set", copy_function=shutil.copy2)
    out = tmp_path / "r.jsonl"

    def interrupt(*words, **named):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path / "a")
    with monkeypatch.context() as patched:
        patched.setattr(collect, "write_results", interrupt)
        code, _, told = program(*words, "--out", out)
        assert code == 130 and "interrupted: 20 of 20 recordings are done; the same command goes on" in told
    monkeypatch.chdir(tmp_path / "b")
    code, _, told = program(*words, "--out", out)
    folders = [tmp_path / name / "set" if words[0] == "evaluate" else tmp_path / name for name in ("a", "b")]
    assert code == 2 and f"was begun with folder {folders[0]} (now {folders[1]}): give the same" in told
    monkeypatch.chdir(tmp_path / "a")
    assert program(*words, "--out", out)[0] == 0 and out.exists()
    if words[0] == "run":  # by whole paths it does not matter where one is
        words = ("run", tmp_path / "a" / "set")
        with monkeypatch.context() as patched:
            patched.setattr(collect, "write_results", interrupt)
            assert program(*words, "--out", tmp_path / "s.jsonl")[0] == 130
        monkeypatch.chdir(tmp_path / "b")
        assert program(*words, "--out", tmp_path / "s.jsonl")[0] == 0


def test_late_events_are_counted_and_said(few, tmp_path, program):
    from async_tnt.sources.files.recording import open_recording

    events = open_recording(few / "3" / "00.bin").read()
    folder = tmp_path / "set" / "3"
    folder.mkdir(parents=True)
    late = events[[0, 1, 2]]
    np.save(folder / "late.npy", np.concatenate([events, late]))  # the first three again, long after their window
    for name, words in (("r", ("run", tmp_path / "set")), ("e", ("evaluate", "digits", tmp_path / "set"))):
        out = tmp_path / f"{name}.jsonl"
        for place in ((), ("--restart", "--workers", 1)):
            code, _, told = program(*words, "--out", out, *place)
            assert code == 0 and "3 events dropped: they came late" in told and f"`late` in {out}" in told
            assert json.loads(out.read_text())["late"] == 3
    report = json.loads(program("evaluate", "digits", tmp_path / "set", "--json")[1])
    assert report["late"] == 3 and report["events"] == len(events) + 3


def test_another_model_of_the_same_name_is_refused(few, tmp_path, program):
    from async_tnt import Model, load_model

    model = load_model("digits")
    model.save(tmp_path / "m.safetensors")
    words = "run", few, "--model", tmp_path / "m.safetensors", "--out", tmp_path / "r.jsonl"
    assert program(*words)[0] == 0
    Model(model.config, model.weights, model.classes, {"other": "record"}).save(tmp_path / "m.safetensors")
    assert program(*words)[0] == 0  # the training record changes no decision
    weights = {**model.weights, "fc2.bias": model.weights["fc2.bias"] + np.float32(1)}
    Model(model.config, weights, model.classes).save(tmp_path / "m.safetensors")
    code, _, told = program(*words)
    assert code == 2 and "was made by another model, window, trigger, engine" in told and told.count("\n") == 1
    assert program(*words, "--restart")[0] == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("run", "SET", "--workers", 2), "--workers belongs to --out"),
        (("run", "SET", "--dask", "tcp://a:1"), "--dask belongs to --out"),
        (("run", "SET", "--out", "r.jsonl", "--workers", 2, "--dask", "tcp://a:1"), "give one of them"),
        (("run", "SET", "--out", "r.csv"), "--out must end in .jsonl, .parquet, got r.csv"),
        (("run", "SET", "--out", "nowhere/r.jsonl"), "no folder nowhere to write r.jsonl to"),
        (("run", "SET", "--out", "r.jsonl", "--json"), "--json does not go with --out"),
        (("run", "SET", "--out", "r.jsonl", "--speed", 2), "--speed does not go with --out"),
        (("run", "udp://127.0.0.1:1", "--out", "r.jsonl"), "--out takes recordings and folders of them, got udp"),
        (("run", "none", "--out", "r.jsonl"), "no file or folder none"),
        (("run", "EMPTY", "--out", "r.jsonl"), "no recordings in this folder"),
        (("run", "SET", "--out", "r.jsonl", "--dask", "somewhere"), "--dask somewhere: no host and port"),
        (("evaluate", "digits", "SET", "--restart"), "--restart belongs to --out"),
        (("evaluate", "digits", "SET", "--workers", 2, "--dask", "tcp://a:1"), "give one of them"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(words, text, few, tmp_path, program, monkeypatch):
    if "--dask" in words and "somewhere" in words:
        pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    words = [{"SET": few, "EMPTY": tmp_path / "empty"}.get(word, word) for word in words]
    code, printed, told = program(*words)
    assert code == 2 and text in told and told.count("\n") == 1 and printed == "", told
    assert not list(tmp_path.glob("r.*"))


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("pyarrow", ("--out", "r.parquet")),
        ("distributed", ("--out", "r.jsonl", "--dask", "tcp://127.0.0.1:9")),
    ],
)
def test_a_missing_library_names_the_extra(module, words, few, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, module, None)
    code, _, told = program("run", few, *words)
    assert code == 2 and "pip install '.[cluster]'" in told and told.count("\n") == 1
    assert not list(tmp_path.glob("r.*"))
