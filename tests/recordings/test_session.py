"""Session files: exact round trip, reproducible bytes, and one scenario for each thing that may be wrong."""

import shutil
import time
import weakref
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from itertools import product

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import (
    Conditions,
    Direction,
    ExcitationQuantity,
    ExcitationSource,
    Placed,
    ResponseQuantity,
    Session,
    Window,
    measurements_of,
)
from monitor_core.recordings import check_file, open_session, read_session, write_session
from tests.conftest import PROJECT_ROOT

START = datetime(2025, 3, 1, 6, 0, 0, 250_000, tzinfo=timezone(timedelta(hours=1)))


def window(number=0, *, dtype=np.float32, n_samples=64, **stated):
    rng = np.random.default_rng(number)
    facts = {
        "excitation": rng.normal(size=n_samples).astype(dtype),
        "response": rng.normal(size=n_samples).astype(dtype),
        "sample_rate": 10_000.0,
        "started_at": START + timedelta(seconds=number),
        "conditions": Conditions(0.25),
        "measurement": "a",
    }
    return Window(**(facts | stated))


def assert_same(session: Session, other: Session) -> None:
    assert (session.axis_id, session.description, session.created) == (other.axis_id, other.description, other.created)
    assert len(session.windows) == len(other.windows)
    for a, b in zip(session.windows, other.windows, strict=True):
        for name in ("excitation", "response"):
            assert getattr(a, name).dtype == getattr(b, name).dtype
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert (a.position_trace is None) == (b.position_trace is None)
        if a.position_trace is not None:
            np.testing.assert_array_equal(a.position_trace, b.position_trace)
        for name in ("sample_rate", "started_at", "conditions", "measurement", "excitation_quantity",
                     "excitation_source", "direction", "position_span", "response_quantity",
                     "response_resolution"):  # fmt: skip
            assert getattr(a, name) == getattr(b, name), name


@pytest.fixture
def session_file(tmp_path):
    """Write a good session of two windows, open for damage."""
    path = tmp_path / "axis.session.h5"
    write_session(path, Session("mill-3-x", (window(0), window(1))))
    return path


def refusal(path) -> str:
    with pytest.raises(RecordingFormatError) as caught:
        read_session(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    return message


# ---- round trip ---------------------------------------------------------------------------------------------------


def test_what_is_written_is_read_bit_for_bit(tmp_path):
    path = tmp_path / "axis.session.h5"
    noisy = np.array([np.nan, np.inf, -0.0, 1e-30])  # fit or not is the quality gate's business
    session = Session(
        "mill-3-x",
        (
            window(0, excitation=noisy, response=noisy, direction=Direction.POSITIVE),
            window(1, dtype=np.float64, excitation_quantity=ExcitationQuantity.FORCE,
                   excitation_source=ExcitationSource.DRIVE, position_span=0.0031),
            window(2, measurement="b – 500 mm", conditions=Conditions(0.5004, 12.5, 23.4, 300.0),
                   position_trace=np.linspace(0.5, 0.501, 64), direction=Direction.NEGATIVE),
            *(
                window(3 + number, dtype=np.float64, excitation_quantity=excitation, response_quantity=response,
                       excitation_source=ExcitationSource.COMMANDED, response_resolution=1e-8)
                for number, (excitation, response) in enumerate(product(ExcitationQuantity, ResponseQuantity))
            ),
        ),
        "trial run",
        datetime(2025, 3, 1, tzinfo=UTC),
    )  # fmt: skip
    write_session(path, session)
    assert_same(read_session(path), session)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(tenths_of_micrometres=st.integers(0, 10**8))
def test_a_position_keeps_its_decimals(tmp_path, tenths_of_micrometres):
    # 0.1234 m must come back as 0.1234, although 0.1234 * 1e3 / 1e3 differs in the last bit for 2 % of such numbers
    path = tmp_path / "axis.session.h5"
    position = float(f"{tenths_of_micrometres}e-7")
    write_session(path, Session("x", (window(conditions=Conditions(position)),)))
    assert read_session(path).windows[0].conditions.position == position


def test_a_position_with_all_bits_in_use_comes_back_within_one_unit_in_the_last_place(tmp_path):
    positions = np.random.default_rng(5).uniform(0.0, 1.0, 50)
    write_session(
        tmp_path / "a.h5", Session("x", tuple(window(i, conditions=Conditions(p)) for i, p in enumerate(positions)))
    )
    back = np.array([w.conditions.position for w in read_session(tmp_path / "a.h5").windows])
    np.testing.assert_array_max_ulp(back, positions, maxulp=1)


def test_the_same_session_gives_the_same_bytes_at_another_time(tmp_path):
    session = Session("x", (window(0), window(1)), created=datetime(2025, 1, 1, tzinfo=UTC))
    write_session(tmp_path / "one.h5", session)
    time.sleep(1.1)  # HDF5 time stamps count seconds
    write_session(tmp_path / "two.h5", session)
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "two.h5").read_bytes()


