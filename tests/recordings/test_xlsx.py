"""Excel workbooks as openpyxl writes them, and parts of them laid out by hand."""

import zipfile
from dataclasses import dataclass
from datetime import datetime, time, timedelta

import numpy as np
import pytest

from monitor_core.errors import MissingReaderError
from monitor_core.recordings.raw.binary import xlsx
from tests.recordings.test_raw import refusal

openpyxl = pytest.importorskip("openpyxl")
FORCE = [0.1, -2.5e-3, 1e300, 1 / 3, 5]


@dataclass(frozen=True)
class Layout:
    """What a channel map says of a sheet."""

    header_row: int | None = None
    unit_row: int | None = None
    first_row: int | None = None
    sheet: str | None = None


def written(tmp_path, *rows, others=()):
    book = openpyxl.Workbook()
    book.active.title = "Data"
    for row in rows:
        book.active.append(row)
    for name, other_rows in others:
        sheet = book.create_sheet(name)
        for row in other_rows:
            sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    return tmp_path / "a.xlsx"


def test_columns_of_numbers_are_channels_under_their_names(tmp_path):
    path = written(tmp_path, ("n", "force", "remark"), *((i, value, "ok") for i, value in enumerate(FORCE)))
    channels = xlsx.read_channels(path)
    assert channels.names == ("n", "force")
    np.testing.assert_array_equal(channels.channel("force").samples, FORCE)
    np.testing.assert_array_equal(channels.channel("n").samples, range(5))


def test_a_first_row_of_numbers_means_that_there_are_no_names(tmp_path):
    channels = xlsx.read_channels(written(tmp_path, (1, 2.5), (2, 3.5)))
    assert channels.names == ("1", "2")
    np.testing.assert_array_equal(channels.channel("2").samples, [2.5, 3.5])


def test_a_layout_says_where_names_units_and_numbers_stand(tmp_path):
    path = written(
        tmp_path, ("Report of drive 3",), ("date", datetime(2025, 3, 1)), (), ("t", "force"), ("s", "N"), ("---",),  # noqa: DTZ001
        (0.0, 1.5), (0.1, 2.5),
    )  # fmt: skip
    channels = xlsx.read_channels(path, Layout(header_row=4, unit_row=5, first_row=7))
    assert [(channel.name, channel.unit) for channel in channels.channels] == [("t", "s"), ("force", "N")]
    np.testing.assert_array_equal(channels.channel("force").samples, [1.5, 2.5])
    unnamed = xlsx.read_channels(path, Layout(header_row=0, first_row=7))
    assert unnamed.names == ("1", "2")


def test_columns_of_different_length_end_where_they_end(tmp_path):
    path = written(tmp_path, ("t1", "a", "t2", "b"), (0, 1, 0, 5), (1, 2, None, None), (2, 3, None, None))
    channels = xlsx.read_channels(path)
    assert [channel.samples.size for channel in channels.channels] == [3, 3, 1, 1]


def test_dates_and_durations_become_seconds(tmp_path):
    start = datetime(2025, 3, 1, 6, 0)  # noqa: DTZ001  # a sheet knows no zone
    rows = [(start + timedelta(microseconds=250 * i), timedelta(milliseconds=5 * i), time(0, 0, i)) for i in range(4)]
    channels = xlsx.read_channels(written(tmp_path, ("when", "since", "clock"), *rows))
    # Excel keeps days since 1900 in double precision: 0.63 µs from a number to the next, and two numbers are subtracted
    np.testing.assert_allclose(channels.channel("when").samples, 250e-6 * np.arange(4), rtol=0, atol=2 * 0.63e-6)
    np.testing.assert_allclose(channels.channel("since").samples, 5e-3 * np.arange(4), rtol=1e-12)
    np.testing.assert_allclose(channels.channel("clock").samples, np.arange(4), rtol=1e-12)
    assert {(channel.unit, channel.time.started_at) for channel in channels.channels} == {("s", None)}


def test_the_sheet_with_cells_is_taken_and_of_several_the_one_that_is_named(tmp_path):
    rows = (("a",), (1,), (2,))
    assert xlsx.read_channels(written(tmp_path, *rows, others=[("Empty", [])])).names == ("a",)
    path = written(tmp_path, *rows, others=[("More", [("b",), (3,), (4,)])])
    assert "the name of one as sheet in [text]; the workbook has 'Data', 'More'" in refusal(xlsx.read_channels, path)
    assert xlsx.read_channels(path, Layout(sheet="More")).names == ("b",)
    assert "expected a sheet 'No'" in refusal(lambda p: xlsx.read_channels(p, Layout(sheet="No")), path)


