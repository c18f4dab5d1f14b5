"""Readers of raw files, each on files built from bytes: one scenario per quirk."""

import itertools
import struct
import zipfile
from datetime import UTC, datetime

import numpy as np
import pytest
import scipy.io

from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.raw.binary import mat, npz, tdms, uff58
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.text import columns

SAMPLES = np.array([0.0, 0.5, -1.25, 3.0, 2.5, -2.0])


def refusal(read, path) -> str:
    with pytest.raises(RecordingFormatError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(path.name)
    assert "\n" not in message
    return message


# ---- text columns --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "force,acc\n1,2\n-0.5,4e-1\n",
        "\ufeffforce;acc\r\n1;2\r\n-0.5;0.4\r\n\r\n",
        "force\tacc\n1\t2\n-0.5\t.4\n",
        "force acc\n1 2\n -0.5   0.4\n",
    ],
)
def test_columns_are_read_with_any_of_the_separators(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode())
    channels = columns.read_channels(path)
    assert channels.names == ("force", "acc")
    np.testing.assert_array_equal(channels.channel("acc").samples, [2.0, 0.4])
    assert channels.channel("acc").unit is None


def test_columns_without_header_are_numbered(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("0.0\t1\n1e-3\tnan\n")  # a NaN is for the quality gate to judge
    channels = columns.read_channels(path)
    assert channels.names == ("1", "2")
    np.testing.assert_array_equal(channels.channel("2").samples, [1.0, np.nan])


TEXT_REFUSED = {
    "decimal comma": ("t;a\n0;1,5\n", "row 2, column 'a': expected a number with a decimal point; got '1,5'"),
    "decimal comma and comma separator": ("t,a\n0,0,1,5\n", "row 2: expected 2 numbers separated by comma; got 4"),
    "rows of unequal length": ("t,a\n0,1\n1\n2,3\n", "row 3: expected 2 numbers separated by comma; got 1"),
    "a word among numbers": ("t,a\n0,1\n1,overload\n", "row 3, column 'a': expected a number with a decimal point"),
    "two headers": ("t,a\ns,V\n0,1\n", "row 2, column 't'"),
    "one name twice": ("a,a\n0,1\n", "got 'a' twice"),
    "a header alone": ("t,a\n", "row 2: expected numbers under the header; got none"),
    "blank": ("\n \n", "the file is blank"),
    "underscore": ("t,a\n0,1_0\n", "got '1_0'"),
}


def test_columns_that_leave_doubt_are_refused(tmp_path, subtests):
    for case, (text, sentence) in TEXT_REFUSED.items():
        with subtests.test(case=case):
            path = tmp_path / "a.csv"
            path.write_text(text)
            assert sentence in refusal(columns.read_channels, path)


def test_binary_content_is_no_text(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\x80\x81\x82")
    assert "expected UTF-8 text; byte 0 is 0x80" in refusal(columns.read_channels, path)


# ---- NPZ -----------------------------------------------------------------------------------------------------------


def test_arrays_of_real_numbers_are_channels(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, force=SAMPLES.astype(">f4"), counts=np.arange(3, dtype="i2"), rows=np.ones((2, 3)),
             cube=np.ones((2, 2, 2)), label=np.array("text"), z=np.ones(3, complex))  # fmt: skip
    channels = npz.read_channels(path)
    assert channels.names == ("force", "counts", "rows")
    assert channels.channel("force").samples.dtype == np.float32
    np.testing.assert_array_equal(channels.channel("force").samples, SAMPLES)
    assert channels.channel("counts").samples.dtype == np.float64
    assert channels.channel("rows").samples.shape == (2, 3)


def test_pickled_objects_are_never_loaded(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, evil=np.array([{"a": 1}], dtype=object))
    assert "of numbers; got only what is not read: evil (objects)" in refusal(npz.read_channels, path)


def test_a_header_that_promises_more_than_the_archive_holds_is_refused_at_once(tmp_path):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (50000000,), }".ljust(117) + b"\n"
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(80))
    assert "expected 50000000 values as its header says" in refusal(npz.read_channels, tmp_path / "a.npz")


def test_a_truncated_archive_and_a_flipped_byte_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, x=SAMPLES)
    content = bytearray(path.read_bytes())
    path.write_bytes(content[:-30])
    assert "expected a NumPy archive" in refusal(npz.read_channels, path)
    content[content.index(SAMPLES.tobytes())] ^= 1  # the archive's checksum sees it
    path.write_bytes(content)
    assert "it is damaged or cut off" in refusal(npz.read_channels, path)