def test_windows_are_read_one_by_one_and_by_measurement(tmp_path):
    path = tmp_path / "axis.session.h5"
    windows = tuple(window(i, measurement="ab"[i % 2]) for i in range(4))
    write_session(path, Session("x", windows))
    with open_session(path) as reader:
        assert reader.measurements == ("a", "b")
        assert [w.started_at for w in reader.windows_of("b")] == [windows[1].started_at, windows[3].started_at]
        iterator = reader.windows()
        np.testing.assert_array_equal(next(iterator).excitation, windows[0].excitation)
        assert len(list(iterator)) == 3


def test_a_window_that_was_read_is_let_go_before_the_next(session_file):
    with open_session(session_file) as reader:
        windows = reader.windows()
        first = weakref.ref(next(windows).excitation)
        assert first() is None


def test_samples_are_not_copied_and_cannot_be_written(session_file):
    samples = read_session(session_file).windows[0].excitation
    assert not samples.flags.writeable


# ---- accepted variants of other writers ---------------------------------------------------------------------------


def test_a_window_without_measurement_is_a_measurement_named_by_its_group(session_file):
    with h5py.File(session_file, "r+") as file:
        del file["windows/000001"].attrs["measurement"]
    assert read_session(session_file).measurements == ("a", "000001")


def test_unknown_attributes_are_left_alone(session_file):
    with h5py.File(session_file, "r+") as file:
        file["windows/000000"].attrs["operator_note"] = "belt squeaks"
        file["windows/000000"].attrs["lamp"] = True
    assert len(read_session(session_file).windows) == 2


def test_optional_attributes_that_are_not_there_are_none(session_file):
    with h5py.File(session_file, "r+") as file:
        del file["windows/000000"].attrs["direction"]
    first = read_session(session_file).windows[0]
    assert first.conditions == Conditions(0.25, None, None, None)
    assert first.direction is Direction.BOTH


def test_fixed_length_texts_and_arrays_of_one_are_what_matlab_writes(session_file):
    with h5py.File(session_file, "r+") as file:
        attributes = file["windows/000000"].attrs
        attributes["excitation_unit"] = np.bytes_(b"N.m")
        attributes["sample_rate_hz"] = np.array([[10_000.0]])
    assert read_session(session_file).windows[0].sample_rate == 10_000.0


def test_big_endian_compressed_samples_are_read_by_value(session_file):
    values = np.linspace(-1.0, 1.0, 64)
    with h5py.File(session_file, "r+") as file:
        del file["windows/000000/excitation"]
        file["windows/000000"].create_dataset("excitation", data=values.astype(">f4"), chunks=(10,), compression="gzip")
    samples = read_session(session_file).windows[0].excitation
    assert samples.dtype == np.float32
    np.testing.assert_array_equal(samples, values.astype(np.float32))


def test_the_span_of_a_measured_position_needs_no_attribute(session_file):
    with h5py.File(session_file, "r+") as file:
        del file["windows/000000"].attrs["position_span_mm"]
        file["windows/000000/position"] = np.linspace(0.25, 0.252, 64)
    first = read_session(session_file).windows[0]
    assert first.position_span == pytest.approx(0.002, abs=1e-15)  # [m], 0.252 - 0.25 in floating point
    assert first.position_trace.shape == (64,)


