"""`async-tnt run --out` and `evaluate --out`: what they write and print, also after an interruption."""

import json
import os
import shutil
import signal

import numpy as np
import pytest

TIMES = {"seconds", "decisions_per_second", "events_per_second"}


def report_of(printed):
    return {name: value for name, value in json.loads(printed).items() if name not in TIMES}


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("workers", [1, 2])
def test_ended_in_the_middle_the_same_command_resumes(workers, number, samples, tmp_path, program, start, wait_until):
    folder, out = shutil.copytree(samples, tmp_path / "set", copy_function=shutil.copy2), tmp_path / "r.jsonl"
    shutil.copy2(samples / "4" / "00.bin", folder / "9" / "zz.bin")  # evaluating it takes until the signal
    code = (
        "import sys; from archive.made_work import evaluate_or_sleep; from async_tnt.cli import evaluate, main\n"
        "evaluate.evaluate_recording = evaluate_or_sleep; sys.exit(main())"
    )
    words = "evaluate", "digits", folder, "--json", "--workers", workers, "--out"
    process = start("-c", code, *words, out)
    wait_until(lambda: process.poll() is not None or (out.exists() and out.read_bytes().count(b"\n") >= 20))
    process.send_signal(number)
    printed, message = process.communicate()
    assert printed == "" and out.read_bytes().count(b"\n") == 20
    if number == signal.SIGKILL:
        assert process.returncode == -number and "Traceback" not in message
    else:
        line = "async-tnt: interrupted: 20 of 21 recordings are done; the same command resumes\n"
        assert process.returncode == 128 + number and message == line
    code, printed, message = program(*words, out)
    assert code == 0 and f"{out}: 20 of 21 recordings are done, resuming" in message
    assert report_of(printed) == report_of(program(*words, tmp_path / "plain.jsonl")[1])
    assert out.read_bytes() == (tmp_path / "plain.jsonl").read_bytes()


def test_evaluate_reports_the_same_with_a_file_and_without(samples, tmp_path, program):
    pytest.importorskip("pyarrow", reason="Parquet needs pyarrow (extra `cluster`)")
    reports = [
        report_of(program("evaluate", "digits", samples, "--json", *words)[1])
        for words in (
            (),
            ("--workers", 2),
            ("--out", tmp_path / "r.jsonl"),
            ("--out", tmp_path / "r.parquet"),
            ("--out", tmp_path / "r.parquet"),
        )
    ]
    assert all(report == reports[0] for report in reports) and reports[0]["recordings"] == 20
    again = json.loads(program("evaluate", "digits", samples, "--json", "--out", tmp_path / "r.jsonl")[1])
    assert [again[name] for name in TIMES] == [None] * 3
    assert "all streamed by an earlier run" in program("evaluate", "digits", samples, "--out", tmp_path / "r.jsonl")[1]


def test_run_writes_the_decisions_that_run_prints(samples, tmp_path, program):
    settings = "--every-us", 5000, "--hop-us", 40_000, "--confidence", 0.9
    code, printed, message = program("run", samples, "--out", tmp_path / "r.jsonl", "--workers", 2, *settings)
    assert code == 0 and message == "" and "20 recordings" in printed
    records = [json.loads(line) for line in (tmp_path / "r.jsonl").read_text().splitlines()]
    assert len(records) == 20
    _, lines, _ = program("run", *sorted(samples.glob("*/*")), "--json", *settings)
    expected: dict = {}
    for line in map(json.loads, lines.splitlines()):
        del line["latency_us"]
        expected.setdefault(line.pop("recording"), []).append(line)
    assert {record["recording"]: record["decisions"] for record in records} == expected
    for record in records:
        closed = [d["probabilities"] for d in record["decisions"] if d["complete"] or d["trigger"] == "end"]
        np.testing.assert_allclose(record["probabilities"], np.mean(closed, axis=0), atol=2e-6)
        assert record["windows"] == len(closed) and record["label"] == str(np.argmax(record["probabilities"]))


def test_run_to_parquet_here_and_on_workers_is_the_same_file(samples, tmp_path, program):
    parquet = pytest.importorskip("pyarrow.parquet", reason="Parquet needs pyarrow (extra `cluster`)")
    for name, words in (("a", ()), ("b", ("--workers", 2))):
        assert program("run", samples, "--out", tmp_path / f"{name}.parquet", *words)[0] == 0
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.num_rows == 20 and table["label"].to_pylist() == [
        path.parent.name for path in sorted(samples.glob("*/*"))
    ]


def test_damaged_recordings_are_named_and_kept_as_errors(samples, tmp_path, program):
    folder = shutil.copytree(samples, tmp_path / "set")
    (folder / "3" / "torn.npz").write_bytes(b"PK torn")
    (folder / "4" / "empty.bin").write_bytes(b"")
    out = tmp_path / "r.jsonl"
    code, printed, message = program("run", folder, "--out", out, "--workers", 2)
    assert code == 2 and message.count("\n") == 2 and "torn.npz" in message and "empty.bin" in message
    errors = {r["recording"]: r["error"] for r in map(json.loads, out.read_text().splitlines()) if r["error"]}
    assert errors.keys() == {str(folder / "3" / "torn.npz"), str(folder / "4" / "empty.bin")}
    assert "not a readable NumPy file" in errors[str(folder / "3" / "torn.npz")]
    report = json.loads(program("evaluate", "digits", folder, "--json", "--out", tmp_path / "e.jsonl")[1])
    assert report["recordings"] == 20 and len(report["skipped"]) == 2
    (folder / "3" / "torn.npz").unlink()
    shutil.copy(samples / "4" / "00.bin", folder / "4" / "empty.bin")
    code, printed, message = program("run", folder, "--out", out)
    assert code == 0 and "1 recording no longer exists and is left out" in message and "21 recordings, " in printed