# ---- MAT -----------------------------------------------------------------------------------------------------------

NUMERIC = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]


def test_what_scipy_writes_in_version_5_is_read_as_scipy_reads_it(tmp_path, subtests):
    for compressed, kind in itertools.product([False, True], NUMERIC):
        with subtests.test(compressed=compressed, kind=kind):
            path = tmp_path / "a.mat"
            numbers = {"column": np.arange(7, dtype=kind)[:, None], "x": np.arange(6, dtype=kind).reshape(2, 3)}
            scipy.io.savemat(path, numbers, do_compression=compressed)
            channels, reference = mat.read_channels(path), scipy.io.loadmat(path)
            assert channels.names == ("column", "x")
            for name in channels.names:
                np.testing.assert_array_equal(channels.channel(name).samples, np.squeeze(reference[name]))
            assert channels.channel("x").samples.dtype == (np.float32 if kind == "f4" else np.float64)


def test_version_4_is_read(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"x": SAMPLES}, format="4")
    np.testing.assert_array_equal(mat.read_channels(path).channel("x").samples, SAMPLES)


def test_what_is_no_channel_is_left_out(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"x": SAMPLES, "gain": 3.0, "s": {"a": 1}, "c": "text", "z": 1j * SAMPLES,
                            "cube": np.ones((2, 2, 2)), "cell": np.array([1, "a"], object)})  # fmt: skip
    assert mat.read_channels(path).names == ("x",)


def big_endian_matrix(values) -> bytes:
    def element(kind, content):
        return struct.pack(">II", kind, len(content)) + content.ljust(-(-len(content) // 8) * 8, b"\0")

    body = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">ii", len(values), 1))
    body += struct.pack(">HH4s", 2, 1, b"xy\0\0")  # a name short enough to stand in its own tag
    body += element(9, np.asarray(values, ">f8").tobytes())
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + element(14, body)


def test_big_endian_files_are_read(tmp_path):
    path = tmp_path / "a.mat"
    path.write_bytes(big_endian_matrix(SAMPLES))
    np.testing.assert_array_equal(mat.read_channels(path).channel("xy").samples, SAMPLES)


def test_damaged_matlab_files_are_refused(tmp_path):
    path = tmp_path / "a.mat"
    content = big_endian_matrix(SAMPLES)
    path.write_bytes(content[:-20])
    assert "cut off" in refusal(mat.read_channels, path)
    path.write_bytes(content.replace(struct.pack(">ii", 6, 1), struct.pack(">ii", 7, 1)))
    assert "expected a MATLAB file" in refusal(mat.read_channels, path)


def test_a_file_of_version_7_3_without_its_contents_is_refused(tmp_path):
    path = tmp_path / "a.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(64))
    assert "expected an HDF5 file" in refusal(mat.read_channels, path)


# ---- TDMS ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def tdms_file(tmp_path):
    writer = pytest.importorskip("nptdms")
    path = tmp_path / "a.tdms"
    waveform = {"wf_increment": 1e-4, "wf_start_time": np.datetime64("2025-03-01T06:00:00.25"), "unit_string": "N.m"}
    with writer.TdmsWriter(path) as file:
        file.write_segment(
            [
                writer.ChannelObject(
                    "Drive", "Torque", SAMPLES.astype("f4"), properties=waveform | {"wf_start_offset": 0.5}
                ),
                writer.ChannelObject(
                    "Drive",
                    "Counts",
                    np.arange(6, dtype="i2"),
                    properties={"wf_start_time": np.datetime64("1904-01-01")},
                ),
                writer.ChannelObject("Drive", "Remark", ["a", "b"]),
            ]
        )
        file.write_segment([writer.ChannelObject("Drive", "Torque", SAMPLES.astype("f4"))])
    return path  # fmt: skip


def test_tdms_channels_know_unit_rate_and_start_in_utc(tdms_file):
    channels = tdms.read_channels(tdms_file)
    assert channels.names == ("Drive/Torque", "Drive/Counts")
    torque = channels.channel("Drive/Torque")
    np.testing.assert_array_equal(torque.samples, np.tile(SAMPLES, 2))
    assert torque.samples.dtype == np.float32
    assert torque.unit == "N.m"
    assert torque.time.sample_rate == pytest.approx(10_000.0, rel=1e-15)
    assert torque.time.started_at.isoformat() == "2025-03-01T06:00:00.750000+00:00"
    assert channels.channel("Drive/Counts").time.started_at is None  # 1904 is LabVIEW's word for *no time*