# ---- refused, each with one sentence -------------------------------------------------------------------------------

WRONG_ATTRIBUTES = {
    "no unit": ("excitation_unit", None, "excitation_unit: expected a text; it is missing"),
    "unit of a force for a torque": ("excitation_unit", "N", "expected 'N.m'; got 'N'"),
    "unit in another spelling": ("excitation_unit", "Nm", "expected 'N.m'; got 'Nm'"),
    "acceleration in g": ("response_unit", "g", "expected 'm/s2'; got 'g'"),
    "a velocity": ("response_quantity", "velocity", "response_unit: expected 'm/s'; got 'm/s2'"),
    "a current": ("excitation_quantity", "current", "excitation_unit: expected 'A'; got 'N.m'"),
    "unknown response": ("response_quantity", "jerk", "'acceleration' or 'velocity' or 'displacement' or"),
    "unknown quantity": ("excitation_quantity", "voltage", "expected 'torque' or 'force' or 'current' or"),
    "unknown source": (
        "excitation_source",
        "guess",
        "expected 'sensor' or 'drive' or 'drive-by-reference' or",
    ),
    "no resolution": ("response_resolution", 0.0, "response_resolution: expected a positive number; got 0.0 m/s2"),
    "unknown direction": ("direction", "up", "expected '+' or '-' or 'both'; got 'up'"),
    "no sample rate": ("sample_rate_hz", None, "sample_rate_hz: expected a number [Hz]; it is missing"),
    "negative sample rate": ("sample_rate_hz", -1.0, "expected a positive number; got -1.0 Hz"),
    "sample rate that is no number": ("sample_rate_hz", np.nan, "expected a finite number; got nan Hz"),
    "sample rate as a text": ("sample_rate_hz", "10000", "expected a number [Hz]; got str"),
    "sample rate as a list": ("sample_rate_hz", np.array([1e4, 1e4]), "expected a single number or text"),
    "sample rate as a truth value": ("sample_rate_hz", True, "expected a single number or text; got bool"),
    "no position": ("position_mm", None, "position_mm: expected a number [mm]; it is missing"),
    "no span and no measured position": ("position_span_mm", None, "position_span_mm: expected a number [mm]"),
    "negative span": ("position_span_mm", -2.0, "position_span must not be negative; got -0.002 m"),
    "negative payload": ("payload_kg", -1.0, "payload_mass must not be negative; got -1.0 kg"),
    "below absolute zero": ("temperature_c", -300.0, "temperature must lie above -273.15 °C; got -300.0 °C"),
    "no preload": ("preload_n", 0.0, "preload must be positive; got 0.0 N"),
    "empty measurement": ("measurement", "", "measurement: expected a text; got str ''"),
    "time without zone": ("started_at", "2025-03-01T06:00:00", "RFC 3339 time with zone"),
    "time with an unknown zone": ("started_at", "2025-03-01T06:00:00 CET", "got '2025-03-01T06:00:00 CET'"),
    "time of a day that is not": ("started_at", "2025-02-30T06:00:00Z", "day is out of range"),
    "time as a number": ("started_at", 1.7e9, "expected a text; got float 1700000000.0"),
    "text that is not UTF-8": ("measurement", np.bytes_(b"\xff\xfe"), "expected UTF-8 text"),
}


def test_a_wrong_attribute_of_a_window_is_named_with_its_place(session_file, subtests):
    for case, (name, value, sentence) in WRONG_ATTRIBUTES.items():
        with subtests.test(case=case):
            damaged = shutil.copyfile(session_file, session_file.with_name("damaged.session.h5"))
            with h5py.File(damaged, "r+") as file:
                attributes = file["windows/000001"].attrs
                if name in attributes:
                    del attributes[name]
                if value is not None:
                    attributes[name] = value
            message = refusal(damaged)
            assert sentence in message
            assert "/windows/000001" in message


