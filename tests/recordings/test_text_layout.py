"""Text columns as loggers write them: read to the last digit with the layout that is proposed, refused without one."""

import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.inspection import read_as_proposed
from monitor_core.recordings.raw.text import columns
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.proposal import propose
from tests.recordings.text_files import LoggerFile, logger_files, table

FILES = logger_files()


def layout_of(entries: dict[str, str | int]) -> TextLayout:
    return TextLayout.from_fields(Fields(entries, "map.toml [text]"))


def refusal(path, layout=None) -> str:
    with pytest.raises(RecordingFormatError) as caught:
        columns.read_channels(path, layout)
    message = str(caught.value)
    assert message.startswith(path.name)
    assert "\n" not in message
    return message


def test_a_logger_s_file_is_read_to_the_last_digit(tmp_path, subtests):
    for case in FILES:
        with subtests.test(case=case):
            file = FILES[case]
            path = tmp_path / "a.csv"
            path.write_bytes(file.content)
            proposal = propose(path)
            assert (proposal.layout.entries() if proposal.reasons else None) == file.layout
            layout = None if file.layout is None else layout_of(file.layout)
            require_truth(read_channels(path, layout), file)


def require_truth(channels, file: LoggerFile) -> None:
    assert set(channels.names) == set(file.channels)
    for name, numbers in file.channels.items():
        np.testing.assert_array_equal(channels.channel(name).samples, numbers)
        assert not channels.channel(name).samples.flags.writeable
    assert {name: list(texts) for name, texts in channels.texts.items()} == file.texts
    assert {name: channels.channel(name).unit for name in file.units} == file.units


def test_without_a_layout_it_is_refused_with_the_cause_and_the_next_step(tmp_path, subtests):
    for case in [case for case, file in FILES.items() if file.layout is not None]:
        with subtests.test(case=case):
            path = tmp_path / "a.csv"
            path.write_bytes(FILES[case].content)
            message = refusal(path)
            assert FILES[case].says in message
            assert "`preload check a.csv --write-map MAP`" in message