def test_an_empty_cell_is_nan_and_moves_no_other(tmp_path):
    rows = (("a", "b", "c"), (1, 2, None), (None, 3, 6), (4, None, 7))
    channels = xlsx.read_channels(written(tmp_path, *rows))
    np.testing.assert_array_equal(channels.channel("a").samples, [1.0, np.nan, 4.0])
    np.testing.assert_array_equal(channels.channel("b").samples, [2.0, 3.0])
    np.testing.assert_array_equal(channels.channel("c").samples, [np.nan, 6.0, 7.0])


def test_dates_count_from_the_first_date_of_any_column_where_some_begin_with_empty_cells(tmp_path):
    begin = datetime(2025, 3, 1, 6)  # noqa: DTZ001  # a sheet has no time zone
    rows = [(begin if i == 3 else None, begin + timedelta(seconds=i), i) for i in range(6)]
    path = written(tmp_path, ("Event", "Time", "force"), *rows)
    without_format = xlsx.read_channels(path).channel("Event")
    book = openpyxl.load_workbook(path)
    book.active["A2"].number_format = book.active["B2"].number_format
    book.save(path)
    channels = xlsx.read_channels(path)
    np.testing.assert_array_equal(without_format.samples, channels.channel("Event").samples)
    np.testing.assert_array_equal(channels.channel("Time").samples, range(6))
    np.testing.assert_array_equal(channels.channel("Event").samples, [np.nan, np.nan, np.nan, 0.0])


REFUSED = {
    "a word": ((("a", "b"), (1, 2), (3, "overload")), "column 'b': expected numbers alone; got 'overload'"),
    "units without a word": ((("a", "b"), ("s", "N"), (3, 4)), "expected numbers alone; got 's'"),
    "a truth value": ((("a", "b"), (1, 2), (3, True)), "column 'b': expected numbers alone; got 'True'"),
    "a preamble": ((("Report",), (), ("a", "b"), (1, 2)), "say header_row in [text] of a channel map"),
    "a number among names": ((("a", 7), (1, 2)), "1 texts among 2 cells"),
    "one name twice": ((("a", "a"), (1, 2)), "expected columns of different names; got 'a' twice"),
    "names alone": ((("a", "b"),), "expected numbers from row 2 on; got none"),
    "words alone": ((("a", "b"), ("x", "y")), "got only what is not read: a (texts), b (texts)"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_sheets_that_leave_doubt_are_refused(tmp_path, case):
    rows, sentence = REFUSED[case]
    assert sentence in refusal(xlsx.read_channels, written(tmp_path, *rows))


def with_part(tmp_path, part, content):
    """Write a workbook of which one part is another."""
    good = written(tmp_path, ("a",), (1,), (2,))
    path = tmp_path / "b.xlsx"
    with zipfile.ZipFile(good) as archive, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as changed:
        for name in archive.namelist():
            changed.writestr(name, content if name == part else archive.read(name))
    return path


MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'


def sheet(*rows: str) -> str:
    return f"<worksheet {MAIN}><sheetData>{''.join(rows)}</sheetData></worksheet>"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (sheet('<row r="1"><c r="ZZZ1"><v>1</v></c></row>'), "4096 columns"),
        (sheet(*(f'<row><c r="ENZ{n}"><v>1</v></c></row>' for n in range(1, 1500))), "most of them filled"),
    ],
    ids=["too wide", "mostly empty"],
)  # fmt: skip
def test_sheets_that_would_fill_the_memory_are_refused(tmp_path, content, sentence):
    assert sentence in refusal(xlsx.read_channels, with_part(tmp_path, "xl/worksheets/sheet1.xml", content))


def test_what_is_no_workbook_is_refused(tmp_path):
    path = tmp_path / "a.xlsx"
    path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600))  # of Excel before 2007
    assert "expected an Excel workbook (.xlsx)" in refusal(xlsx.read_channels, path)


def test_a_missing_library_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "openpyxl", None)
    with pytest.raises(MissingReaderError, match=r"pip install openpyxl"):
        xlsx.read_channels(tmp_path / "a.xlsx")