WRONG_ROOT = {
    "no format": ("format", None, "format: expected a text; it is missing"),
    "another format": ("format", "preload-frf-set", "expected 'preload-session'; got 'preload-frf-set'"),
    "a later version": ("version", 2, "version: expected 1; got 2"),
    "no version": ("version", None, "version: expected a number"),
    "no axis": ("axis_id", None, "axis_id: expected a text; it is missing"),
    "created without zone": ("created", "2025-03-01T06:00:00", "RFC 3339 time with zone"),
}


@pytest.mark.parametrize("case", WRONG_ROOT)
def test_a_wrong_attribute_of_the_file_is_named(session_file, case):
    name, value, sentence = WRONG_ROOT[case]
    with h5py.File(session_file, "r+") as file:
        if name in file.attrs:
            del file.attrs[name]
        if value is not None:
            file.attrs[name] = value
    assert sentence in refusal(session_file)


def _replace(group, name, **dataset):
    del group[name]
    group.create_dataset(name, **dataset)


SECOND = "windows/000001"


def _response(file, **dataset):
    _replace(file[SECOND], "response", **dataset)


WRONG_STRUCTURE = {
    "no windows group": (lambda f: f.pop("windows"), "/windows: expected a group; it is missing"),
    "no window": (lambda f: [f["windows"].pop(n) for n in list(f["windows"])], "at least one window; got none"),
    "a window named otherwise": (lambda f: f["windows"].move("000001", "second"), "at least 6 digits; got 'second'"),
    "a dataset for a window": (lambda f: f["windows"].create_dataset("000002", data=[1.0]), "a group; got a dataset"),
    "no response": (lambda f: f[SECOND].pop("response"), "000001/response: expected a dataset; it is missing"),
    "unequal lengths": (lambda f: _response(f, data=np.zeros(63)), "got shapes (64,) and (63,)"),
    "no samples": (
        lambda f: [_replace(f[SECOND], n, data=np.zeros(0)) for n in ("excitation", "response")],
        "at least one sample; got none",
    ),
    "two-dimensional": (lambda f: _response(f, data=np.zeros((64, 1))), "expected one dimension; got shape (64, 1)"),
    "counts of a converter": (lambda f: _response(f, data=np.zeros(64, "i2")), "got int16"),
    "complex": (lambda f: _response(f, data=np.zeros(64, "c8")), "got complex64"),
    "position of another length": (
        lambda f: f[SECOND].create_dataset("position", data=np.zeros(3)),
        "as many samples as the excitation (64)",
    ),
    "announced but never written": (
        lambda f: _response(f, shape=(64,), dtype="f4"),
        "announced but never written",
    ),
    "announced in pieces, not all written": (
        lambda f: _response(f, shape=(64,), dtype="f4", chunks=(32,)),
        "announced but never written",
    ),
    "a length no window has": (
        lambda f: _response(f, shape=(10**12,), dtype="f4", chunks=(1024,)),
        "expected at most",
    ),
    "not in time order": (
        lambda f: f[SECOND].attrs.modify("started_at", "2020-01-01T00:00:00Z"),
        "expected windows in time order",
    ),
}  # fmt: skip


def test_a_wrong_structure_is_refused(session_file, subtests):
    for case, (damage, sentence) in WRONG_STRUCTURE.items():
        with subtests.test(case=case):
            damaged = shutil.copyfile(session_file, session_file.with_name("damaged.session.h5"))
            with h5py.File(damaged, "r+") as file:
                damage(file)
            assert sentence in refusal(damaged)


def test_a_session_does_not_reach_into_other_files(session_file, tmp_path):
    secret = tmp_path / "secret.h5"
    write_session(secret, Session("secret", (window(0),)))
    with h5py.File(session_file, "r+") as file:
        del file["windows/000001"]
        file["windows/000001"] = h5py.ExternalLink(str(secret), "/windows/000000")
    assert "got a link" in refusal(session_file)