def test_the_times_of_a_trace_are_the_clocks_of_its_signals(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_bytes(FILES["trace: equal names of times"].content)
    channels = columns.read_channels(path)
    assert channels.channel("Torque").time.clock == "Time 1"
    assert channels.channel("Current").time.clock == "Time 2"
    assert channels.channel("Current").samples.size == channels.channel("Time 2").samples.size == 30


def test_columns_of_numbered_times_stay_plain_without_a_layout(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_text("Time 1,F,Time 2,a\n0,1,0,2\n1,3,1,4\n")
    plain = columns.read_channels(path)
    assert [channel.time.clock for channel in plain.channels] == [None] * 4
    stated = columns.read_channels(path, TextLayout(separator="comma"))
    assert [channel.time.clock for channel in stated.channels] == [None, "Time 1", None, "Time 2"]


def test_a_trace_with_a_time_but_no_value_is_refused(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_text("Time,F,Time,a\n0,1,0,2\n1,3,1,\n")
    assert "'a': expected a time for each value; got rows with one of them alone" in refusal(path)


WITH_LAYOUT = {
    "a point where commas are decimal": (
        "a;b\n0,5;1\n1.5;2\n", {"separator": "semicolon", "decimal": "comma"},
        "row 3, column 'a': expected a number with a decimal comma; got '1.5'",
    ),
    "a row that is cut off": ("a;b\n1;2\n3\n", {"separator": "semicolon"}, "row 3: expected 2 numbers"),
    "a cell more": ("a;b\n1;2\n3;4;5\n", {"separator": "semicolon"}, "row 3: expected 2 numbers"),
    "a broken quote": ('a,b\n"1","2"\n"3,"4"\n', {"separator": "comma"}, "row 3"),
    "letters behind a quote": ('a,b\n"1"5,"2"\n', {"separator": "comma"}, "expected at least one channel"),
    "fewer rows than the layout says": (
        "a;b\n1;2\n", {"separator": "semicolon", "header_row": 9},
        "from row 10 on as the layout says; the file has 2 rows",
    ),
    "a header row that is blank": (
        "\na;b\n1;2\n", {"separator": "semicolon", "header_row": 1, "first_row": 3},
        "header_row 1 above the numbers; got a blank",
    ),
    "one name twice": ("a;a\n1;2\n", {"separator": "semicolon"}, "header_row = 0 in [text] calls the columns '1'"),
    "a sheet": ("a;b\n1;2\n", {"sheet": "Data"}, "expected no sheet"),
    "another encoding": ("a;b\n1;2\n", {"separator": "semicolon", "encoding": "utf-16"}, "expected UTF-16 text"),
    "overload": ("a;b\n1;2\nOVL;4\n", {"separator": "semicolon"}, "row 3, column 'a': expected a number"),
}  # fmt: skip


def test_rows_that_do_not_fit_the_layout_are_refused(tmp_path, subtests):
    for case, (text, entries, sentence) in WITH_LAYOUT.items():
        with subtests.test(case=case):
            path = tmp_path / "a.csv"
            path.write_text(text)
            assert sentence in refusal(path, layout_of(entries))


def test_a_layout_that_contradicts_itself_is_refused(subtests):
    for entries, sentence in [
        ({"separator": "colon"}, "expected 'tab' or 'semicolon' or 'comma' or 'blank'; got 'colon'"),
        ({"decimal": "dot"}, "expected 'point' or 'comma'"),
        ({"encoding": "cp1252"}, "expected 'utf-8' or 'latin-1' or 'utf-16'"),
        ({"header_row": -1}, "expected a row counted from 0; got -1"),
        ({"unit_row": 0}, "expected a row counted from 1; got 0"),
        ({"first_row": 2.5}, "expected a row counted from 1; got 2.5"),
        ({"header_row": 3, "first_row": 3}, "expected header_row above first_row; got rows 3 and 3"),
        ({"header_row": 3, "unit_row": 3}, "expected names and units in rows of their own; got row 3 for both"),
        ({"seperator": "tab"}, "got 'seperator'"),
    ]:
        with subtests.test(entries=entries, sentence=sentence):
            with pytest.raises(RecordingFormatError, match=r"map\.toml \[text\]") as caught:
                layout_of(entries)
            assert sentence in str(caught.value)


def test_what_is_written_of_a_layout_is_read_back(tmp_path):
    for file in FILES.values():
        if file.layout is not None:
            layout = layout_of(file.layout)
            assert layout_of(layout.entries()) == layout


def test_prose_and_pictures_are_no_columns(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("Measured on the 3rd of March, with 2 sensors.\nNothing else is known; see page 12.\n")
    with pytest.raises(RecordingFormatError, match="expected rows of numbers; found none"):
        propose(path)
    path.write_bytes(bytes(range(256)) * 9)
    with pytest.raises(RecordingFormatError, match="expected text; byte 0 is 0x00"):
        propose(path)


def test_a_layout_is_for_texts_alone(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, x=np.ones(3))
    with pytest.raises(RecordingFormatError, match=r"expected no table \[text\]"):
        read_channels(path, TextLayout())


def test_a_mistake_beyond_the_first_block_names_its_row(tmp_path):
    path = tmp_path / "a.csv"
    n_rows = 300_000
    path.write_text("a;b\n" + "1,5;2,5\n" * n_rows + "1,5;2.5\n" + "1,5;2,5\n" * 9)
    layout = TextLayout(separator="semicolon", decimal="comma")
    assert f"row {n_rows + 2}, column 'b': expected a number with a decimal comma; got '2.5'" in refusal(path, layout)


def test_a_byte_that_is_no_text_is_named_wherever_it_stands(tmp_path):
    path = tmp_path / "a.csv"
    content = b"a,b\n" + b"1,2\n" * 600_000
    path.write_bytes(content + b"1,\xb5\n")
    assert f"expected UTF-8 text; byte {len(content) + 2} is 0xb5" in refusal(path)


def test_texts_that_stand_among_numbers_are_said_to_be_texts(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,F\n06:00:00,1\n06:00:01,2\n")
    channels = columns.read_channels(path, TextLayout(separator="comma"))
    assert channels.text("t") == ("06:00:00", "06:00:01")
    with pytest.raises(RecordingFormatError, match="expected numbers in 't'; it holds texts such as '06:00:00'"):
        channels.channel("t")
    with pytest.raises(RecordingFormatError, match="expected 'F' to hold texts; it holds numbers"):
        channels.text("F")
    with pytest.raises(RecordingFormatError, match="expected a column of texts 'u'; the file has 't'"):
        channels.text("u")


def test_forty_thousand_columns_are_refused_before_they_are_parsed(tmp_path):
    path = tmp_path / "a.csv"
    row = ",".join(f"c{i}" for i in range(40_000))
    path.write_text(f"{row}\n" + ",".join("1" * 40_000) + "\n")
    assert "expected at most 4096 columns; got 40000" in refusal(path)
    assert "expected at most 4096 columns; got 40000" in refusal(path, TextLayout(separator="comma"))


def test_a_row_without_end_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n" + "1" * 3_000_000)
    assert "expected rows of at most 1048576 characters" in refusal(path)


def test_four_thousand_columns_are_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(table(*[[str(i), str(i + 0.5)] for i in range(4096)]))
    channels = columns.read_channels(path)
    assert len(channels.names) == 4096
    np.testing.assert_array_equal(channels.channel("4096").samples, [4095.0, 4095.5])


STEPS = {
    "no value in Excel": ("a,b\n1,2\n2,3\n#NV,3\n4,5\n6,7\n", "'#NV'; write nan for the missing number of row 4"),
    "dashes": ("a,b\n1,2\n2,2\n---,3\n4,5\n6,7\n8,9\n", "'---'; write nan for the missing number of row 4"),
    "a footer": ("a;b\n1;2\n3;4\n5;6\n= end =\n", "got 1; remove row 5, which holds no numbers"),
    "a row that is cut off": ("a;b\n1;2\n3;4\n5\n", "got 1; complete row 4 or remove it"),
    "commas and a word": ("a;b\n1,5;2\n1,5;2\n3,5;x\n5,5;6\n", "'x'; write nan for the missing number of row 4"),
}


@pytest.mark.parametrize("case", STEPS)
def test_where_no_layout_helps_the_step_is_one_in_the_file(tmp_path, case):
    text, step = STEPS[case]
    path = tmp_path / "a.csv"
    path.write_text(text)
    message = refusal(path)
    assert step in message
    assert "--write-map" not in message
    with pytest.raises(RecordingFormatError) as caught:
        read_as_proposed(path, "csv")
    assert step in str(caught.value)


@pytest.mark.parametrize("place", [1, 5000])
def test_a_blank_cell_is_nan_with_the_layout_that_is_proposed(tmp_path, place):
    path = tmp_path / "a.csv"
    numbers = [f"{i}" for i in range(6000)]
    path.write_text("a,b\n" + "".join(f"{'' if i == place else n},{n}\n" for i, n in enumerate(numbers)))
    assert "cells without a number: `preload check a.csv --write-map MAP`" in refusal(path)
    read = read_as_proposed(path, "csv")
    channels, layout = read.channels, read.layout
    assert layout is not None
    expected = np.arange(6000.0)
    np.testing.assert_array_equal(channels.channel("b").samples, expected)
    expected[place] = np.nan
    np.testing.assert_array_equal(channels.channel("a").samples, expected)
    assert f"row {place + 2}, column 'a'" in refusal(path)


def test_the_index_of_pandas_has_a_number_for_a_name(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(",t,F\n0,0.0,1.5\n1,0.1,2.5\n")
    channels = columns.read_channels(path)
    assert channels.names == ("1", "t", "F")
    assert not propose(path).reasons
    path.write_text(",5,6\n0,1,2\n")  # may be a row of numbers in which one is missing
    assert "expected a name for each column" in refusal(path)


@pytest.mark.parametrize("cell", ["1.234,5", '"1,234.5"', "-1.234.567", "1'234.5"])
def test_thousands_separators_are_refused_by_name(tmp_path, cell):
    path = tmp_path / "a.csv"
    path.write_text(f"a;b\n1;2\n3;4\n5;6\n7;{cell}\n")
    message = refusal(path)
    assert "row 5, column 'b'" in message
    assert message.endswith("export without thousands separators")
    path.write_text(f"a;b\n1;{cell}\n3;{cell}\n5;{cell}\n")
    assert "export without thousands separators" in refusal(path)
    with pytest.raises(RecordingFormatError, match="export without thousands separators"):
        read_as_proposed(path, "csv")
