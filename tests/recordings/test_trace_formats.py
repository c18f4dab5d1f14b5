"""Exports of TwinCAT Scope and LabVIEW measurement files, written here in their manners."""

from datetime import UTC, datetime

import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.text.columns import read_as_proposed
from tests.recordings.text_files import TWINCAT_START, lvm, twincat


def refusal(path) -> str:
    with pytest.raises(RecordingFormatError) as caught:
        read_channels(path)
    message = str(caught.value)
    assert message.startswith(path.name)
    assert "\n" not in message
    return message


# ---- TwinCAT Scope -------------------------------------------------------------------------------------------------

SCOPES = {
    "tabs": {},
    "tabs and decimal commas": {"comma": True},
    "semicolons at the end of rows": {"separator": ";", "last": ";"},
    "semicolons and decimal commas": {"separator": ";", "comma": True},
    "commas": {"separator": ","},
    "colons": {"separator": ":"},
    "with an end tag": {"end_tag": True},
    "with a byte order mark": {"encoding": "utf-8-sig"},
    "time stamps in full": {"full": True},
    "time stamps in full, semicolons": {"full": True, "separator": ";", "end_tag": True},
}


def test_an_export_of_twincat_scope_is_read_to_the_last_digit(tmp_path, subtests):
    for case, settings in SCOPES.items():
        with subtests.test(case=case):
            path = tmp_path / "scope.csv"
            content, truth = twincat(**settings)
            path.write_bytes(content)
            channels = read_channels(path)
            assert channels.names == tuple(truth)
            for name, numbers in truth.items():
                np.testing.assert_array_equal(channels.channel(name).samples, numbers)
            assert [channel.time.clock for channel in channels.channels] == [None, "Time 1", "Time 1", None, "Time 2"]
            assert [channel.unit for channel in channels.channels] == ["ms", "Nm", None, "ms", "mm"]
            start = datetime(2022, 5, 2, 13, 56, 24, 376000, tzinfo=UTC)  # see TWINCAT_START
            assert {channel.time.zero for channel in channels.channels} == {start}
            assert read_as_proposed(path)[1] is None


def test_damaged_exports_of_twincat_scope_are_refused(tmp_path):
    path = tmp_path / "scope.csv"
    content = twincat()[0].decode().replace("\r\n", "\n")

    def changed(old: str, new: str) -> str:
        assert old in content
        path.write_text(content.replace(old, new, 1))
        return refusal(path)

    assert "expected a time stamp; got '13'" in changed(str(TWINCAT_START), "13")
    assert "expected a blank row above the samples; got none" in changed("\n\n0\t", "\n0\t")
    path.write_text(content[: content.index("\n\n")])
    assert "expected rows about the channels (Name, SymbolName, …)" in refusal(path)
    assert "expected channels of different names; got 'Torque' twice" in changed("Acc nut", "Torque")
    path.write_text(content.replace("\t", " "))
    assert "with tabs or semicolons; blanks also stand in names" in refusal(path)
    path.write_text(content[: content.index("\n0\t")] + "\n")
    assert "expected samples below the header" in refusal(path)
    path.write_text(content.replace("\n7\t", "\n\t"))
    assert "'Torque': expected a value for each of its times; got rows with one of them alone" in refusal(path)
    path.write_text(content.replace("\n7\t", "\n7\tx"))
    assert "column 'Torque': expected a number" in refusal(path)
    path.write_text(twincat(comma=True)[0].decode().replace("\r\n50\t", "\r\n50.5\t"))
    assert "expected a number with a decimal comma; got '50.5'" in refusal(path)


# ---- LVM -----------------------------------------------------------------------------------------------------------

MEASUREMENTS = {
    "no x": {},
    "no x, decimal commas": {"comma": True},
    "no x, commas": {"separator": "Comma"},
    "no x, comments": {"comments": True},
    "one x": {"of_x": "One"},
    "one x, comments and decimal commas": {"of_x": "One", "comments": True, "comma": True},
    "an x for each": {"of_x": "Multi"},
    "an x for each, comments": {"of_x": "Multi", "comments": True},
    "special blocks": {"special": True},
    "Latin-1": {"encoding": "latin-1"},
}