def test_samples_stored_outside_the_file_are_refused(session_file, tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(64 * 4))
    with h5py.File(session_file, "r+") as file:
        _replace(file["windows/000001"], "response", shape=(64,), dtype="f4",
                 external=[(str(tmp_path / "secret.bin"), 0, 64 * 4)])  # fmt: skip
    assert "stored in another one" in refusal(session_file)


@pytest.mark.parametrize("content", [b"", b"not HDF5 at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_what_is_no_hdf5_file_is_refused(tmp_path, content):
    path = tmp_path / "axis.session.h5"
    path.write_bytes(content)
    refusal(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    assert "nothing is at this path" in refusal(tmp_path / "nothing.session.h5")
    assert "folder" in refusal(tmp_path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(session_file, share):
    content = session_file.read_bytes()
    session_file.write_bytes(content[: int(share * len(content))])
    refusal(session_file)


def test_a_session_without_windows_is_not_written(tmp_path):
    with pytest.raises(RecordingFormatError, match="at least one window"):
        write_session(tmp_path / "a.h5", Session("x", ()))
    with pytest.raises(RecordingFormatError, match="time order"):
        write_session(tmp_path / "a.h5", Session("x", (window(1), window(0))))
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.release
def test_every_bundled_session_is_valid():
    sessions = sorted((PROJECT_ROOT / "replay_data").glob("*.session.h5"))
    assert len(sessions) > 5
    assert [check_file(path).problems for path in sessions] == [()] * len(sessions)


#: Seconds after the first window, millimetres, and set preload; then which windows make a measurement.
GROUPED = {
    "one after the other": ([(0, 500, None), (2, 500, None), (600, 500, None)], [[0, 1, 2]]),
    "a pause": ([(0, 500, None), (602, 500, None), (604, 500, None)], [[0], [1, 2]]),
    "within the limit of the first": ([(0, 500, None), (2, 519, None), (4, 521, None)], [[0, 1], [2]]),
    "left and come back to": ([(0, 500, None), (2, 600, None), (4, 500, None)], [[0], [1], [2]]),
    "another preload": ([(0, 500, 300.0), (2, 500, 305.0), (4, 500, 150.0), (6, 500, None)], [[0, 1], [2], [3]]),
    "none before each": ([(0, 500, None), (2, 500, 300.0), (4, 500, 500.0)], [[0], [1], [2]]),
    "more than a thousand": ([(2 * i, 500, None) for i in range(1003)], [list(range(1000)), [1000, 1001, 1002]]),
    "no pause for a day": (  # from five in the morning, UTC
        [(550 * i, 500, None) for i in range(158)],
        [list(range(46)), list(range(46, 125)), list(range(125, 158))],
    ),
    "through noon": ([(25200 + 550 * i, 500, None) for i in range(-30, 3)], [list(range(33))]),
    "out of order": ([(700, 500, None), (0, 500, None), (702, 500, None)], [[1], [0, 2]]),
}


def test_windows_of_one_name_are_grouped_by_time_and_place() -> None:
    def grouped(windows):
        placed = [
            Placed("X", START + timedelta(seconds=at), START + timedelta(seconds=at + 1), mm / 1000, preload)
            for at, mm, preload in windows
        ]
        return [[placed.index(window) for window in group] for group in measurements_of(placed)]

    assert {case: grouped(windows) for case, (windows, _) in GROUPED.items()} == {
        case: expected for case, (_, expected) in GROUPED.items()
    }


def test_session_on_disk_is_grouped_as_one_in_memory(tmp_path) -> None:
    """Windows of eleven minutes each follow each other without a pause: the file is asked how long they are."""
    long = window()
    long = replace(long, sample_rate=long.n_samples / 660.0)
    starts = [timedelta(), timedelta(minutes=11), timedelta(minutes=40), timedelta(minutes=51)]
    session = Session("axis", tuple(replace(long, started_at=long.started_at + after) for after in starts))
    write_session(tmp_path / "x.session.h5", session)
    with open_session(tmp_path / "x.session.h5") as reader:
        assert reader.measurements == session.measurements
        assert [len(reader.windows_of(name)) for name in reader.measurements] == [2, 2]
    assert all(name.startswith("a (2") for name in session.measurements)
