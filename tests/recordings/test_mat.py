"""MATLAB files: structures, version 4 in both byte orders, version 7.3, and what is no channel."""

import itertools
import struct

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse

from monitor_core.recordings import check_file
from monitor_core.recordings.raw.binary import mat
from tests.recordings.test_raw import SAMPLES, refusal

MATRIX = np.arange(12.0).reshape(4, 3) / 7.0


@pytest.mark.parametrize("compressed", [False, True])
def test_numbers_inside_structures_are_channels_by_the_names_that_matlab_gives_them(tmp_path, compressed):
    # as dSPACE and LMS write: a structure with a structure inside, and an array of structures
    signals = np.zeros((1, 2), dtype=[("Name", "O"), ("Data", "O")])
    signals[0, 0], signals[0, 1] = ("Force", SAMPLES), ("Acceleration", 2 * SAMPLES)
    record = {"time": SAMPLES, "inner": {"values": MATRIX, "note": "text"}, "Y": signals, "gain": 3.0}
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"record": record, "x": SAMPLES}, do_compression=compressed)
    channels = mat.read_channels(path)
    assert channels.names == ("record.time", "record.inner.values", "record.Y(1).Data", "record.Y(2).Data", "x")
    assert channels.numbers == {"record.gain": 3.0}
    np.testing.assert_array_equal(channels.channel("record.inner.values").samples, MATRIX)
    np.testing.assert_array_equal(channels.channel("record.Y(2).Data").samples, 2 * SAMPLES)


def of_version_4(values, name, *, order="<", kind=0) -> bytes:
    rows, columns = np.atleast_2d(values).shape
    code = kind * 10 + (1000 if order == ">" else 0)
    stored = np.asarray(values, f"{order}{('f8', 'f4', 'i4', 'i2', 'u2', 'u1')[kind]}").tobytes(order="F")
    return struct.pack(f"{order}5i", code, rows, columns, 0, len(name) + 1) + name.encode() + b"\0" + stored


def test_version_4_is_read_in_both_byte_orders_and_all_types(tmp_path, subtests):
    for order, kind in itertools.product("<>", range(6)):
        with subtests.test(order=order, kind=kind):
            path, values = tmp_path / "a.mat", np.array([[1, 2, 3], [4, 5, 60]])
            path.write_bytes(
                of_version_4(values, "x", order=order, kind=kind) + of_version_4(SAMPLES, "y", order=order)
            )
            channels = mat.read_channels(path)
            np.testing.assert_array_equal(channels.channel("x").samples, values)
            np.testing.assert_array_equal(channels.channel("x").samples, scipy.io.loadmat(path)["x"])
            np.testing.assert_array_equal(channels.channel("y").samples, SAMPLES)


def test_version_4_that_is_cut_off_or_no_matlab_file_is_refused(tmp_path):
    path = tmp_path / "a.mat"
    path.write_bytes(of_version_4(SAMPLES, "x")[:-4])
    assert "cut off" in refusal(mat.read_channels, path)
    path.write_bytes(bytes([0, 200, 0, 0]) * 50)
    assert "expected a MATLAB file" in refusal(mat.read_channels, path)


@pytest.fixture
def version_7_3(tmp_path):
    """As MATLAB writes it: 512 bytes of text in front, each array transposed, its class in an attribute."""
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:

        def write(group, name, values, kind, **settings):
            # MATLAB's columns are HDF5's rows
            dataset = group.create_dataset(name, data=np.atleast_2d(values).T, **settings)
            dataset.attrs["MATLAB_class"] = np.bytes_(kind)

        write(file, "matrix", MATRIX, "double", chunks=(1, 2), compression="gzip", shuffle=True)
        write(file, "row", SAMPLES[None], "double")
        write(file, "column", SAMPLES[:, None].astype("f4"), "single")
        write(file, "counts", np.arange(6, dtype="i2")[None], "int16")
        write(file, "gain", np.ones((1, 1)), "double")
        write(file, "label", np.frombuffer("text".encode("utf-16-le"), "u2")[None], "char")
        write(file, "nothing", np.zeros((1, 2), "u8"), "double")
        file["nothing"].attrs["MATLAB_empty"] = np.uint8(1)
        record = file.create_group("record")
        record.attrs["MATLAB_class"] = np.bytes_("struct")
        write(record, "force", 2 * SAMPLES[None], "double")
        write(file.create_group("#refs#"), "a", SAMPLES[None], "double")
        file["z"] = np.zeros((1, 3), dtype=[("real", "f8"), ("imag", "f8")])
        file["elsewhere"] = h5py.ExternalLink("other.h5", "/x")
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + path.read_bytes()[512:])
    return path


def test_version_7_3_has_the_shapes_that_matlab_shows(version_7_3):
    channels = mat.read_channels(version_7_3)
    assert sorted(channels.names) == ["column", "counts", "matrix", "record.force", "row"]
    np.testing.assert_array_equal(channels.channel("matrix").samples, MATRIX)
    np.testing.assert_array_equal(channels.channel("row").samples, SAMPLES)
    assert channels.channel("column").samples.dtype == np.float32
    np.testing.assert_array_equal(channels.channel("counts").samples, np.arange(6))
    np.testing.assert_array_equal(channels.channel("record.force").samples, 2 * SAMPLES)
    assert channels.numbers == {"gain": 1.0}


