"""Text: times exact to the microsecond, the columns by name, and rows that are not events."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording


@pytest.fixture
def text(tmp_path):
    def write(name, content):
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
        return open_recording(tmp_path / name)

    return write


@pytest.mark.parametrize(
    ("written", "t_us"),
    [
        ("0.000001", 1),
        ("1468940293.844933001", 1468940293844933),
        ("0.29", 290_000),
        ("0.57", 570_000),
        ("1.0000005", 1_000_001),
        ("1.0000004999", 1_000_000),
        ("0.12345599999999999", 123_456),
        (".5", 500_000),
        ("4.", 4_000_000),
        ("2.5e-05", 25),
        ("1.234560000000000000e-01", 123_456),
        ("9007199254.740993", 9007199254740993),
        ("461168601842.387903", 461168601842387903),
        ("1.5E+2", 150_000_000),
        ("+0.25", 250_000),
        ("0.0", 0),
        ("0e-400", 0),
        ("1e-400", 0),
        ("000000000000000000000001.5", 1_500_000),
        ("1.00000000000000000000000000009", 1_000_000),
    ],
)
def test_seconds_become_microseconds_exactly(text, written, t_us):
    assert text("a.txt", f"{written} 3 4 1\n").read().tolist() == [(t_us, 3, 4, 1)]


@given(st.decimals(0, 10**9, allow_nan=False, places=9), st.booleans())
def test_any_decimal_number_is_read_to_the_nearest_microsecond(tmp_path_factory, seconds, scientific):
    path = tmp_path_factory.mktemp("t") / "a.txt"
    path.write_text(f"{seconds:.18e} 1 2 0\n" if scientific else f"{seconds:f} 1 2 0\n")
    exact = Fraction(seconds) * 10**6
    assert open_recording(path).read()["t"][0] == (exact + Fraction(1, 2)).__floor__()


def test_rows_as_they_come(text):
    """Line ends of Windows, blanks, empty lines, comments, floats, a missing last line end; no sensor."""
    recording = text("a.txt", "# made\r\n\r\n0.5 1 2 1\r\n  0.6\t3  4 -1 \n% more\n\n7.00e-01 5.0 6.000e+00 1.0")
    assert recording.read().tolist() == [(500_000, 1, 2, 1), (600_000, 3, 4, 0), (700_000, 5, 6, 1)]
    assert recording.sensor is None


@pytest.mark.parametrize("content", ["", "240 180\n", "# nothing\n", "\n\n"])
def test_text_without_events(text, content):
    recording = text("a.txt", content)
    assert (recording.n_events, recording.duration_us, list(recording)) == (0, 0, [])
    assert recording.sensor == ((240, 180) if content.startswith("2") else None)


@pytest.mark.parametrize(
    "row",
    [
        "0.3 1 2",
        "0.3 1 2 2",
        "0.3 1 2 1 5",
        "0.3 1.5 2 1",
        "-0.3 1 2 1",
        "0.3 65536 2 1",
        "0.3 -1 2 1",
        "x 1 2 1",
        "0.3 1 2 -1",
        "0.3 1 2 1x",
        "0.3 1 2 -",
        "9e99 1 2 1",
        "1e 1 2 1",
        "4611686018427.387903 1 2 1",
        ". 1 2 1",
        "0.3,1,2,1",
        "0.3 1 2 \xff",
        "0..3 1 2 1",
    ],
)
def test_a_row_that_is_not_an_event_is_damage(text, row):
    recording = text("a.txt", f"9 9\n0.1 1 2 0\n0.2 1 2 1\n{row}\n0.4 1 2 1\n")
    with pytest.warns(DamagedRecording, match="line 4: expected `t x y p`, t in seconds, got '") as caught:
        assert recording.read()["t"].tolist() == [100_000, 200_000]
    assert "Keeping the 2 events before, up to 200000 us." in str(caught[0].message)
    with pytest.raises(ValueError, match="line 4"):
        open_recording(recording.path, strict=True).read()


def test_line_numbers_count_through_chunks(text):
    rows = [f"{i}.5 1 2 1" for i in range(200_000)]
    rows[150_000] = "what"
    with pytest.warns(DamagedRecording, match="line 150001: .* got 'what'"):
        assert text("a.txt", "\n".join(rows)).n_events == 150_000


def test_what_is_not_such_text_is_refused(text):
    with pytest.raises(ValueError, match="expected `t x y p`, t in seconds, or first `width height`, got 'hello'"):
        text("a.txt", "hello")
    with pytest.raises(ValueError, match="expected text, got bytes that are not"):
        text("a.txt", b"\x00\x01")
    with pytest.raises(ValueError, match=r"must be seconds with decimals, got whole numbers \(12, 13, ...\)"):
        text("a.txt", "12 1 2 1\n13 1 2 1\n")
    with pytest.raises(ValueError, match="the file ends in its first line, '240 18'"):
        text("a.txt", "240 18")
    with pytest.raises(ValueError, match="1 to 65536 pixels a side, got '0 18'"):
        text("a.txt", "0 18\n")


def test_a_row_without_end_is_damage(text):
    with pytest.warns(DamagedRecording, match="line 2: expected"):
        assert text("a.txt", "0.5 1 2 1\n" + "7" * 3_000_000).n_events == 1


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("", "7 1 2 1"),
        ("t x y p", "7 1 2 1"),
        ("x y polarity timestamp", "1 2 1 7"),
        ("P TS Y X", "1 7 2 1"),
        ("id x y on t name", "abc 1 2 True 7 some-one"),
        ('"t" "x" "y" "pol"', "7.0 1 2 1"),
        ("# y x p t", "2 1 1 7"),
    ],
)
def test_csv_columns_are_found_by_name(text, separator, header, row):
    content = "".join(line.replace(" ", separator) + "\n" for line in (header, row) if line)
    if header.startswith("#"):
        content = content.replace(f"#{separator}", "# ", 1)
    assert text("a.csv", content).read().tolist() == [(7, 1, 2, 1)]
    assert text("a.csv", "\ufeff" + content.replace("\n", "\r\n")).read().tolist() == [(7, 1, 2, 1)]


@pytest.mark.parametrize(
    ("header", "field", "names"),
    [
        ("t,x,x,y,p", "x", "x and x"),
        ("t,x,y,p,TS", "t", "t and ts"),
        ("# id,x,y,on,t,Pol", "p", "on and pol"),
    ],
)
def test_csv_with_a_column_twice_is_refused(text, header, field, names):
    with pytest.raises(ValueError, match=rf"a\.csv: events need one field `{field}`, got {names} in the header; leave"):
        text("a.csv", f"{header}\n1,2,3,1,5,6\n")


def test_csv_in_a_txt_file(text):
    assert text("a.txt", "t,x,y,p\n7,1,2,False\n").read().tolist() == [(7, 1, 2, 0)]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("t x y p\n", "at least four columns with commas, semicolons or tabs between them, got 't x y p' at line 1"),
        ("t,x,y,q\n", r"the header must name t\|ts\|timestamp, x, y, p\|on\|polarity\|pol; got 't,x,y,q'"),
        ("1,2,3,0,5\n", "without a header there must be four columns t, x, y, p, got 5"),
        ("t,x,y,p", "the file ends in its header, 't,x,y,p'"),
    ],
)
def test_csv_that_cannot_be_understood_is_refused(text, content, message):
    with pytest.raises(ValueError, match=message):
        text("a.csv", content)


@pytest.mark.parametrize("row", ["0.25,1,2,1", "7,1,2,None", "7,1,2", "7,1,2,1,1", "7,,2,1", "7 7,1,2,1"])
def test_csv_rows_that_are_not_events(text, row):
    recording = text("a.csv", f"t,x,y,p\n6,1,2,1\n{row}\n")
    with pytest.warns(DamagedRecording, match="line 3: expected t,x,y,p, t in whole microseconds, got "):
        assert recording.n_events == 1


def test_a_last_number_that_may_be_cut_is_damage(text):
    """`1234` without its line end may have been 123456; a polarity cannot lose digits."""
    with pytest.warns(DamagedRecording, match="line 3: .* got '1,2,1,1234', and the file ends there"):
        assert text("a.csv", "x,y,p,t\n1,2,1,1233\n1,2,1,1234").read()["t"].tolist() == [1233]
    assert text("a.csv", "t,x,y,p\n1234,1,2,1").n_events == 1


def test_empty_csv(text):
    for content in ("", "t,x,y,p\n", "\n"):
        np.testing.assert_array_equal(text("a.csv", content).n_events, 0)
