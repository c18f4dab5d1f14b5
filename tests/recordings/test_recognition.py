"""Files are known by what they hold, whatever their names; a wrong one is named, with the next step."""

import gzip
import itertools
import wave
import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings import check_file, read_channels
from monitor_core.recordings.recognition import (
    CALIBRATION,
    CHANNEL_MAP,
    KINDS,
    MODAL_TABLE,
    MODEL,
    SESSION,
    format_of,
    is_raw,
    require_format,
)


def zipped(path, *names):
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, "x")


def wav(path):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(16))


def written(path, write, **content):
    with path.open("wb") as stream:  # under any name: the libraries would append their own ending
        write(stream, **content)


def foreign_hdf5(path):
    with h5py.File(path, "w") as file:
        file["scope/channel1"] = np.ones(3)


#: How a file is written, and what it is: by the specifications of the formats, or by another library.
FOREIGN = {
    "docx": lambda path: zipped(path, "[Content_Types].xml", "word/document.xml"),
    "pptx": lambda path: zipped(path, "[Content_Types].xml", "ppt/presentation.xml"),
    "xlsx": lambda path: zipped(path, "[Content_Types].xml", "xl/workbook.xml"),
    "ods": lambda path: zipped(path, "mimetype", "content.xml"),
    "zip": lambda path: zipped(path, "readme.txt"),
    "npz": lambda path: written(path, np.savez, x=np.ones(3)),
    "npy": lambda path: written(path, np.save, arr=np.ones(3)),
    "mat": lambda path: written(path, scipy.io.savemat, mdict={"x": np.ones(3)}),
    "wav": wav,
    "hdf5": foreign_hdf5,
    "gzip": lambda path: path.write_bytes(gzip.compress(b"0,1\n")),
    "pdf": lambda path: path.write_bytes(b"%PDF-1.7\n"),
    "png": lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00"),
    "jpeg": lambda path: path.write_bytes(b"\xff\xd8\xff\xe0\x00\x10JFIF"),
    "xls": lambda path: path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(16)),
    "parquet": lambda path: path.write_bytes(b"PAR1" + bytes(16)),
    "mdf4": lambda path: path.write_bytes(b"MDF     4.10    " + bytes(16)),
    "zstd": lambda path: path.write_bytes(b"\x28\xb5\x2f\xfd\x04\x00"),
    "html": lambda path: path.write_bytes(b"<!DOCTYPE html><html></html>"),
    "xml": lambda path: path.write_bytes(b"<?xml version='1.0'?><x/>"),
    "lvm": lambda path: path.write_bytes(b"LabVIEW Measurement\t\nWriter_Version\t2\n"),
    "pickle": lambda path: path.write_bytes(b"\x80\x04\x95\x00"),
    "ide": lambda path: path.write_bytes(b"\x1aE\xdf\xa3\x9f\x42\x86\x81\x01\x00"),
    "json": lambda path: path.write_bytes(b'{"measurements": []}'),
    "tdms-index": lambda path: path.write_bytes(b"TDSh" + bytes(24)),
}


def test_a_file_is_known_by_what_it_holds(tmp_path, subtests):
    for name, ending in itertools.product(FOREIGN, [".csv", ".dat", ""]):
        with subtests.test(name=name, ending=ending):
            path = tmp_path / f"file{ending}"
            FOREIGN[name](path)
            assert format_of(path) == name


def test_what_is_no_recording_is_named_and_never_called_valid(tmp_path, subtests):
    for name in [name for name in FOREIGN if not is_raw(name)]:
        with subtests.test(name=name):
            path = tmp_path / "measurement.csv"
            FOREIGN[name](path)
            report = check_file(path)
            assert (report.format, report.valid, report.usable_by) == (name, False, ())
            (sentence,) = report.problems
            assert KINDS[name].what in sentence
            assert "UTF-8" not in sentence
            with pytest.raises(RecordingFormatError) as caught:
                read_channels(path)
            assert KINDS[name].what in str(caught.value)