def test_the_same_arrays_in_version_5_and_7_3_are_the_same_channels(version_7_3, tmp_path):
    older = tmp_path / "older.mat"
    scipy.io.savemat(older, {"matrix": MATRIX, "row": SAMPLES})
    for name in ("matrix", "row"):
        np.testing.assert_array_equal(
            mat.read_channels(older).channel(name).samples, mat.read_channels(version_7_3).channel(name).samples
        )


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"shape": (2**26,), "chunks": (2**20,)}, "it announces 536870912: save it without compression"),
        ({"shape": (2**40,), "chunks": (2**20,)}, "expected at most 67108864 samples"),
        ({"shape": (1024,), "chunks": (64,)}, "announced but never written"),
        ({"shape": (1024,)}, "announced but never written"),
    ],
)
def test_numbers_that_were_announced_and_never_written_are_refused(tmp_path, settings, sentence):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", dtype="f8", **settings)
    assert sentence in refusal(mat.read_channels, path)


def of_version_5(*variables) -> bytes:
    """Write objects, by their name and class: elements of class 17 (opaque), as MATLAB writes them."""

    def element(kind, content):
        return struct.pack("<2I", kind, len(content)) + content.ljust(-(-len(content) // 8) * 8, b"\0")

    number = element(6, struct.pack("<2I", 13, 0)) + element(5, struct.pack("<2i", 1, 1)) + element(1, b"")
    flags, place = element(6, struct.pack("<2I", 17, 0)), element(14, number + element(6, struct.pack("<I", 1)))
    objects = (
        element(14, flags + element(1, name) + element(1, b"MCOS") + element(1, kind) + place)
        for name, kind in variables
    )
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(objects)


def test_objects_that_only_matlab_reads_are_named(tmp_path):
    path = tmp_path / "a.mat"
    path.write_bytes(of_version_5((b"tt", b"timetable")))
    assert "save their columns as arrays" in refusal(mat.read_channels, path)
    scipy.io.savemat(path, {"x": SAMPLES})
    path.write_bytes(
        of_version_5((b"tt", b"timetable"), (b"m", b"missing"), (b"s", b"string")) + path.read_bytes()[128:]
    )
    channels = mat.read_channels(path)
    assert channels.names == ("x",)
    assert channels.left_out[0].startswith("tt (timetable: in MATLAB, save their columns as arrays (t = seconds(")
    assert channels.left_out[1:] == ("m (object of the class missing)", "s (object of the class string)")


def test_what_is_no_channel_is_said_to_be_not_read(tmp_path):
    path = tmp_path / "a.mat"
    cell = np.array([np.ones(3), "x"], dtype=object)
    more = {"H": np.ones(4) * 1j, "S": scipy.sparse.csc_matrix(np.eye(3)), "C": cell, "D": np.ones((2, 3, 4)), "s": "x"}
    said = {"H (complex)", "S (sparse)", "C (cell)", "D (3 dimensions)"}
    scipy.io.savemat(path, {"F": np.ones(5), **more})
    channels = mat.read_channels(path)
    assert channels.names == ("F",)
    assert set(channels.left_out) == said
    assert dict(check_file(path).contents)["not_read"] == channels.left_out
    scipy.io.savemat(path, more)
    message = refusal(mat.read_channels, path)
    assert "got only what is not read: " in message
    assert all(text in message for text in said)
    scipy.io.savemat(path, {"H": np.ones(4) * 1j}, format="4")
    assert "not read: H (complex)" in refusal(mat.read_channels, path)


def test_what_is_no_channel_in_version_7_3_is_said_to_be_not_read(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file["F"], file["D"] = np.ones((1, 5)), np.ones((2, 3, 4))
        file["H"] = np.zeros((1, 3), dtype=[("real", "f8"), ("imag", "f8")])
        file["C"] = np.array([[file["F"].ref]], dtype=h5py.ref_dtype)
        file.create_group("S").attrs["MATLAB_sparse"] = 3
        file["S/data"] = np.ones(3)
    channels = mat.read_channels(path)
    assert channels.names == ("F",)
    assert set(channels.left_out) == {"D (3 dimensions)", "H (complex)", "C (cell)", "S (sparse)"}


def test_a_timetable_of_version_7_3_is_named_with_what_to_do(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["T"] = np.array([[0xDD000000, 2, 1, 1, 1, 1]], "u4").T  # a reference into the objects of the file
        file["T"].attrs.update({"MATLAB_class": np.bytes_("timetable"), "MATLAB_object_decode": np.int32(3)})
        file["x"] = SAMPLES[:, None]
        file["x"].attrs["MATLAB_class"] = np.bytes_("double")
    channels = mat.read_channels(path)
    assert channels.names == ("x",)
    (left_out,) = channels.left_out
    assert left_out.startswith("T (timetable: in MATLAB, save their columns as arrays (t = seconds(")
    with h5py.File(path, "a") as file:
        del file["x"]
    assert "only what is not read: T (timetable" in refusal(mat.read_channels, path)
