"""Tables from files and to files: the same numbers in every form, and a sentence for each file that is none."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent_drivers import tables
from rtagent_drivers.tables import Table, read_table, write_table

number = st.floats(allow_nan=True, allow_infinity=True)
label = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=5)


def written(tmp_path: Path, text: str, name: str = "mine.csv") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


@st.composite
def some_tables(draw: st.DrawFn) -> Table:
    rows = draw(st.integers(1, 12))

    def column(values: st.SearchStrategy[float]) -> np.ndarray:
        return np.array(draw(st.lists(values, min_size=rows, max_size=rows)), dtype=np.float64)

    times = column(st.floats(-1e9, 1e9))
    sessions = draw(st.lists(label, min_size=rows, max_size=rows))
    return Table(times, sessions, {name: column(number) for name in draw(st.sets(st.sampled_from("abxyz")))})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mine.csv", "mine.csv.gz", "mine.npz"])
@given(table=some_tables())
def test_what_is_written_is_read_again_exactly(
    tmp_path_factory: pytest.TempPathFactory, name: str, table: Table
) -> None:
    path = tmp_path_factory.mktemp("round") / name
    write_table(table, path)
    read = read_table(path)
    np.testing.assert_array_equal(read.times, table.times)
    assert list(read.sessions) == list(table.sessions)
    assert read.columns.keys() == table.columns.keys()
    for column, numbers in table.columns.items():
        np.testing.assert_array_equal(read.columns[column], numbers)
    assert read.texts == {}


@given(table=some_tables(), block=st.integers(1, 5))
def test_where_a_file_is_cut_into_blocks_changes_nothing(
    tmp_path_factory: pytest.TempPathFactory, table: Table, block: int
) -> None:
    path = tmp_path_factory.mktemp("blocks") / "mine.csv"
    write_table(table, path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "BLOCK", block)
        read = read_table(path)
    np.testing.assert_array_equal(read.times, table.times)
    for column, numbers in table.columns.items():
        np.testing.assert_array_equal(read.columns[column], numbers)


@pytest.mark.parametrize("cell", ["", " ", "nan", "NaN", "NA", "n/a", "null", "None"])
def test_what_is_missing_is_nan(tmp_path: Path, cell: str) -> None:
    read = read_table(written(tmp_path, f"t,x\n0,1.5\n1,{cell}\n2,inf\n"))
    assert math.isnan(read.columns["x"][1])
    assert (read.columns["x"][0], read.columns["x"][2]) == (1.5, math.inf)
    assert read.texts == {}


def test_texts_among_numbers_are_counted_and_the_first_is_kept(tmp_path: Path) -> None:
    read = read_table(written(tmp_path, "t,x,mood\n0,1,good\n1,oops,\n2,3,bad\n3,ouch,bad\n"))
    assert read.texts == {"x": (2, 2, "oops"), "mood": (3, 1, "good")}


@pytest.mark.parametrize("name", ["t", "time", "Time", "timestamp", "Timestamp", "SECONDS"])
def test_the_time_is_known_by_its_name(tmp_path: Path, name: str) -> None:
    read = read_table(written(tmp_path, f"x,{name}\n5,0.5\n6,1\n"))
    assert (read.times.tolist(), read.time, list(read.columns)) == ([0.5, 1.0], name, ["x"])


def test_columns_can_be_named(tmp_path: Path) -> None:
    text = "t,when,arm,x,y\n0,10,left,1,2\n0,11,right,3,4\n"
    read = read_table(written(tmp_path, text), "when", "arm", ["y"])
    assert read.times.tolist() == [10.0, 11.0]
    assert list(read.sessions) == ["left", "right"]
    assert {name: column.tolist() for name, column in read.columns.items()} == {"y": [2.0, 4.0]}


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_columns_may_be_parted_otherwise_and_quoted(tmp_path: Path, delimiter: str) -> None:
    rows = [["t", '"x, or; so"'], ["0", "1"], [], ["1", "2"]]
    path = written(tmp_path, "\ufeff" + "\r\n".join(delimiter.join(row) for row in rows))
    assert read_table(path).columns["x, or; so"].tolist() == [1.0, 2.0]


def test_stamps_are_times_to_the_microsecond(tmp_path: Path) -> None:
    stamps = ["2022-10-26T08:17:21.847001Z", "2022-10-26T10:17:21.947+02:00", "2022-10-26 08:17:23"]
    read = read_table(written(tmp_path, "Timestamp,x\n" + "".join(f"{stamp},1\n" for stamp in stamps)))
    assert read.times.tolist() == [0.0, 0.099999, 1.152999]


def test_an_npz_may_hold_stamps_and_whole_numbers(tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    times = np.array(["2022-10-26T08:17:21.847", "2022-10-26T08:17:22.852"], dtype="datetime64[ms]")
    np.savez(path, time=times, x=np.array([1, 2]), on=np.array([True, False]), mood=np.array(["good", "bad"]))
    read = read_table(path)
    assert read.times.tolist() == [0.0, 1.005]
    assert (read.columns["x"].tolist(), read.columns["on"].tolist()) == ([1.0, 2.0], [1.0, 0.0])
    assert read.texts == {"mood": (2, 1, "good")}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty: a recording has a header"),
        ("a,b\n1,2\n", "no column of times that can be known by its name: say which it is with time, one of a, b"),
        ("t,x,x\n0,1,2\n", "has the column 'x' twice"),
        ("t,x\n0,1\n1\n", "row 2: it has 1 cells, and the header 2"),
        ("t,x\n0,1\n1,2,3\n", "row 2: it has 3 cells, and the header 2"),
        ("t,x\n0,1\nsoon,2\n", "row 2: 'soon' in column 't' is no time"),
        ("t,x\n0,1\n,2\n", "row 2: '' in column 't' is no time"),
        ("t,x\n0,1\nnan,2\n", "row 2: 'nan' in column 't' is no time"),
        ("t,x\nsoon,1\n", "row 1: 'soon' in column 't' is no time"),
        ("t,x\n2022-10-26T08:17:21Z,1\n5,2\n", "row 2: '5' in column 't' is no time"),
        ("t,x\n5,1\n2022-10-26T08:17:21Z,2\n", "row 2: '2022-10-26T08:17:21Z' in column 't' is no time"),
    ],
)
def test_a_file_that_is_no_table_is_told_why(tmp_path: Path, text: str, sentence: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(SpecError) as caught:
        read_table(path)
    assert sentence in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(("time", "session", "wanted"), [("tt", "", []), ("", "arms", []), ("", "", ["elbo"])])
def test_a_column_that_is_not_there_is_told_with_the_nearest(
    tmp_path: Path, time: str, session: str, wanted: list[str]
) -> None:
    path = written(tmp_path, "t,arm,elbow\n0,1,2\n")
    with pytest.raises(SpecError, match=r"has no column '\w+': did you mean '(t|arm|elbow)'\?"):
        read_table(path, time, session, wanted)


def test_a_file_that_is_not_there_is_told_with_the_nearest(tmp_path: Path) -> None:
    written(tmp_path, "t\n", "tuesday.csv")
    with pytest.raises(SpecError, match=r"there is no file .*tusday.csv: did you mean 'tuesday.csv'\?"):
        read_table(tmp_path / "tusday.csv")
    with pytest.raises(SpecError, match="there is no file"):
        read_table(tmp_path / "no" / "folder.csv")


@pytest.mark.parametrize(
    "content",
    [
        b"PK\x03\x04 no archive",
        gzip.compress(b"t,x\n0,1\n" * 1000)[:40],
        b"\x1f\x8b no gzip",
        b"t,x\n0,\xff\xfe\n",
        b"t,x\n0," + b"1" * 200_000 + b"\n",
    ],
)
def test_a_file_that_is_damaged_is_told(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "damaged"
    path.write_bytes(content)
    with pytest.raises(SpecError, match="damaged cannot be read as CSV, gzipped CSV or npz: "):
        read_table(path)
    with pytest.raises(SpecError, match="cannot be read"):
        read_table(tmp_path)


def test_an_npz_is_not_trusted(tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    np.savez(path, t=np.array([0.0, 1.0]), x=np.array([print, print], dtype=object))
    with pytest.raises(SpecError, match="cannot be read"):
        read_table(path)
    np.savez(path, t=np.array([0.0, 1.0]), x=np.zeros((2, 3)))
    with pytest.raises(SpecError, match=r"the array 'x' has shape \(2, 3\), not \(2,\)"):
        read_table(path)
    np.savez(path, t=np.zeros((2, 2)), x=np.zeros(2))
    with pytest.raises(SpecError, match=r"the array 't' has shape \(2, 2\)"):
        read_table(path)
    np.savez(path, t=np.array([0.0, np.nan]), x=np.zeros(2))
    with pytest.raises(SpecError, match="row 2: nan in column 't' is no time"):
        read_table(path)
