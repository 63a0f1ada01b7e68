"""Text: times to the nearest microsecond, the columns by name, and rows that are not events."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording


@pytest.fixture
def text(tmp_path):
    def write(name, content):
        (tmp_path / name).write_text(content)
        return open_recording(tmp_path / name)

    return write


@pytest.mark.parametrize(
    ("written", "t_us"),
    [
        ("1468940293.844933001", 1468940293844933),
        ("12", 12_000_000),  # of one row alone, nothing says that it is no second
        ("1.0000005", 1_000_001),
        ("1.0000004999", 1_000_000),
        (".5", 500_000),
        ("2.5e-05", 25),
        ("1700000000.123457", 1_700_000_000_123_457),
        ("1.5E+2", 150_000_000),
        ("1.00000000000000000000000000009", 1_000_000),
    ],
)
def test_seconds_become_microseconds(text, written, t_us):
    assert text("a.txt", f"{written} 3 4 1\n").read().tolist() == [(t_us, 3, 4, 1)]


@given(st.decimals(0, 10**9, allow_nan=False, places=9), st.booleans())
def test_a_decimal_number_is_read_to_the_nearest_microsecond_but_for_rounding(
    tmp_path_factory, seconds, scientific
):
    path = tmp_path_factory.mktemp("t") / "a.txt"
    path.write_text(f"{seconds:.18e} 1 2 0\n" if scientific else f"{seconds:f} 1 2 0\n")
    assert abs(
        int(open_recording(path).read()["t"][0]) - Fraction(seconds) * 10**6
    ) < 0.5 + 1e6 * math.ulp(1e9)


def test_rows_may_have_other_line_ends_blanks_comments_and_floats(text):
    recording = text(
        "a.txt", "# made\r\n\r\n0.5 1 2 1\r\n  0.6\t3  4 -1 \n% more\n\n7.00e-01 5.0 6.000e+00 1.0"
    )
    assert recording.read().tolist() == [(500_000, 1, 2, 1), (600_000, 3, 4, 0), (700_000, 5, 6, 1)]
    assert recording.sensor is None


UZH_ROWS = (
    "0.3 1 2",
    "0.3 1.5 2 1",
    "1e 1 2 1",
    "9007199254.740993 1 2 1",  # 2**53 + 1
    "nan 1 2 1",
    "0.3 1 2 \xff",
)
INVALID_EVENTS = {
    "-0.3 1 2 1": "t = -300000, .* is not a valid event",
    "0.3 1 2 -1": "p = -1, and before it 0",
}
CSV_ROWS = ("0.25,1,2,1", "7,1,2,None", "7,1,2", "7,1,2,1,1", "7,,2,1", "7 7,1,2,1")


@pytest.mark.parametrize("row", UZH_ROWS + CSV_ROWS)
def test_a_row_that_is_not_an_event_is_damage(text, row):
    if row in CSV_ROWS:
        recording = text("a.csv", f"t,x,y,p\n5,1,2,0\n6,1,2,1\n{row}\n")
        expected = "t,x,y,p, t in whole microseconds"
    else:
        recording = text("a.txt", f"9 9\n0.000005 1 2 0\n0.000006 1 2 1\n{row}\n0.4 1 2 1\n")
        expected = "`t x y p`, t in seconds"
    with pytest.warns(DamagedRecording, match=f"line 4: expected {expected}, got '"):
        assert recording.read()["t"].tolist() == [5, 6]


@pytest.mark.parametrize("row", INVALID_EVENTS)
def test_a_row_that_no_event_can_be_is_damage(text, row):
    recording = text("a.txt", f"9 9\n0.000005 1 2 0\n0.000006 1 2 1\n{row}\n0.4 1 2 1\n")
    with pytest.warns(DamagedRecording, match=f"event 2: .*{INVALID_EVENTS[row]}"):
        assert recording.read()["t"].tolist() == [5, 6]


@pytest.mark.parametrize(
    "content",
    [
        "7,1,2,1\n",
        "7.000e+00,1.000e+00,2e0,1\n",
        "x,y,p,t\n1,2,1,7\n  ",
        "x;y;polarity;timestamp\n1;2;1;7\n",
        "P\tTS\tY\tX\n1\t7\t2\t1\n",
        "id,x,y,on,t,name\nabc,1,2,True,7,日本\n",
        '"t","x","y","pol"\n7.0,1,2,1\n',
        "# y;x;p;t\n2;1;1;7\n",
        "# y x p t\n2,1,1,7\n",
        "# t x y p\n# y x p t\n2,1,1,7\n",  # the last of them
        "t;x;y;p;a,b\n7;1;2;1;c,d\n",
        # a polarity without a line end is whole; another number may have lost digits
        "t,x,y,p\n7,1,2,1",
        "t,x,y,p,name\n7,1,2,1,of a column that is skipped",
    ],
)
def test_csv_columns_are_found_by_name(text, content):
    for name in ("a.csv", "a.tsv", *(["a.txt"] if "\t" not in content else [])):
        assert text(name, content).read().tolist() == [(7, 1, 2, 1)]
    assert text("a.csv", "\ufeff" + content.replace("\n", "\r\n")).read().tolist() == [(7, 1, 2, 1)]


METAVISION = "96,133,0,3811\n97,134,1,3812\n96,133,1,4000\n"
IN_TIME = [(3811, 96, 133, 0), (3812, 97, 134, 1), (4000, 96, 133, 1)]


@pytest.mark.parametrize("name", ["a.csv", "a.txt"])
def test_a_line_with_the_geometry_is_the_sensor_and_says_that_the_columns_are_x_y_p_t(text, name):
    """Metavision writes no header."""
    recording = text(name, "%geometry:1280,720\n" + METAVISION)
    assert recording.read().tolist() == IN_TIME
    assert (recording.sensor, recording.stated_sensor) == ((1280, 720), (1280, 720))
    later = text(name, "t,x,y,p\n%geometry:1280,720\n7,1,2,1\n")  # it comes before all rows
    assert later.sensor is None and later.read().tolist() == [(7, 1, 2, 1)]
    named = text(name, "% Geometry: 1280,720\nt,x,y,p\n7,1,2,1\n")  # names count more
    assert named.read().tolist() == [(7, 1, 2, 1)] and named.sensor == (1280, 720)


def test_the_geometry_is_the_sensor_of_rows_between_blanks_too(text):
    recording = text("a.txt", "%geometry:1280,720\n0.5 1 2 1\n")
    assert recording.sensor == (1280, 720) and recording.read().tolist() == [(500_000, 1, 2, 1)]


def test_columns_in_another_order_are_refused_and_their_order_is_named(text):
    with pytest.raises(
        ValueError, match=r"a.csv: the columns are not 'txyp'; they look like 'xypt': .* `columns`"
    ):
        text("a.csv", METAVISION)
    with pytest.raises(
        ValueError, match=r"a.csv: the columns are not 'xypt'; they look like 'txyp': .* `columns`"
    ):
        text("a.csv", "%geometry:9,9\n5,1,2,0\n6,1,2,1\n7,2,1,1\n")


def test_a_row_that_is_cut_off_does_not_hide_the_order(text):
    with pytest.raises(ValueError, match="not 'txyp'; they look like 'xypt'"):
        text("a.csv", METAVISION + "97,1")


def test_rows_that_are_all_at_the_beginning_are_read(text):
    """0 is the same in seconds and in microseconds."""
    assert text("a.txt", "0 1 2 1\n0 3 4 0\n").read().tolist() == [(0, 1, 2, 1), (0, 3, 4, 0)]


COMMENTS = "# nothing yet\n" * 5_000


@pytest.mark.parametrize(
    ("head", "columns"), [("%geometry:1280,720\n", None), ("# y x p t\n", None), ("", "xypt")]
)
def test_the_order_of_columns_is_known_where_comments_fill_the_beginning(tmp_path, head, columns):
    order = [0, 1] if "y x" not in head else [1, 0]
    pixels = [(96, 133), (97, 134), (96, 133)]
    rows = [
        f"{pixel[order[0]]},{pixel[order[1]]},{p},{t}\n"
        for pixel, (t, _, _, p) in zip(pixels, IN_TIME, strict=True)
    ]
    (tmp_path / "a.csv").write_text(head + COMMENTS + "".join(rows))
    recording = open_recording(tmp_path / "a.csv", columns=columns)
    assert recording.read().tolist() == IN_TIME
    assert recording.sensor == ((1280, 720) if "geometry" in head else None)