def test_an_xlsx_is_not_called_npz_and_a_wav_is_not_called_text(tmp_path):
    FOREIGN["xlsx"](tmp_path / "a.xlsx")
    FOREIGN["wav"](tmp_path / "a.wav")
    assert check_file(tmp_path / "a.xlsx").format == "xlsx"
    assert check_file(tmp_path / "a.wav").format == "wav"
    for name in ("a.xlsx", "a.wav"):
        assert not any(word in " ".join(check_file(tmp_path / name).problems) for word in ("NumPy", "UTF-8"))


def test_letters_of_a_country_and_utf16_are_text(tmp_path):
    (tmp_path / "latin.csv").write_bytes("Zeit;Kraft längs\n0;1\n".encode("latin-1"))
    (tmp_path / "wide.csv").write_bytes("Zeit;Kraft\n0;1\n".encode("utf-16"))
    (tmp_path / "cut.csv").write_bytes(b"a" * 65535 + "ä".encode() + b"\n")  # a letter across the end of the look
    for name in ("utf-16-le", "utf-16-be"):  # without the mark at the beginning
        (tmp_path / f"{name}.csv").write_bytes("Zeit;Kraft längs\n0;1\n".encode(name))
    assert {format_of(path) for path in tmp_path.iterdir()} == {"csv"}


def test_lines_of_a_response_are_no_modal_table(tmp_path):
    (tmp_path / "frf.csv").write_text("frequency_hz,real,imag\n1,2,3\n")
    (tmp_path / "modes.csv").write_text("frequency_hz,position_mm\n1,2\n")
    assert [format_of(tmp_path / name) for name in ("frf.csv", "modes.csv")] == ["csv", "modal-table"]


def test_a_folder_is_named_as_one(tmp_path, monkeypatch):
    folder = tmp_path / "measurements"
    folder.mkdir()
    monkeypatch.chdir(folder)
    from pathlib import Path

    for path in (Path(), folder):
        (sentence,) = check_file(path).problems
        assert sentence == "measurements: expected a file; got a folder: name one of the files in it"


WRONG = {
    "raw file for a session": ("a.mat", (SESSION,), "preload check a.mat --write-map a.toml", "preload import a.mat"),
    "table for a calibration": ("t.csv", (CALIBRATION,), "got a modal table", "preload calibrate t.csv --out t.cal"),
    "raw file for a map": ("a.mat", (CHANNEL_MAP,), "got a MATLAB file", "preload check a.mat --write-map a.toml"),
    "calibration for data": ("c.json", (SESSION, MODAL_TABLE), "got a calibration", "--calibration"),
    "map for a model": ("m.toml", (MODEL,), "got a channel map", "preload import takes it as --map"),
    "picture for a session": ("p.png", (SESSION,), "got a PNG picture", "export the measurement"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_of_another_kind_gets_its_name_and_the_next_step(tmp_path, case):
    scipy.io.savemat(tmp_path / "a.mat", {"x": np.ones(3)})
    (tmp_path / "t.csv").write_text("position_mm,frequency_hz\n250,189\n")
    (tmp_path / "c.json").write_text('{"format": "preload-calibration"}')
    (tmp_path / "m.toml").write_text('axis_id = "x"\n')
    FOREIGN["png"](tmp_path / "p.png")
    name, expected, *parts = WRONG[case]
    with pytest.raises(RecordingFormatError) as caught:
        require_format(tmp_path / name, *expected)
    assert all(part in str(caught.value) for part in parts), str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_shell_sees_a_name_with_blanks_as_one_word(tmp_path):
    path = tmp_path / "axis 3; rm -rf.mat"
    scipy.io.savemat(path, {"x": np.ones(3)})
    with pytest.raises(RecordingFormatError, match=r"preload check 'axis 3; rm -rf\.mat' --write-map 'axis 3; rm -rf"):
        require_format(path, SESSION)


@pytest.mark.parametrize("ending", [".tdms", ".mat", ".npz"])
def test_columns_of_text_by_another_name_are_said_to_be_text(tmp_path, ending):
    path = tmp_path / f"run{ending}"
    path.write_text("t;F\n0,1;2,5\n0,2;2,5\n")
    with pytest.raises(RecordingFormatError, match=r"got text with rows of numbers: name it run\.csv"):
        format_of(path)