def test_the_summary_of_unreadable_recordings_counts_them_as_such(tmp_path, program):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "torn.npz").write_bytes(b"PK torn")
    out = tmp_path / "r.jsonl"
    code, printed, message = program("run", tmp_path / "set", "--out", out)
    first, second = printed.splitlines()
    assert code == 2 and first == f"{out}: 1 recording (1 of them with an error), 0 decisions, 0 events"
    assert second.startswith("1 recording streamed now, ")
    assert message.count("\n") == 1 and "torn.npz" in message


def test_another_dataset_or_folder_does_not_throw_results_away(samples, tmp_path, program, monkeypatch):
    for name in ("a", "b", "c"):
        shutil.copytree(samples, tmp_path / name / "set")
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
            code, _, message = program(*words, "--out", out)
            assert (
                code == 2
                and f"{out} holds 20 results, none of a recording as it is here: of another folder?" in message
            )
            assert message.count("\n") == 1 and out.read_bytes() == before
        monkeypatch.chdir(tmp_path / "a")
        assert program(*words, "--out", out)[0] == 0 and out.read_bytes() == before
    monkeypatch.chdir(tmp_path / "b")
    assert program("run", "set", "--out", out, "--restart")[0] == 0 and out.read_bytes() != before


def test_late_events_are_counted_and_said(samples, tmp_path, program):
    from async_tnt.sources.files.recording import open_recording

    events = open_recording(samples / "3" / "00.bin").read()
    folder = tmp_path / "set" / "3"
    folder.mkdir(parents=True)
    late = events[[0, 1, 2]]
    np.save(folder / "late.npy", np.concatenate([events, late]))  # the first three again, long after their window
    for name, words in (("r", ("run", tmp_path / "set")), ("e", ("evaluate", "digits", tmp_path / "set"))):
        out = tmp_path / f"{name}.jsonl"
        for place in ((), ("--restart", "--workers", 1)):
            code, _, message = program(*words, "--out", out, *place)
            assert code == 0 and "3 events dropped: they came late" in message and f"`late` in {out}" in message
            assert json.loads(out.read_text())["late"] == 3
    report = json.loads(program("evaluate", "digits", tmp_path / "set", "--json")[1])
    assert report["late"] == 3 and report["events"] == len(events) + 3


def test_another_model_of_the_same_name_is_refused(samples, tmp_path, program):
    from async_tnt import Model, load_model

    model = load_model("digits")
    model.save(tmp_path / "m.safetensors")
    words = "run", samples, "--model", tmp_path / "m.safetensors", "--out", tmp_path / "r.jsonl"
    assert program(*words)[0] == 0
    Model(model.config, model.weights, model.classes, {"other": "record"}).save(tmp_path / "m.safetensors")
    assert program(*words)[0] == 0  # the training record changes no decision
    weights = {**model.weights, "fc2.bias": model.weights["fc2.bias"] + np.float32(1)}
    Model(model.config, weights, model.classes).save(tmp_path / "m.safetensors")
    code, _, message = program(*words)
    assert code == 2 and "was made with another model, window, trigger, engine" in message and message.count("\n") == 1
    assert program(*words, "--restart")[0] == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("run", "SET", "--workers", 2), "--workers requires --out"),
        (("run", "SET", "--dask", "tcp://a:1"), "--dask requires --out"),
        (("run", "SET", "--out", "r.jsonl", "--workers", 2, "--dask", "tcp://a:1"), "give one of them"),
        (("run", "SET", "--out", "r.csv"), "--out must end in .jsonl, .parquet, got r.csv"),
        (("run", "SET", "--out", "nowhere/r.jsonl"), "no folder nowhere to write r.jsonl to"),
        (("run", "SET", "--out", "r.jsonl", "--json"), "--json does not go with --out"),
        (("run", "SET", "--out", "r.jsonl", "--speed", 2), "--speed does not go with --out"),
        (("run", "udp://127.0.0.1:1", "--out", "r.jsonl"), "--out takes recordings and folders of them, got udp"),
        (("run", "none", "--out", "r.jsonl"), "no file or folder none"),
        (("run", "EMPTY", "--out", "r.jsonl"), "no recordings in this folder"),
        (("run", "SET", "--out", "r.jsonl", "--dask", "somewhere"), "--dask somewhere: no host and port"),
        (("evaluate", "digits", "SET", "--restart"), "--restart requires --out"),
        (("evaluate", "digits", "SET", "--workers", 2, "--dask", "tcp://a:1"), "give one of them"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(words, text, samples, tmp_path, program, monkeypatch):
    if "--dask" in words and "somewhere" in words:
        pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    words = [{"SET": samples, "EMPTY": tmp_path / "empty"}.get(word, word) for word in words]
    code, printed, message = program(*words)
    assert code == 2 and text in message and message.count("\n") == 1 and printed == "", message
    assert not list(tmp_path.glob("r.*"))


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("pyarrow", ("--out", "r.parquet")),
        ("distributed", ("--out", "r.jsonl", "--dask", "tcp://127.0.0.1:9")),
    ],
)
def test_a_missing_library_names_the_extra(module, words, samples, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, module, None)
    code, _, message = program("run", samples, *words)
    assert code == 2 and "pip install '.[cluster]'" in message and message.count("\n") == 1
    assert not list(tmp_path.glob("r.*"))