def test_what_a_tdms_file_states_behind_its_samples_is_of_them(tmp_path):
    writer = pytest.importorskip("nptdms")
    stated = {"wf_increment": 1.0 / 1024.0, "wf_start_time": np.datetime64("2025-03-01T06:00:00")}
    for of_last in (np.array([]), np.arange(8.0)):
        with writer.TdmsWriter(tmp_path / "a.tdms") as file:
            file.write_segment([writer.ChannelObject("group", "a", np.arange(8.0))])
            file.write_segment([writer.ChannelObject("group", "a", of_last, stated)])
        (channel,) = read_channels(tmp_path / "a.tdms").channels
        assert [run.sample_rate for run in channel.time.runs] == [1024.0] * len(channel.time.runs)
        assert channel.time.started_at == datetime(2025, 3, 1, 6, tzinfo=UTC)


def test_a_last_segment_that_is_cut_off_is_not_dropped_in_silence(tdms_file):
    content = tdms_file.read_bytes()
    second = content.index(b"TDSm", 4)
    for end in (len(content) - 1, second + 30, second + 10):  # in the samples, in the metadata, in the lead-in
        tdms_file.write_bytes(content[:end])
        assert "expected a" in refusal(tdms.read_channels, tdms_file)


def test_an_index_file_of_another_recording_is_not_believed(tdms_file):
    (tdms_file.parent / "a.tdms_index").write_bytes(b"TDSh" + bytes(24))
    assert tdms.read_channels(tdms_file).names == ("Drive/Torque", "Drive/Counts")


def test_a_scale_that_nptdms_would_leave_out_is_refused(tmp_path):
    writer = pytest.importorskip("nptdms")
    path = tmp_path / "a.tdms"
    for properties, sentence in (
        ({"NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Cubic"}, "got 'Cubic'"),
        ({"NI_Number_Of_Scales": 2_000_000_000}, "at most 100 scales"),  # npTDMS would look for each of them
    ):
        with writer.TdmsWriter(path) as file:
            file.write_segment([writer.ChannelObject("g", "c", SAMPLES, properties=properties)])
        assert sentence in refusal(tdms.read_channels, path)


def test_a_time_base_that_stands_still_is_refused(tmp_path):
    writer = pytest.importorskip("nptdms")
    with writer.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment([writer.ChannelObject("g", "c", SAMPLES, properties={"wf_increment": 0.0})])
    assert "expected a positive wf_increment; got 0.0" in refusal(tdms.read_channels, tmp_path / "a.tdms")


@pytest.mark.parametrize(("read", "library"), [(tdms.read_channels, "npTDMS"), (uff58.read_channels, "pyuff")])
def test_a_missing_library_is_named(monkeypatch, tmp_path, read, library):
    monkeypatch.setitem(__import__("sys").modules, library.lower(), None)
    with pytest.raises(MissingReaderError, match=f"pip install {library}"):
        read(tmp_path / "a")


# ---- UFF58 ---------------------------------------------------------------------------------------------------------


def uff_set(values, *, binary=False, n_points=None, function=1, spacing=1, increment=1e-4, abscissa="s",
            label="Acc 1", unit="m/s2", order=1) -> bytes:  # fmt: skip
    """One data set 58 of single precision, as the format's description lays it out."""
    data = np.asarray(values, "<f4" if order == 1 else ">f4")
    first = f"    58b{order:6d}{2:6d}{11:12d}{data.nbytes:12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    lines = [
        "    -1",
        first if binary else "    58",
        label, "NONE", "01-Mar-25 06:00:00", "NONE", "NONE",
        f"{function:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{1:10d}{3:4d} {'NONE':10s}{0:10d}{0:4d}",
        f"{2:10d}{data.size if n_points is None else n_points:10d}{spacing:10d}{0.0:13.5E}{increment:13.5E}{0.0:13.5E}",
        f"{17:10d}{0:5d}{0:5d}{0:5d} {'Time':20s} {abscissa:20s}",
        f"{12:10d}{0:5d}{0:5d}{0:5d} {'Acceleration':20s} {unit:20s}",
        *[f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {'NONE':20s}"] * 2,
    ]  # fmt: skip
    head = "\r\n".join(lines).encode("latin-1") + b"\r\n"
    if binary:
        return head + data.tobytes() + b"    -1\r\n"
    rows = ["".join(f"{v:13.5E}" for v in data[i : i + 6]) for i in range(0, data.size, 6)]
    return head + "\r\n".join(rows).encode() + b"\r\n    -1\r\n"


