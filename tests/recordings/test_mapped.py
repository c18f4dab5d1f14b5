"""Raw files through a channel map: units, time base, positions, windows; nothing guessed, nothing said twice."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Direction, ExcitationQuantity, ExcitationSource
from monitor_core.recordings import import_session, read_channel_map
from monitor_core.recordings.elements.units import Quantity, canonical_unit, factor_to_si, sensor_factor
from monitor_core.recordings.raw.mapping import channel_map

START = datetime(2025, 3, 1, 6, tzinfo=UTC)
MAP = """
axis_id = "mill-3-x"
[excitation]
channel = "force"
quantity = "force"
source = "sensor"
unit = "kN"
[response]
channel = "acc"
unit = "g"
[window]
sample_rate_hz = 1000
started_at = 2025-03-01T06:00:00Z
position_mm = 123.4
position_span_mm = 0.5
"""
WITH_POSITION = (
    MAP.replace("position_mm = 123.4\nposition_span_mm = 0.5\n", "") + '[position]\nchannel = "x"\nunit = "mm"\n'
)
WITH_TIME = MAP.replace("sample_rate_hz = 1000\n", "") + '[time]\nchannel = "t"\nunit = "ms"\n'
FORCE = np.array([0.0, 1.0, 2.0, -1.0, 0.5, 0.25])
ACCELERATION = np.array([1.0, -1.0, 0.5, 2.0, 0.0, 3.0])


def read(tmp_path, text=MAP, **arrays):
    arrays = {"force": FORCE, "acc": ACCELERATION} | arrays
    np.savez(tmp_path / "hit.npz", **arrays)
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    return import_session([tmp_path / "hit.npz"], read_channel_map(tmp_path / "map.toml")).session


def test_a_file_becomes_one_window_in_si(tmp_path):
    session = read(tmp_path)
    (window,) = session.windows
    assert session.axis_id == "mill-3-x"
    np.testing.assert_array_equal(window.excitation, 1e3 * FORCE)
    np.testing.assert_array_equal(window.response, 9.80665 * ACCELERATION)  # 1 g by definition, 3rd CGPM
    assert (window.sample_rate, window.started_at, window.measurement) == (1000.0, START, "hit")
    assert (window.conditions.position, window.position_span) == (0.1234, 0.0005)
    assert (window.excitation_quantity, window.excitation_source) == (ExcitationQuantity.FORCE, ExcitationSource.SENSOR)
    assert window.direction is Direction.BOTH


def test_single_precision_stays_single(tmp_path):
    assert read(tmp_path, force=FORCE.astype("f4")).windows[0].excitation.dtype == np.float32


def test_a_long_record_is_cut_into_windows_that_follow_each_other(tmp_path):
    windows = read(tmp_path, MAP + "samples_per_window = 2\n").windows
    assert [list(w.excitation) for w in windows] == [[0.0, 1000.0], [2000.0, -1000.0], [500.0, 250.0]]
    assert [w.started_at - START for w in windows] == [timedelta(milliseconds=m) for m in (0, 2, 4)]
    assert {w.measurement for w in windows} == {"hit"}


@pytest.mark.parametrize(("where", "turn"), [("rows", np.asarray), ("columns", np.transpose)])
def test_windows_stand_in_the_rows_or_columns_of_an_array(tmp_path, where, turn):
    text = MAP + f'windows_in = "{where}"\nwindow_interval_s = 2.5\n'
    windows = read(tmp_path, text, force=turn(FORCE.reshape(2, 3)), acc=turn(ACCELERATION.reshape(2, 3))).windows
    assert [list(w.excitation) for w in windows] == [[0.0, 1000.0, 2000.0], [-1000.0, 500.0, 250.0]]
    assert windows[1].started_at - windows[0].started_at == timedelta(seconds=2.5)


def test_a_measured_position_gives_position_span_and_trace(tmp_path):
    (window,) = read(tmp_path, WITH_POSITION, x=np.array([250.0, 250.5, 251.0, 250.0, 250.5, 251.0])).windows
    assert window.conditions.position == pytest.approx(0.2505, rel=1e-15)
    assert window.position_span == pytest.approx(0.001, rel=1e-12)
    np.testing.assert_allclose(window.position_trace[:3], [0.25, 0.2505, 0.251], rtol=1e-15)
    # one that is no number is for the gate of its window, and refuses no file
    (window,) = read(tmp_path, WITH_POSITION, x=np.array([250.0, np.nan, 251.0, 250.0, 250.5, 251.0])).windows
    assert window.conditions.position == pytest.approx(0.2505, rel=1e-15)
    assert window.position_span == pytest.approx(0.001, rel=1e-12)


def test_sampling_times_in_a_channel_give_the_rate(tmp_path):
    times = np.round(np.arange(6) * 0.1, 4) + 7.0  # [ms], as printed
    assert read(tmp_path, WITH_TIME, t=times).windows[0].sample_rate == pytest.approx(10_000.0, rel=1e-12)


def test_a_motor_current_becomes_a_torque(tmp_path):
    text = MAP.replace('quantity = "force"', 'quantity = "torque"').replace('source = "sensor"', 'source = "drive"')
    text = text.replace('unit = "kN"', 'unit = "mA"\nsensitivity = 0.74\nsensitivity_unit = "N.m/A"')
    np.testing.assert_allclose(read(tmp_path, text).windows[0].excitation, 0.74e-3 * FORCE, rtol=1e-15)


# ---- units ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raw", "sensitivity", "unit", "quantity", "factor"),
    [
        ("V", 100.0, "mV/g", Quantity.ACCELERATION, 98.0665),  # 1 V is 10 g
        ("mV", 10.0, "mV/(m/s2)", Quantity.ACCELERATION, 0.1),
        ("V", 2.0, "mV/N", Quantity.FORCE, 500.0),
        ("V", 35.15065, "N/V", Quantity.FORCE, 35.15065),  # the drive gain of the EMPS benchmark
        ("mA", 0.74, "N.m/A", Quantity.TORQUE, 0.74e-3),
        ("count", 0.5, "um/count", Quantity.POSITION, 0.5e-6),
    ],
)
def test_a_sensitivity_turns_raw_values_into_si(raw, sensitivity, unit, quantity, factor):
    assert sensor_factor(raw, sensitivity, unit, quantity, "map") == pytest.approx(factor, rel=1e-14)


def test_units_do_not_cross_quantities():
    with pytest.raises(RecordingFormatError, match=r"expected a unit of torque \(N\.m, .*\); got 'N', a unit of force"):
        factor_to_si("N", Quantity.TORQUE, "map")
    with pytest.raises(RecordingFormatError, match="a raw unit needs sensitivity"):
        factor_to_si("V", Quantity.ACCELERATION, "map")
    for unit in ("N.m/V", "V/A", "mV/N"):
        with pytest.raises(RecordingFormatError, match="expected sensitivity_unit to connect"):
            sensor_factor("A", 1.0, unit, Quantity.TORQUE, "map")


def test_spellings_of_other_programs_are_known_and_unknown_units_say_nothing():
    assert [canonical_unit(u) for u in ("m/s²", "m/s^2", "Volts", "Nm", "furlong", None)] == [
        "m/s2", "m/s2", "V", "N.m", None, None,
    ]  # fmt: skip
    shares = ("% of rated", "Percent of nominal", "%FS", "%/s", "% per minute", "percentage")
    assert [canonical_unit(u) for u in shares] == ["%", "%", "%", "%/s", None, None]


# ---- refused -------------------------------------------------------------------------------------------------------

REFUSED_MAPS = {
    "no TOML": ("axis_id = ", "expected a channel map in TOML"),
    "no axis": (MAP.replace('axis_id = "mill-3-x"\n', ""), "axis_id: expected a text; it is missing"),
    "no response": (MAP.replace("[response]", "[response_]"), "got 'response_'"),
    "no window": (MAP.partition("[window]")[0], "expected a table [window] with position_mm, position_span_mm; they"),
    "an unknown entry": (MAP + "sample_rate = 5\n", "[window]: expected only"),
    "half a sensitivity": (MAP.replace('unit = "kN"', 'sensitivity_unit = "N/V"'), "sensitivity: expected a number"),
    "a unit of another quantity": (
        MAP.replace('"kN"', '"N.m"'),
        "expected a unit of force (N, mN, daN, kN, lbf, kgf); got 'N.m', a unit of torque",
    ),
    "a raw unit without sensitivity": (MAP.replace('"kN"', '"V"'), "a raw unit needs sensitivity and sensitivity_unit"),
    "a sensitivity without its unit": (
        MAP.replace('"kN"', '"V"\nsensitivity = 2.0'),
        "sensitivity_unit: expected a text",
    ),
    "no source": (MAP.replace('source = "sensor"\n', ""), "[excitation], source: expected a text; it is missing"),
    "no position": (MAP.replace("position_mm = 123.4\n", ""), "position_mm: expected a number [mm]; it is missing"),
    "no span": (MAP.replace("position_span_mm = 0.5\n", ""), "position_span_mm: expected a number [mm]; it is missing"),
    "position twice": (WITH_POSITION.replace("[position]", "position_mm = 1.0\n[position]"), "the position once"),
    "a start without zone": (MAP.replace("00Z", "00"), "RFC 3339 time with zone such as"),
    "a rate as text": (MAP.replace("= 1000", '= "1000"'), "sample_rate_hz: expected a number [Hz]; got str '1000'"),
    "half a window": (MAP + "samples_per_window = 2.5\n", "samples_per_window: expected a whole number; got 2.5"),
    "an unknown direction": (MAP + 'direction = "left"\n', "expected '+' or '-' or 'both'; got 'left'"),
    "a table for a number": (MAP + "[window.payload_kg]\na = 1\n", "payload_kg: expected a number [kg]; got dict"),
}


def test_a_map_that_leaves_doubt_is_refused(tmp_path, subtests):
    for case, (text, sentence) in REFUSED_MAPS.items():
        with subtests.test(case=case):
            (tmp_path / "map.toml").write_text(text, encoding="utf-8")
            with pytest.raises(RecordingFormatError) as caught:
                read_channel_map(tmp_path / "map.toml")
            assert sentence in str(caught.value)
            assert str(caught.value).startswith("map.toml")


TWO_BY_THREE = {"force": np.zeros((2, 3)), "acc": np.zeros((2, 3))}
REFUSED_FILES = {
    "no unit at all": (MAP.replace('unit = "kN"\n', ""), {}, "force: expected unit, what the numbers are in; neither"),
    "no such channel": (MAP.replace('"force"\nq', '"Force"\nq'), {}, "a channel 'Force'; the file has 'force', 'acc'"),
    "unequal lengths": (MAP, {"acc": np.zeros(5)}, "expected channels of one length; got 'force' (6,), 'acc' (5,)"),
    "no rate": (MAP.replace("sample_rate_hz = 1000\n", ""), {}, "expected the sample rate stated once; got none"),
    "the rate twice": (
        WITH_TIME.replace("[window]", "[window]\nsample_rate_hz = 5"),
        {"t": np.arange(6.0)},
        "stated once; got 1000.0 Hz in the channel of [time] and 5.0 Hz in sample_rate_hz of the map",
    ),
    "no start": (MAP.replace("started_at = 2025-03-01T06:00:00Z\n", ""), {}, "expected a start with zone"),
    "a gap in the times": (WITH_TIME, {"t": np.array([0.0, 1, 2, 4, 5, 6])}, "got a step of 0.002 s behind sample 2"),
    "times that run back": (WITH_TIME, {"t": -np.arange(6.0)}, "expected rising sampling times"),
    "less than a window": (MAP + "samples_per_window = 7\n", {}, "at least one window of 7 samples; got 6 samples"),
    "an array of windows, not said how": (MAP, TWO_BY_THREE, "expected windows_in"),
    "an array of windows, not said when": (
        MAP + 'windows_in = "rows"\n',
        TWO_BY_THREE,
        "expected window_interval_s",
    ),
    "windows_in of a plain channel": (MAP + 'windows_in = "rows"\n', {}, "expected a two-dimensional array"),
    "a negative payload": (MAP + "payload_kg = -1\n", {}, "payload_mass must not be negative; got -1.0 kg"),
}  # fmt: skip


def test_a_file_that_does_not_fit_its_map_is_refused(tmp_path, subtests):
    for case, (text, arrays, sentence) in REFUSED_FILES.items():
        with subtests.test(case=case):
            with pytest.raises(RecordingFormatError) as caught:
                read(tmp_path, text, **arrays)
            assert sentence in str(caught.value)
            assert str(caught.value).startswith("hit.npz")


def test_an_unknown_ending_is_refused(tmp_path):
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "a.flac").write_bytes(b"fLaC\x00\x00\x00\x22" + bytes(200))
    with pytest.raises(RecordingFormatError, match=r"a\.flac: expected "):
        import_session([tmp_path / "a.flac"], read_channel_map(tmp_path / "map.toml"))


@pytest.fixture
def write_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")

    def write(force=(), acc=()):
        common = {"wf_increment": 1e-3, "wf_start_time": np.datetime64("2025-03-01T06:00:00"), "unit_string": "N"}
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
            file.write_segment(
                [
                    nptdms.ChannelObject("g", "force", FORCE, properties=common | dict(force)),
                    nptdms.ChannelObject(
                        "g", "acc", ACCELERATION, properties=common | {"unit_string": "g"} | dict(acc)
                    ),
                ]
            )
        return tmp_path / "a.tdms"

    return write


TDMS_MAP = (
    MAP.replace('"force"\nq', '"g/force"\nq').replace('"acc"', '"g/acc"').replace('"kN"', '"N"')
    .replace("sample_rate_hz = 1000\nstarted_at = 2025-03-01T06:00:00Z\n", "")
)  # fmt: skip


def mapped(path, text=TDMS_MAP):
    (path.parent / "map.toml").write_text(text)
    return import_session([path], read_channel_map(path.parent / "map.toml")).session


def test_rate_and_start_come_from_the_file_that_states_them(write_tdms):
    (window,) = mapped(write_tdms()).windows
    assert (window.sample_rate, window.started_at) == (1000.0, START)


def test_a_unit_of_the_file_that_is_unknown_is_said_where_that_of_the_map_is_used(write_tdms):
    path = write_tdms(acc={"unit_string": "g-force"})
    mapped(path)
    made = import_session([path], read_channel_map(path.parent / "map.toml"))
    said = "a.tdms, g/acc: the file says 'g-force', which is no unit known here; 'g' of the map is used"
    assert [remark for remark in made.remarks if "unit" in remark] == [said]


def test_what_contradicts_the_file_is_refused(write_tdms):
    cases = [
        ({}, TDMS_MAP.replace('"N"', '"kN"'), "expected 'kN' as the map says; the file says 'N'"),
        ({}, TDMS_MAP + "sample_rate_hz = 1000\n", "1000.0 Hz in the file and 1000.0 Hz in sample_rate_hz of the map"),
        ({}, TDMS_MAP + "started_at = 2025-03-01T06:00:00Z\n", "expected the start stated once"),
        ({"unit_string": "% of rated"}, TDMS_MAP, "expected 'g' as the map says; the file says '% of rated'"),
        ({"wf_increment": 2e-3}, TDMS_MAP, "expected channels of one sample rate; got 1000 Hz, 500 Hz"),
        ({"wf_start_offset": 0.01}, TDMS_MAP, "expected channels that start together; they start 0.01 s apart"),
    ]
    for acc, text, sentence in cases:
        with pytest.raises(RecordingFormatError) as caught:
            mapped(write_tdms(acc=acc), text)
        assert sentence in str(caught.value)


# ---- the documentation is a test ----------------------------------------------------------------------------------


def toml_blocks():
    """Return the channel maps of the page; a drive model, which names its family, is none."""
    page = (Path(__file__).parents[2] / "docs" / "reference" / "recordings.md").read_text(encoding="utf-8")
    blocks = [block.partition("```")[0] for block in page.split("```toml\n")[1:]]
    return [block for block in blocks if "axis_id" in block]


@pytest.mark.parametrize("text", toml_blocks())
def test_the_maps_on_the_page_are_maps(tmp_path, text):
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    assert read_channel_map(tmp_path / "map.toml").axis_id


def test_the_map_in_the_docstring_names_every_entry():
    for table, entries in channel_map._ENTRIES.items():
        assert f"[{table}]" in channel_map.__doc__
        for entry in entries - {"payload_kg"}:
            assert entry in channel_map.__doc__
