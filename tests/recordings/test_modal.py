"""Modal tables: round trip, the published one, and each way in which a table may be wrong."""

from datetime import UTC, datetime

import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings import ModalRow, read_modal_table, write_modal_table


def table(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode(encoding))
    return path


def test_nguyen_table_2_is_read(published_data):
    rows = read_modal_table(published_data / "nguyen_table2.csv")
    assert len(rows) == 18  # six preloads at three positions
    assert rows[0] == ModalRow(0.25, 189.093, 50.0, 0.475, 20)
    assert {row.position for row in rows} == {0.25, 0.5, 0.75}


def test_what_is_written_is_read(tmp_path):
    rows = (
        ModalRow(0.1234, 181.5),
        ModalRow(0.5, 170.25, 300.0, 0.4, 20, 1, 0.021, 3.5e-2, 12.0, 22.5, datetime(2025, 3, 1, 6, tzinfo=UTC)),
    )
    write_modal_table(tmp_path / "t.csv", rows)
    assert read_modal_table(tmp_path / "t.csv") == rows
    assert b"\r" not in (tmp_path / "t.csv").read_bytes()


def test_columns_nobody_states_are_not_written(tmp_path):
    write_modal_table(tmp_path / "t.csv", [ModalRow(0.1, 100.0, mode=2)])
    assert (tmp_path / "t.csv").read_text().splitlines() == ["position_mm,frequency_hz,mode", "100.0,100.0,2"]


@pytest.mark.parametrize(
    "text",
    [
        "position_mm,frequency_hz\n250,189\n",
        "\ufeffposition_mm,frequency_hz\r\n250,189\r\n",  # as saved by Excel
        "frequency_hz , position_mm\n 189 , 250 \n\n",
        'position_mm,frequency_hz,remark,mode_shape_file\n250,189,"fine, really",a.mat\n',
        "position_mm,frequency_hz,preload_n\n250,189,\n",
        'position_mm,frequency_hz\n"250","189"',
    ],
)
def test_variants_that_leave_no_doubt_are_read(tmp_path, text):
    assert read_modal_table(table(tmp_path, text)) == (ModalRow(0.25, 189.0),)


REFUSED = {
    "": "0 bytes",
    "\n\n": "the file is blank",
    "position_mm,frequency_hz\n": "at least one row",
    "position,frequency_hz\n250,189\n": "expected the column 'position_mm'; got 'position'",
    "position_mm,frequency\n250,189\n": "expected the column 'frequency_hz'; got 'frequency'",
    "position_m,frequency_hz\n0.25,189\n": "expected the column 'position_mm'; got 'position_m'",
    "position_mm,frequency_hz,preload_kn\n250,189,0.3\n": "expected the column 'preload_n'; got 'preload_kn'",
    "position_mm,frequency_hz,temperature\n250,189,20\n": "expected the column 'temperature_c'",
    "Position_mm,frequency_hz\n250,189\n": "expected the column 'position_mm'; got 'Position_mm'",
    "frequency_hz\n189\n": "expected the column 'position_mm'; got frequency_hz",
    "a,b\n1,2\n": "expected the column 'position_mm'; got a, b",
    "position_mm,frequency_hz,frequency_hz\n250,189,190\n": "got 'frequency_hz' twice",
    "position_mm;frequency_hz\n250;189\n": "separated by commas",
    "position_mm,frequency_hz\n250,189,7\n": "row 2: expected 2 cells as in the header; got 3",
    "position_mm,frequency_hz\n250,189\n250,189.1x\n": "row 3, column 'frequency_hz': expected a number [Hz]; got",
    "position_mm,frequency_hz\n250,\n": "row 2, column 'frequency_hz': expected a number [Hz]; the cell is empty",
    "position_mm,frequency_hz\n250,nan\n": "expected a finite number above 0 Hz; got nan Hz",
    "position_mm,frequency_hz\n250,inf\n": "got inf Hz",
    "position_mm,frequency_hz\n250,-189\n": "expected a finite number above 0 Hz; got -189 Hz",
    "position_mm,frequency_hz\n250,0\n": "expected a finite number above 0 Hz; got 0 Hz",
    "position_mm,frequency_hz\n250,1_89\n": "expected a number [Hz]",
    "position_mm,frequency_hz,preload_n\n250,189,-5\n": "column 'preload_n': expected a finite number above 0 N",
    "position_mm,frequency_hz,frequency_std_hz\n250,189,0\n": "expected a finite number above 0 Hz; got 0 Hz",
    "position_mm,frequency_hz,n_readings\n250,189,0\n": "of at least 1 -; got 0",
    "position_mm,frequency_hz,n_readings\n250,189,2.5\n": "expected a whole number; got 2.5",
    "position_mm,frequency_hz,payload_kg\n250,189,-1\n": "of at least 0 kg",
    "position_mm,frequency_hz,temperature_c\n250,189,-300\n": "above -273.15 °C",
    "position_mm,frequency_hz,started_at\n250,189,2025-03-01\n": "column 'started_at': expected an RFC 3339 time",
    'position_mm,frequency_hz\n250,"189\n': "comma-separated text",
}


def test_a_table_that_does_not_fit_is_refused_with_row_and_column(tmp_path, subtests):
    for text, case in REFUSED.items():
        with subtests.test(text=text):
            path = table(tmp_path, text)
            with pytest.raises(RecordingFormatError) as caught:
                read_modal_table(path)
            assert case in str(caught.value)
            assert str(caught.value).startswith("table.csv")
            assert "\n" not in str(caught.value)


def test_text_of_another_encoding_is_refused(tmp_path):
    with pytest.raises(RecordingFormatError, match="expected UTF-8 text; byte 25 is 0xb0"):
        read_modal_table(table(tmp_path, "position_mm,frequency_hz,°\n1,2,3\n", "latin-1"))


def test_a_table_without_rows_is_not_written(tmp_path):
    with pytest.raises(RecordingFormatError, match="at least one row"):
        write_modal_table(tmp_path / "t.csv", [])
