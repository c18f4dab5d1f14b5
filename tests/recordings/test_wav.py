"""WAV files, laid out by hand and by two other writers: every sample to the last digit."""

import struct
import wave

import numpy as np
import pytest
import scipy.io.wavfile

from monitor_core.recordings.raw.binary import wav
from tests.recordings.test_raw import refusal

RATE = 51_200


def riff(kind, n_bits, frames: bytes, *, n_channels=1, container=b"RIFF", order="<", extra=b"", extensible=False,
         data_size=None) -> bytes:  # fmt: skip
    size = n_channels * n_bits // 8
    code = 0xFFFE if extensible else kind
    fmt = struct.pack(f"{order}HHIIHH", code, n_channels, RATE, RATE * size, size, n_bits)
    if extensible:
        fmt += struct.pack("<HHIH", 22, n_bits, 0, kind) + b"\x00\x00\x00\x00\x10\x00\x80\x00\x00\xaa\x00\x38\x9b\x71"
    chunks = b"fmt " + struct.pack(f"{order}I", len(fmt)) + fmt + extra
    chunks += b"data" + struct.pack(f"{order}I", len(frames) if data_size is None else data_size) + frames
    return container + struct.pack(f"{order}I", 4 + len(chunks)) + b"WAVE" + chunks + bytes(len(frames) % 2)


def read(tmp_path, content):
    path = tmp_path / "a.wav"
    path.write_bytes(content)
    return wav.read_channels(path)


@pytest.mark.parametrize("kind", ["u1", "i2", "i4", "f4", "f8"])
def test_what_scipy_writes_is_read(tmp_path, kind):
    values = np.array([[1, 2], [3, 4], [100, 250 if kind == "u1" else -100]], kind)
    scipy.io.wavfile.write(tmp_path / "a.wav", 48_000, values)
    channels = wav.read_channels(tmp_path / "a.wav")
    assert channels.names == ("1", "2")
    for number, channel in enumerate(channels.channels):
        np.testing.assert_array_equal(channel.samples, values[:, number])
        assert channel.time.sample_rate == 48_000.0
        assert channel.unit == (None if kind.startswith("f") else "count")
        assert channel.samples.dtype == (np.float32 if kind == "f4" else np.float64)


EXTREMES = [0, 1, -1, 255, -256, 65_536, 2**23 - 1, -(2**23)]


@pytest.mark.parametrize("order", "<>")
def test_24_bits_are_read_with_their_sign(tmp_path, order):
    frames = b"".join(value.to_bytes(3, "little" if order == "<" else "big", signed=True) for value in EXTREMES)
    container = b"RIFF" if order == "<" else b"RIFX"
    (channel,) = read(tmp_path, riff(1, 24, frames, order=order, container=container)).channels
    np.testing.assert_array_equal(channel.samples, EXTREMES)


def test_24_bits_of_the_standard_library_are_read(tmp_path):
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((2, 3, RATE, 0, "NONE", "NONE"))
        file.writeframes(b"".join(value.to_bytes(3, "little", signed=True) for value in EXTREMES))
    first, second = wav.read_channels(tmp_path / "a.wav").channels
    np.testing.assert_array_equal(first.samples, EXTREMES[::2])
    np.testing.assert_array_equal(second.samples, EXTREMES[1::2])


def test_extensible_files_other_chunks_and_padding_are_passed_over(tmp_path):
    frames = np.array([1, -2, 3], "<i2").tobytes()
    odd = b"LIST" + struct.pack("<I", 5) + b"INFOx" + b"\0"  # chunks begin at even bytes
    for content in (riff(1, 16, frames, extensible=True), riff(1, 16, frames, extra=odd)):
        np.testing.assert_array_equal(read(tmp_path, content).channels[0].samples, [1, -2, 3])


def test_sizes_beyond_4_gigabytes_stand_in_a_chunk_of_their_own(tmp_path):
    frames = np.array([1, -2, 3], "<i2").tobytes()
    content = riff(1, 16, frames, container=b"RF64", data_size=0xFFFFFFFF)
    sizes = b"ds64" + struct.pack("<IQQQI", 28, len(content) + 36, len(frames), 3, 0)
    content = content[:12] + sizes + content[12:]
    np.testing.assert_array_equal(read(tmp_path, content).channels[0].samples, [1, -2, 3])


FRAMES = np.arange(6, dtype="<i2").tobytes()
REFUSED = {
    "cut off": (riff(1, 16, FRAMES)[:-3], "the file is cut off, or was never closed by its writer"),
    "never closed": (riff(1, 16, FRAMES, data_size=0xFFFFFFFF), "expected 4294967295 bytes in its chunk 'data'"),
    "half a frame": (riff(1, 16, FRAMES[:-2], n_channels=2), "expected samples of 4 bytes for all channels; got 10"),
    "no samples": (riff(1, 16, b""), "got 0 bytes"),
    "mu-law": (riff(7, 8, FRAMES), "got µ-law: save it as PCM"),
    "12 bits": (riff(1, 12, FRAMES), "got 12 bits"),
    "no channels": (riff(1, 16, FRAMES, n_channels=0), "got 0 channels"),
    "a picture": (b"RIFF\x00\x00\x00\x00WEBP", "expected a WAV file that begins with RIFF"),
    "no format": (b"RIFF\x00\x00\x00\x00WAVE", "expected one chunk 'fmt '; got 0"),
}  # fmt: skip


def test_wav_files_that_do_not_fit_are_refused(tmp_path, subtests):
    for case, (content, sentence) in REFUSED.items():
        with subtests.test(case=case):
            path = tmp_path / "a.wav"
            path.write_bytes(content)
            assert sentence in refusal(wav.read_channels, path)
