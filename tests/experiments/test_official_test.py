"""The official test of N-MNIST is all of its recordings, and a part is called a part."""

import json

import pytest

pytest.importorskip("torch", reason="the model is evaluated with torch (extra `train`)")

from async_tnt.sources.files.recording import sample_recordings
from experiments.digit_data import official
from experiments.digit_data.official import N_TEST, PER_DIGIT, missing_numbers, official_test
from experiments.records.files import read_numbers


def write_empty(folder, *names):
    """Write empty files."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def write_layout(folder, *, mixed):
    """Write empty files for the whole official set, but only 30 training recordings.

    mixed : every tenth test recording in Test, the others in Train, with numbers above 60,000.
    """
    number = 0
    for digit, n in enumerate(PER_DIGIT):
        parts = {"Train": [], "Test": []}
        parts["Train"] += [f"{10 * k + digit + 1:05}" for k in range(3)]
        for k in range(n):
            number += 1
            if mixed:
                parts["Test" if k % 10 == 0 else "Train"].append(str(60_000 + number))
            else:
                parts["Test"].append(f"{number:05}")
        for part, stems in parts.items():
            write_empty(folder, *(f"{part}/{digit}/{stem}.bin" for stem in stems))


@pytest.mark.parametrize("is_mixed", [False, True], ids=["official layout", "mixed layout"])
def test_all_recordings_are_found_in_both_layouts(tmp_path, is_mixed):
    write_layout(tmp_path, mixed=is_mixed)
    files = official_test(tmp_path)
    assert sorted(files) == list(range(1, N_TEST + 1))
    assert missing_numbers(files) == []
    # the digits follow each other in the made layout
    assert {files[n].parent.name for n in (1, 980)} == {"0"} and files[981].parent.name == "1"
    assert all(files[n].stem == f"{60_000 * is_mixed + n:05}" for n in (1, 5_000, 10_000))


def test_missing_recordings_are_numbered(tmp_path):
    write_empty(tmp_path, "Test/3/00002.bin", "Train/3/00003.bin", "Test/3/note.bin")
    files = official_test(tmp_path)
    assert list(files) == [2]
    assert missing_numbers(files)[:3] == [1, 3, 4] and len(missing_numbers(files)) == 9_999


@pytest.mark.parametrize(
    "names, message",
    [
        (["Train/0/00001.bin"], "no official test recordings of N-MNIST; expected Test/"),
        (["Test/0/10001.bin"], "10001.bin: official test recordings have numbers from 1 to 10,000"),
        (["Train/0/70001.bin"], "or from 60,001 to 70,000, got 70,001"),
        (["Test/0/00000.bin"], "00000.bin: official test recordings have numbers from 1"),
        (["Test/0/60001.bin", "Train/0/60001.bin"], "have the same number; remove one"),
        (["Test/0/60001.bin", "Test/1/60001.bin"], "have the same number; remove one"),
        (["Test/0/00001.bin", "Train/0/60001.bin"], "give a folder with one of the two"),
        (["Test/0/00001.bin", "Train/1/60002.bin"], "give a folder with one of the two"),
    ],
)
def test_folders_that_are_not_the_official_test_are_refused(tmp_path, names, message):
    write_empty(tmp_path, *names)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        official_test(tmp_path)


def test_a_digit_has_no_more_recordings_than_in_the_official_test(tmp_path):
    write_empty(tmp_path, *(f"Test/5/{number:05}.bin" for number in range(1, 894)))
    with pytest.raises(ValueError, match="893 test recordings of digit 5, but the official test"):
        official_test(tmp_path)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """The ten bundled samples as official test recordings 1 to 10, and as training recordings."""
    folder = tmp_path_factory.mktemp("N-MNIST")
    for digit, path in sample_recordings().items():
        for part in ("Train", "Test"):
            copy = folder / part / str(digit) / f"{digit + 1:05}.bin"
            copy.parent.mkdir(parents=True)
            copy.write_bytes(path.read_bytes())
    return folder


def test_a_part_is_refused(experiment, samples, tmp_path):
    report = tmp_path / "official.json"
    code, out, err = experiment("official_test", "--nmnist", samples, "--json", report)
    assert (code, out) == (2, "") and not report.exists()
    assert (
        "9,990 of the 10,000 official test recordings are missing (the first is number 11)" in err
    )
    assert "to evaluate the 10 at hand, give --at-hand" in err


def test_a_part_is_evaluated_and_called_a_part(experiment, samples, tmp_path):
    report = tmp_path / "official.json"
    words = ("--nmnist", samples, "--json", report, "--at-hand")
    code, out, _ = experiment("official_test", *words)
    assert code == 0
    assert out.startswith("NOT the official test, but a part of it: 10 of 10,000 recordings\n")
    assert "It was trained on no recording." in out
    numbers = read_numbers(report)
    assert (numbers["official_test_recordings"], numbers["of"]) == (10, 10_000)
    assert (numbers["recordings"], numbers["windows"], numbers["accuracy"]) == (10, 30, 1.0)
    assert numbers["model"] == "digits-from-pictures" and numbers["trained_on_recordings"] == 0
    assert "experiments.official_test" in json.loads(report.read_text())["run"]["command"]


def test_the_whole_is_called_the_official_test(experiment, samples, monkeypatch):
    """The official test has ten recordings here."""
    from experiments import official_test as script

    for module in (official, script):
        monkeypatch.setattr(module, "N_TEST", 10)
    code, out, _ = experiment("official_test", "--nmnist", samples, "--model", "digits")
    assert code == 0 and out.startswith("N-MNIST's official test: 10 of 10 recordings\n")
    assert "It was trained on 7,201 recordings, which must not be among those tested." in out


def test_a_damaged_recording_gives_no_result(experiment, samples, tmp_path):
    folder = tmp_path / "Test" / "0"
    folder.mkdir(parents=True)
    (folder / "00001.bin").write_bytes((samples / "Test/0/00001.bin").read_bytes())
    (folder / "00002.bin").write_bytes(b"123")
    report = tmp_path / "official.json"
    words = ("--nmnist", tmp_path, "--at-hand", "--json", report)
    code, _, err = experiment("official_test", *words)
    assert code == 2 and not report.exists()
    assert "1 of 2 recordings were evaluated: " in err and "00002.bin" in err


def test_a_model_of_other_classes_is_refused(experiment, samples):
    words = ("--nmnist", samples, "--at-hand", "--model", "digits-everywhere")
    code, _, err = experiment("official_test", *words)
    assert code == 2 and "digits-everywhere: not a classifier of the digits 0 to 9" in err