def test_a_labview_measurement_is_read_to_the_last_digit(tmp_path, subtests):
    for case, settings in MEASUREMENTS.items():
        with subtests.test(case=case):
            path = tmp_path / "a.lvm"
            content, truth = lvm(**settings)
            path.write_bytes(content)
            channels = read_channels(path)
            for name, (numbers,) in truth.items():
                np.testing.assert_array_equal(channels.channel(name).samples, numbers)
            of_x = settings.get("of_x", "No")
            force, acceleration = channels.channel("Force"), channels.channel("Accélération")
            assert (force.unit, acceleration.unit) == ("N", "m/s^2")
            assert (force.time.sample_rate, force.time.clock) == {
                "No": (5000.0, None), "One": (None, "X_Value"), "Multi": (None, "X_Value 1")
            }[of_x]  # fmt: skip
            if force.time.clock is not None:
                np.testing.assert_array_equal(
                    channels.channel(force.time.clock).samples, [float(f"{0.0002 * i:.4f}") for i in range(60)]
                )
                assert channels.channel(force.time.clock).unit == "s"
            assert force.time.started_at is None  # the file states no zone


def test_a_measurement_is_recognised_by_its_first_row(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(lvm()[0])
    assert read_channels(path).names == ("Force", "Accélération")
    assert read_as_proposed(path)[1] is None


def test_equal_segments_are_rows_of_an_array_and_others_are_numbered(tmp_path):
    path = tmp_path / "a.lvm"
    content, truth = lvm(n_segments=3)
    path.write_bytes(content)
    np.testing.assert_array_equal(read_channels(path).channel("Force").samples, truth["Force"])
    content, truth = lvm(n_segments=2, of_x="One")
    path.write_bytes(content)
    channels = read_channels(path)
    np.testing.assert_array_equal(channels.channel("2/Force").samples, truth["Force"][1])
    assert channels.channel("2/Force").time.clock == "2/X_Value"


def test_packets_under_one_header_state_no_rate(tmp_path):
    path = tmp_path / "a.lvm"
    path.write_bytes(lvm(stated=20)[0])
    force = read_channels(path).channel("Force")
    assert (force.samples.size, force.time.sample_rate) == (60, None)


def test_the_channel_that_lvm_read_reads_is_the_same(tmp_path):
    library = pytest.importorskip("lvm_read")
    path = tmp_path / "a.lvm"
    path.write_bytes(lvm(comma=True)[0])
    reference = library.read(str(path), read_from_pickle=False, dump_file=False)[0]
    channels = read_channels(path)
    np.testing.assert_array_equal(
        np.transpose([channel.samples for channel in channels.channels]), np.asarray(reference["data"])[:, :2]
    )


def test_damaged_measurements_are_refused(tmp_path):
    path = tmp_path / "a.lvm"
    content = lvm()[0].decode()

    def changed(old: str, new: str) -> str:
        assert old in content
        path.write_text(content.replace(old, new, 1))
        return refusal(path)

    assert "expected 61 samples as its header says; got 60: the file is cut off" in changed(
        "Samples\t60", "Samples\t61"
    )
    assert "expected a positive step; got '0'" in changed("2.0E-4", "0")
    assert "Channels: expected a whole number; got 'two'" in changed("Channels\t2", "Channels\ttwo")
    assert "expected the channels of a segment" in changed("Channels\t2", "Channels\t999999")
    assert "expected the names of 4 channels" in changed("Channels\t2", "Channels\t4")
    assert "X_Columns: expected No, One or Multi; got 'Few'" in changed("X_Columns\tNo", "X_Columns\tFew")
    assert "Separator: expected Tab or Comma; got 'Space'" in changed("Separator\tTab", "Separator\tSpace")
    assert "expected ***End_of_Header***" in changed("***End_of_Header***", "***")
    assert "column 'Force': expected a number" in changed("\r\n\t", "\r\n\tx")
    path.write_text(content[: content.index("***End")] + "***End_of_Header***\n")
    assert "expected a segment of samples behind the header" in refusal(path)
    path.write_text(content[: len(content) // 2])
    assert "cut off" in refusal(path)