@pytest.fixture
def uff_file(tmp_path):
    pytest.importorskip("pyuff")
    return tmp_path / "a.uff"


@pytest.mark.parametrize(("binary", "order"), [(False, 1), (True, 1), (True, 2)])
def test_time_histories_in_text_and_binary_of_both_byte_orders_are_read(uff_file, binary, order):
    values = np.arange(8.0) - 2.5
    uff_file.write_bytes(uff_set(values, binary=binary, order=order) + uff_set(2 * values, label="Acc 2", unit="g"))
    channels = uff58.read_channels(uff_file)
    assert channels.names == ("Acc 1", "Acc 2")
    np.testing.assert_array_equal(channels.channel("Acc 1").samples, values)
    assert [channel.unit for channel in channels.channels] == ["m/s2", "g"]
    assert channels.channels[0].time.sample_rate == pytest.approx(10_000.0, rel=1e-15)
    assert channels.channels[0].time.started_at is None  # its date carries no zone


def test_labels_that_are_not_distinct_give_way_to_numbers(uff_file):
    uff_file.write_bytes(uff_set(SAMPLES) + uff_set(SAMPLES))
    assert uff58.read_channels(uff_file).names == ("1", "2")


def test_spectra_beside_time_histories_are_left_out(uff_file):
    uff_file.write_bytes(uff_set(SAMPLES, function=4, label="FRF") + uff_set(SAMPLES))
    assert uff58.read_channels(uff_file).names == ("Acc 1",)


UFF_REFUSED = {
    "header promises millions": (uff_set(SAMPLES, n_points=2_500_000), "expected 2500000 samples as its header says"),
    "header promises billions": (uff_set(SAMPLES, n_points=2_000_000_000), "the header promises 2000000000"),
    "binary shorter than promised": (uff_set(SAMPLES, binary=True, n_points=7), "expected 7 samples as its"),
    "a spectral density": (uff_set(SAMPLES, function=9), "got function type 9 (power spectral density)"),
    "uneven spacing": (uff_set(SAMPLES, spacing=0), "even spacing"),
    "milliseconds": (uff_set(SAMPLES, abscissa="ms"), "expected an abscissa in s; got 'ms'"),
    "no step in time": (uff_set(SAMPLES, increment=0.0), "expected a positive abscissa increment; got 0.0 s"),
    "cut off in the samples": (uff_set(SAMPLES)[:-30], "the file is cut off"),
    "second set cut off": (uff_set(SAMPLES) + uff_set(SAMPLES)[:200], "the file is cut off"),
    "no universal file": (b"hello\n", "got 0 of them"),
    "geometry only": (b"    -1\n   151\nmodel\nNONE\nx\ny\nz\nu\nv\n    -1\n", "got data sets 151"),
    "header of words": (uff_set(SAMPLES).replace(b"1.00000E-04", b"one percent"), "expected a universal file"),
}  # fmt: skip


def test_universal_files_that_do_not_fit_are_refused(uff_file, subtests):
    for case, (content, sentence) in UFF_REFUSED.items():
        with subtests.test(case=case):
            uff_file.write_bytes(content)
            assert sentence in refusal(uff58.read_channels, uff_file)


def test_a_header_that_is_not_ascii_is_read(uff_file):
    uff_file.write_bytes(uff_set(SAMPLES, unit="m/s\xb2"))
    np.testing.assert_array_equal(uff58.read_channels(uff_file).channels[0].samples, SAMPLES)


# ---- what a library says of a damaged file ---------------------------------------------------------------------------


def damaged_tdms(path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("g", "torque", SAMPLES)])
    content = bytearray(path.read_bytes())
    content[28:32] = b"\x07\x00\x00\x00"  # seven objects announced, where there is one
    path.write_bytes(content)


def cut_parquet(path):
    pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq
    from pyarrow import table

    pq.write_table(table({"x": SAMPLES}), path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def cut_xlsx(path):
    book = pytest.importorskip("openpyxl").Workbook()
    for value in SAMPLES:
        book.active.append([float(value)])
    book.save(path)
    path.write_bytes(path.read_bytes()[:-200])


@pytest.mark.parametrize(
    ("name", "write"), [("a.tdms", damaged_tdms), ("a.parquet", cut_parquet), ("a.xlsx", cut_xlsx)]
)
def test_no_sentence_has_the_name_of_an_error_of_a_library(tmp_path, name, write):
    write(tmp_path / name)
    sentence = refusal(read_channels, tmp_path / name)
    assert sentence.endswith("it is damaged or cut off: export it anew, or copy it again")
    assert "Error" not in sentence
