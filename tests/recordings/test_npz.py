"""NumPy files: single arrays, record arrays, and archives that would fill the memory."""

import io
import struct
import zipfile

import numpy as np
import pytest

from monitor_core.recordings.elements import bounds
from monitor_core.recordings.raw.binary import npz
from tests.recordings.test_raw import SAMPLES, refusal


@pytest.mark.parametrize(
    "values", [SAMPLES, SAMPLES.reshape(2, 3), SAMPLES.astype(">f4"), np.asfortranarray([[1, 2], [3, 4]])]
)
def test_the_array_of_an_npy_file_is_the_channel_array(tmp_path, values):
    path = tmp_path / "any name.npy"
    np.save(path, values)
    (channel,) = npz.read_channels(path).channels
    assert channel.name == "array"
    np.testing.assert_array_equal(channel.samples, values)


def test_the_fields_of_a_record_array_are_channels(tmp_path):
    table = np.array([(0.0, 1, b"a"), (0.1, 2, b"b"), (0.2, 3, b"c")], dtype=[("t", "f8"), ("n", "i4"), ("s", "S1")])
    np.save(tmp_path / "a.npy", table)
    channels = npz.read_channels(tmp_path / "a.npy")
    assert channels.names == ("array.t", "array.n")
    np.testing.assert_array_equal(channels.channel("array.t").samples, [0.0, 0.1, 0.2])
    with (tmp_path / "a.npz").open("wb") as stream:
        np.savez(stream, log=table)
    assert npz.read_channels(tmp_path / "a.npz").names == ("log.t", "log.n")


def test_an_npy_file_that_is_cut_off_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", SAMPLES)
    content = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(content[:-1])
    assert "expected 6 values as its header says" in refusal(npz.read_channels, tmp_path / "a.npy")
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x09\x00" + content[8:])
    assert "expected a NumPy header of version 1 to 3; got (9, 0)" in refusal(npz.read_channels, tmp_path / "a.npy")


def test_an_archive_that_unpacks_to_a_thousand_times_its_size_is_refused_by_its_size(tmp_path):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (2**24,)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as part:
        part.write(head.getvalue())
        for _ in range(128):
            part.write(bytes(2**20))
    assert (tmp_path / "a.npz").stat().st_size < 2**18
    assert "it announces 134217728: save it without compression" in refusal(npz.read_channels, tmp_path / "a.npz")


def test_a_constant_channel_may_shrink_to_nothing(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", position=np.full(2**20, 0.25), force=np.arange(2**10))
    assert npz.read_channels(tmp_path / "a.npz").channel("position").samples.sum() == 2**18


def test_a_header_of_gigabytes_is_not_read(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as part:
        part.write(b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31))
        for _ in range(64):
            part.write(b" " * 2**20)
    assert "expected a NumPy archive (.npz)" in refusal(npz.read_channels, tmp_path / "a.npz")


def test_more_channels_than_any_recording_has_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(bounds, "MAX_CHANNELS", 8)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        stream = io.BytesIO()
        np.save(stream, np.zeros(2))
        for number in range(9):
            archive.writestr(f"{number}.npy", stream.getvalue())
    assert "expected at most 8 channels; got 9" in refusal(npz.read_channels, tmp_path / "a.npz")


def test_what_is_no_channel_is_said_to_be_not_read(tmp_path):
    path = tmp_path / "a.npz"
    more = {"H": np.ones(4) * 1j, "D": np.ones((2, 3, 4)), "O": np.array([None, 1]), "n": np.array(3.0)}
    np.savez(path, F=np.ones(5), **more)
    channels = npz.read_channels(path)
    assert channels.names == ("F",)
    assert channels.left_out == ("H (complex)", "D (3 dimensions)", "O (objects)")
    np.savez(path, **more)
    assert "got only what is not read: H (complex)" in refusal(npz.read_channels, path)
