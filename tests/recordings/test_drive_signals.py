"""Logs of a control without an accelerometer: from the file to the frequency, whatever the format and the units are.

The truth is a chain of motor, screw and table with two modes, solved line by line; the poles are the eigenvalues of its
state matrix. The real stage is read from the shared reference, where that is there.
"""

import itertools
import math
import re
import tomllib

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings, strategies as st

from monitor_core.errors import RecordingFormatError
from monitor_core.pipeline import AxisSettings
from monitor_core.recording import ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.recordings import check_file
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.mapping.channel_map import parse_channel_map
from monitor_core.recordings.raw.mapping.imported import import_session
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map
from monitor_core.recordings.raw.proposal.sampling import period_of
from monitor_core.recordings.session_hdf5 import read_session, write_session
from monitor_core.session import judge_session
from service.documents.map_form import filled_map, map_fields
from tests.conftest import PROJECT_ROOT, canary

RATE, LEAD, KT = 2000.0, 0.012, 0.35  # [Hz], [m], [N·m/A]
STAGE = PROJECT_ROOT.parent / "shared/data/measured/feed_drive/DhresL_m40pR.mat"
#: Masses in travel of motor, screw and table [kg]; springs between them [N/m]; damping of springs [s], of guides [1/s].
MASSES, SPRINGS, LOSS, DRAG = (60.0, 9.0, 26.0), (1e8, 1.4e7), 1.5e-5, 60.0


def chain():
    """Mass and stiffness matrix of the chain, free at both ends."""
    stiffness = np.zeros((3, 3))
    for number, spring in enumerate(SPRINGS):
        stiffness[number : number + 2, number : number + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.diag(MASSES), stiffness


def poles():
    """Natural frequencies of the two elastic modes [Hz]."""
    mass, stiffness = chain()
    inverse = np.linalg.inv(mass)
    damping = LOSS * inverse @ stiffness + DRAG * np.eye(3)
    state = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ stiffness, -damping]])
    roots = np.linalg.eigvals(state)
    return sorted(abs(root) / (2.0 * np.pi) for root in roots if root.imag > 1.0)


def drive_log(*, band=(11.0, 300.0), period=2000, n_periods=10, seed=1, noise=0.0, every=1, of_current=1e-3):
    """Return current [A], angle of the motor [rad] and scale of the table [m] under a multisine, in its rhythm."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(period, 1.0 / RATE)
    driven = (frequency >= band[0]) & (frequency <= band[1]) & (np.arange(frequency.size) % every == every // 2)
    current = np.where(driven, np.exp(2j * np.pi * rng.uniform(size=frequency.size)), 0.0)
    mass, stiffness = chain()
    motor, table = np.zeros((2, frequency.size), dtype=complex)
    for line in np.flatnonzero(driven):
        w = 2.0 * np.pi * frequency[line]
        force = np.array([KT * 2.0 * np.pi / LEAD * current[line], 0.0, 0.0])
        dynamic = (1.0 + 1j * w * LOSS) * stiffness + (1j * w * DRAG - w**2) * mass
        motor[line], _, table[line] = np.linalg.solve(dynamic, force)
    signals = [np.tile(np.fft.irfft(lines, period), n_periods) for lines in (current, motor, table)]
    scale = 10.0 / np.std(signals[0])
    current, motor, table = (scale * values for values in signals)
    table = table + noise * rng.normal(size=table.size)
    current = current + of_current * rng.normal(size=current.size)  # of its measurement
    return current, motor * 2.0 * np.pi / LEAD, table


CURRENT, ANGLE, TABLE = drive_log()
TIME = np.arange(CURRENT.size) / RATE
MAP = """
axis_id = "stage"
excitation = {channel = "i", quantity = "current", source = "drive", unit = "A"}
response = {channel = "x", quantity = "displacement", unit = "nm"}
[window]
sample_rate_hz = 2000
samples_per_window = 2000
started_at = 2025-03-01T06:00:00Z
position_mm = 100
"""


def imported(path, text):
    return import_session([path], parse_channel_map(text, "map.toml"))


def refusal(path, text):
    with pytest.raises(RecordingFormatError) as caught:
        imported(path, text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


# ---- maps -----------------------------------------------------------------------------------------------------------


def test_a_scale_is_a_response_and_says_how_far_the_table_goes(tmp_path):
    raw = saved(tmp_path / "log.npz", i=CURRENT, x=np.round(TABLE * 1e9))
    made = imported(raw, MAP.replace('"nm"}', '"nm", resolution = 1}'))
    assert made.remarks == ()  # whole nanometres are no counts of a converter
    assert len(made.session.windows) == 10
    window = made.session.windows[0]
    assert (window.response_quantity, window.response_resolution) == (ResponseQuantity.DISPLACEMENT, 1e-9)
    assert (window.excitation_quantity, window.excitation_source) == (
        ExcitationQuantity.CURRENT,
        ExcitationSource.DRIVE,
    )
    np.testing.assert_array_equal(window.response, np.round(TABLE * 1e9)[:2000] * 1e-9)
    assert window.position_span == pytest.approx(np.ptp(TABLE[:2000]), abs=1.1e-9)
    assert window.conditions.position == 0.1


@settings(max_examples=25, deadline=None)
@given(
    unit=st.sampled_from(["m", "mm", "um", "nm", "in", "count"]),
    counts=st.integers(1, 10**7),
    turned=st.sampled_from(["rad", "mrad", "deg", "rev", "count", "mm"]),
    amperes=st.sampled_from(["A", "mA", "%", "V"]),
)
def test_the_units_of_a_log_never_change_what_is_read(tmp_path_factory, unit, counts, turned, amperes):
    """The same signals in any units are the same session: only rounding in the last digit is between them."""
    per_metre = {"m": 1.0, "mm": 1e3, "um": 1e6, "nm": 1e9, "in": 1.0 / 0.0254, "count": counts * 1e3}[unit]
    per_turn = {"rad": 2.0 * math.pi, "mrad": 2e3 * math.pi, "deg": 360.0, "rev": 1.0, "count": counts, "mm": 12.0}
    per_ampere = {"A": 1.0, "mA": 1e3, "%": 100.0 / 28.0, "V": 0.25}[amperes]
    turns = ANGLE / (2.0 * math.pi) * per_turn[turned]
    raw = saved(tmp_path_factory.mktemp("log") / "log.npz", i=CURRENT * per_ampere, x=TABLE * per_metre, a=turns)
    rated = {"%": ', sensitivity = 28, sensitivity_unit = "A/100%"', "V": ', sensitivity = 4, sensitivity_unit = "A/V"'}
    by_count = f', sensitivity = {counts}, sensitivity_unit = "count/'
    scale = f'unit = "{unit}"' + (f'{by_count}mm"' if unit == "count" else "")
    angle = f'channel = "a", lead_mm = 12, unit = "{turned}"' + (f'{by_count}rev"' if turned == "count" else "")
    text = MAP.replace('unit = "A"', f'unit = "{amperes}"{rated.get(amperes, "")}') + "position_span_mm = 1\n"

    def first(response):
        return imported(raw, re.sub("response = {.*}", f"response = {{{response}}}", text)).session.windows[0]

    of_scale = first(f'channel = "x", quantity = "displacement", {scale}')
    np.testing.assert_allclose(of_scale.excitation, CURRENT[:2000], rtol=1e-12)
    np.testing.assert_allclose(of_scale.response, TABLE[:2000], rtol=1e-12)
    if unit == "count":  # one count, without being told
        assert of_scale.response_resolution == pytest.approx(1e-3 / counts)
    np.testing.assert_allclose(first(f'quantity = "motor-angle", {angle}').response, ANGLE[:2000], rtol=1e-12)
    both = first(f'channel = "x", quantity = "relative-displacement", {scale}, motor = {{{angle}}}')
    assert both.response_quantity is ResponseQuantity.RELATIVE_DISPLACEMENT
    relative = (ANGLE * LEAD / (2.0 * math.pi) - TABLE)[:2000]
    np.testing.assert_allclose(both.response, relative, atol=1e-12 * np.abs(TABLE).max())


def test_speeds_are_read_in_turns_by_the_minute_and_in_the_way_of_the_table(tmp_path):
    speed = np.gradient(ANGLE, 1.0 / RATE)
    raw = saved(tmp_path / "log.npz", i=CURRENT, n=speed * 30.0 / math.pi, v=speed * 60e3 * LEAD / (2.0 * math.pi))
    for name, unit, lead in (("n", "1/min", ""), ("n", "rpm", ""), ("v", "mm/min", ", lead_mm = 12")):
        text = f'response = {{channel = "{name}", quantity = "motor-speed", unit = "{unit}"{lead}}}'
        made = imported(raw, re.sub("response = {.*}", text, MAP) + "position_span_mm = 1\n")
        np.testing.assert_allclose(made.session.windows[0].response, speed[:2000], rtol=1e-12)
    table = 'response = {channel = "v", quantity = "velocity", unit = "mm/min"}'
    made = imported(raw, re.sub("response = {.*}", table, MAP) + "position_span_mm = 1\n")
    np.testing.assert_allclose(made.session.windows[0].response, speed[:2000] * LEAD / (2.0 * math.pi), rtol=1e-12)


def test_a_commanded_acceleration_and_a_percentage_of_the_rated_torque_drive_an_axis(tmp_path):
    raw = saved(tmp_path / "log.npz", i=CURRENT, x=TABLE * 1e9)
    of_map = 'quantity = "current", source = "drive", unit = "A"'
    commanded = MAP.replace(of_map, 'quantity = "acceleration", source = "commanded", unit = "g"')
    (window, *_) = imported(raw, commanded).session.windows
    assert window.excitation_quantity is ExcitationQuantity.ACCELERATION
    assert window.excitation_source is ExcitationSource.COMMANDED
    np.testing.assert_allclose(window.excitation, CURRENT[:2000] * 9.80665, rtol=1e-15)
    rated = 'quantity = "torque", source = "drive", unit = "%", sensitivity = 12.7, sensitivity_unit = "N.m/100%"'
    (window, *_) = imported(raw, MAP.replace(of_map, rated)).session.windows
    np.testing.assert_allclose(window.excitation, CURRENT[:2000] * 0.127, rtol=1e-12)


def test_a_reference_goes_with_its_windows_through_a_map_and_a_session_file(tmp_path):
    told = np.cumsum(CURRENT)
    raw = saved(tmp_path / "log.npz", i=CURRENT, x=TABLE * 1e9, s=told, a=ANGLE)
    text = MAP.replace("[window]", 'reference = {channel = "s", unit = "rpm"}\n[window]')
    made = imported(raw, text).session
    write_session(tmp_path / "log.session.h5", made)
    for window, kept, part in zip(
        made.windows, read_session(tmp_path / "log.session.h5").windows, told.reshape(-1, 2000), strict=True
    ):
        np.testing.assert_array_equal(window.reference, part)
        np.testing.assert_array_equal(kept.reference, part)
        np.testing.assert_array_equal(kept.response, window.response)
    assert "reference" in {channel.name for channel in check_file(tmp_path / "log.session.h5").channels}
    assert imported(raw, MAP).session.windows[0].reference is None
    assert "expected a unit, of any quantity; got 'furlong'" in refusal(raw, text.replace("rpm", "furlong"))
    of_sensor = refusal(raw, text.replace('source = "drive"', 'source = "sensor"'))
    assert of_sensor == "log.npz: excitation_source must be drive, with a reference; got sensor"
    measured = MAP.replace("position_mm = 100\n", "").replace(
        "[window]",
        """
position = {channel = "a", unit = "mm"}
reference = {channel = "s", unit = "rpm"}
[window]""",
    )
    both = imported(raw, measured).session.windows[0]
    np.testing.assert_array_equal(both.reference, told[:2000])
    np.testing.assert_allclose(both.position_trace, ANGLE[:2000] * 1e-3)


OF_SCALE = '"displacement", unit = "nm"'
REFUSED = {
    "an angle as an acceleration": (OF_SCALE, '"acceleration", unit = "rad"', "expected a unit of acceleration"),
    "an angle as a displacement": ('unit = "nm"', 'unit = "rad"', "got 'rad', a unit of motor-angle"),
    "a travel as an angle": ('"displacement"', '"motor-angle"', "got 'nm', a unit of position"),
    "a lead of a scale": ('unit = "nm"', 'unit = "nm", lead_mm = 12', "expected lead_mm for a motor-angle"),
    "a motor of a scale": ('unit = "nm"', 'unit = "nm", motor = {channel = "a"}', 'expected quantity = "relative'),
    "a current in newton metres": ('unit = "A"', 'unit = "N.m"', "got 'N.m', a unit of torque"),
    "no such quantity": ('"displacement"', '"position"', "got 'position'"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_response_is_is_refused_in_a_sentence(tmp_path, case):
    old, new, sentence = REFUSED[case]
    assert old in MAP
    raw = saved(tmp_path / "log.npz", i=CURRENT, x=TABLE, a=ANGLE)
    assert sentence in refusal(raw, MAP.replace(old, new))


@pytest.mark.parametrize(("lead", "fits"), [(12, True), (-12, False), (1.2, False), (120, False)])
def test_a_lead_that_scale_and_motor_contradict_is_refused_with_the_one_that_fits(tmp_path, lead, fits):
    raw = saved(tmp_path / "log.npz", i=CURRENT, x=TABLE * 1e9, a=ANGLE, back=-ANGLE)
    motor = '"relative-displacement", unit = "nm", motor = {channel = "NAME", unit = "rad", lead_mm = LEAD}'
    text = MAP.replace('"displacement", unit = "nm"', motor) + "position_span_mm = 1\n"
    for name, sense in (("a", 1), ("back", -1)):
        of_map = text.replace("NAME", name).replace("LEAD", str(sense * lead))
        if fits:
            imported(raw, of_map)
            continue
        ratio = float(re.findall("lead_mm times (.*?) would fit", refusal(raw, of_map))[0])
        assert sense * lead * ratio == pytest.approx(sense * 12.0, rel=0.2)


# ---- proposals ------------------------------------------------------------------------------------------------------


def proposal_of(**channels):
    stored = tuple(Channel(name, values) for name, values in channels.items())
    return proposed_map(Channels("log.csv", stored)).toml()


LOGS = {
    "a stage of a laboratory": (
        {"time": TIME, "iq_ref": CURRENT, "theta_s": ANGLE, "theta_m": ANGLE, "pos_t": TABLE, "iq_ad": CURRENT},
        ("iq_ad", "current", "drive"), ("pos_t", "displacement"),
    ),
    "a german control": (
        {"Zeit [ms]": 1e3 * TIME, "Sollwert Moment [%]": CURRENT, "Istmoment [%]": CURRENT, "Drehzahl [1/min]": ANGLE},
        ("Istmoment [%]", "torque", "drive"), ("Drehzahl [1/min]", "motor-speed"),
    ),
    "a motor alone": (
        {"t_s": TIME, "Motor current [A]": CURRENT, "Motor position [mm]": ANGLE},
        ("Motor current [A]", "current", "drive"), ("Motor position [mm]", "motor-angle"),
    ),
    "a commanded acceleration": (
        {"t_s": TIME, "acc_cmd [mm/s2]": CURRENT, "Linear scale [um]": TABLE, "Motor position [deg]": ANGLE},
        ("acc_cmd [mm/s2]", "acceleration", "commanded"), ("Linear scale [um]", "displacement"),
    ),
    "an accelerometer beside all of it": (
        {"t_s": TIME, "iq": CURRENT, "scale [um]": TABLE, "theta": ANGLE, "acc [g]": ANGLE},
        ("iq", "current", "drive"), ("acc [g]", None),
    ),
    "a velocity of the table": (
        {"t_s": TIME, "torque [Nm]": CURRENT, "table velocity [mm/s]": TABLE},
        ("torque [Nm]", "torque", "drive"), ("table velocity [mm/s]", "velocity"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("log", LOGS)
def test_what_a_drive_logs_is_proposed_by_names_and_units(log):
    channels, excitation, response = LOGS[log]
    text = proposal_of(**channels)
    proposed = tomllib.loads(text)
    found = proposed["excitation"]
    assert (found["channel"], found["quantity"], found["source"]) == excitation
    assert (proposed["response"]["channel"], proposed["response"].get("quantity")) == response
    assert ("no acceleration: natural frequency, damping and, with a calibration, preload" in text) == bool(response[1])
    lacks = {"current": "the torque constant is not stated", "acceleration": "no torque and no force is known"}
    if response[1] and excitation[1] in lacks:
        assert f"no modal mass and no friction torque, because {lacks[excitation[1]]}" in text


def test_a_set_point_is_proposed_as_a_reference_and_what_the_controller_makes_of_it_is_none():
    """Torque or current that is asked for, and an error of following, answer what disturbs the axis."""
    inside = {"iq [A]": CURRENT, "iq_cmd [A]": CURRENT, "pos_error [um]": TABLE, "scale [um]": TABLE}
    unknown = "what the control loop does to the frequency stays unknown without a set-point beside them"
    assert unknown in proposal_of(**inside)
    told = inside | {"n_set [rpm]": ANGLE, "pos_set [mm]": TABLE}
    text = proposal_of(**told)
    assert unknown not in text
    assert "'pos_set [mm]' as [reference] takes off what the control loop does to it" in text
    tables = map_fields(proposed_map(Channels("log.csv", tuple(Channel(*channel) for channel in told.items()))))
    values = {field.key: field.value for table in tables for field in table.fields}
    examples = {field.key: field.example for table in tables for field in table.fields if table.name == "reference"}
    assert "reference" not in tomllib.loads(filled_map(tables, values))  # to be confirmed
    filled_in = tomllib.loads(filled_map(tables, values | examples))
    assert filled_in["reference"] == {"channel": "pos_set [mm]", "unit": "mm"}


@pytest.mark.parametrize("name", ["Device1/SetPos [mm]", "Flags/Pos.cmd [mm]", "Lage_soll [mm]"])
def test_a_name_that_only_holds_letters_of_an_error_is_still_a_set_point(name):
    signals = {"iq [A]": CURRENT, "scale [um]": TABLE}
    assert f"{name!r} as [reference] takes off" in proposal_of(**signals, **{name: TABLE})
    for error in ("pos_err_ref [mm]", "PosLag.cmd [mm]", "Lagefehler [mm]", "pos set deviation [mm]"):
        assert "as [reference]" not in proposal_of(**signals, **{error: TABLE})


def test_a_set_point_of_a_speed_is_proposed_with_the_caution_that_a_cascade_makes_it():
    text = proposal_of(**{"iq [A]": CURRENT, "scale [um]": TABLE, "n_set [rpm]": ANGLE})
    assert "does to it, unless a position controller makes this speed" in text
    assert "does to the frequency, unless a position controller makes this speed" in text


def test_a_motor_beside_the_scale_is_a_table_of_the_form_that_may_be_left_out_or_filled_in():
    """Left out the map is that of the scale; filled in it says the relative displacement."""
    signals = (("iq [A]", CURRENT), ("scale [um]", TABLE), ("theta_m [rad]", ANGLE))
    proposal = proposed_map(Channels("log.csv", tuple(Channel(name, values) for name, values in signals)))
    assert "motor" not in tomllib.loads(proposal.toml())["response"]
    tables = map_fields(proposal)
    (of_motor,) = [table for table in tables if table.name == "response.motor"]
    examples = {field.key: field.example for field in of_motor.fields}
    assert examples["response.motor.channel"] == "theta_m [rad]"
    assert not any(field.required or field.value for field in of_motor.fields)
    values = {field.key: field.value for table in tables for field in table.fields}
    assert "motor" not in tomllib.loads(filled_map(tables, values))["response"]
    filled = values | examples | {"response.motor.lead_mm": "12", "response.quantity": "relative-displacement"}
    response = tomllib.loads(filled_map(tables, filled))["response"]
    assert response["motor"] == {"channel": "theta_m [rad]", "unit": "rad", "lead_mm": 12}
    assert response["quantity"] == "relative-displacement"


@settings(max_examples=100, deadline=None)
@given(st.permutations(["theta_m", "phi", "Winkel", "rotor", "ax [deg]", "iq", "n [rpm]", "pos_ref", "Sollbeschl [g]"]))
def test_neither_an_angle_nor_what_was_planned_is_ever_proposed_as_an_acceleration(names):
    n = 2 + len(names[0]) % 7
    proposed = tomllib.loads(proposal_of(**dict.fromkeys(names[:n], ANGLE[:200])))
    assert "quantity" in proposed["response"] or "channel" not in proposed["response"]


@pytest.mark.parametrize(("period", "band"), [(2000, (11.0, 300.0)), (400, (302.0, 800.0)), (333, (20.0, 600.0))])
def test_the_period_of_an_excitation_is_found_in_noise(period, band):
    current, _, _ = drive_log(band=band, period=period, n_periods=12)
    noise = np.random.default_rng(2).normal(size=current.size)
    assert period_of(current) == period
    assert period_of(current + noise) == period  # of a tenth
    assert period_of(noise) is None
    assert period_of(np.sin(2.0 * np.pi * 10.0 * TIME)) is None
    assert period_of(np.cumsum(noise)) is None


# ---- from a file to a frequency --------------------------------------------------------------------------------------


KNOWN_OF_PAGE = {"started_at": "2025-03-01T06:00:00Z", "position_mm": 250}


def filled(text, **values):
    """Write what only a person knows, in the order of the places."""
    for name, value in values.items():
        for written in value if isinstance(value, list) else [value]:
            place = re.compile(rf"^# {name} =\s*(?=# fill in)", re.MULTILINE)
            assert place.search(text), f"no place for {name}"
            text = place.sub(f"{name} = {written} ", text, count=1)
    return text


def in_csv(path, current, angle, table):
    columns = np.column_stack([1e3 * TIME[: current.size], current, np.degrees(angle), 1e3 * table])
    header = "t [ms],Motor current [A],Motor angle [deg],Scale [mm]"
    np.savetxt(path, columns, "%.17g", ",", header=header, comments="")


def in_tdms(path, current, angle, table):
    nptdms = pytest.importorskip("nptdms")
    columns = {"Motor current": (1e3 * current, "mA"), "Motor angle": (angle, "rad"), "Scale": (1e6 * table, "µm")}
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([
            nptdms.ChannelObject("Drive", name, values, properties={"wf_increment": 1.0 / RATE, "unit_string": unit})
            for name, (values, unit) in columns.items()
        ])  # fmt: skip


def in_mdf4(path, current, angle, table):
    asammdf = pytest.importorskip("asammdf")
    turns = angle / (2.0 * math.pi)
    columns = {"Motor current": (current, "A"), "Motor angle": (turns, "rev"), "Scale": (1e9 * table, "nm")}
    signals = [
        asammdf.Signal(values, TIME[: current.size], name=name, unit=unit) for name, (values, unit) in columns.items()
    ]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals)
        file.save(path, overwrite=True)


def in_hdf5(path, current, angle, table):
    h5py = pytest.importorskip("h5py")
    columns = {"Motor current": (current, "A"), "Motor angle": (angle, "rad"), "Scale": (table, "m")}
    with h5py.File(path, "w") as file:
        for name, (values, unit) in columns.items():
            file[name] = values
            file[name].attrs.update({"units": unit, "sampling_rate": RATE})


WRITERS = {"csv": in_csv, "tdms": in_tdms, "mf4": in_mdf4, "h5": in_hdf5}


@pytest.mark.parametrize("ending", WRITERS)
def test_the_same_log_in_any_format_and_units_is_the_same_session(tmp_path, ending):
    raw = tmp_path / f"log.{ending}"
    WRITERS[ending](raw, CURRENT, ANGLE, TABLE)
    report = check_file(raw)
    assert "preload from the scale" in dict(report.contents)["what_it_shows"]
    text = proposed_map(report.read.channels, report.read.layout).toml()
    start = {} if "started_at is left out" in text else {"started_at": "2025-03-01T06:00:00Z"}
    made = imported(raw, filled(text, **start, position_mm=100))
    assert len(made.session.windows) == 10  # of a period each, which the current says by itself
    for number, window in enumerate(made.session.windows):
        part = slice(2000 * number, 2000 * (number + 1))
        np.testing.assert_allclose(window.excitation, CURRENT[part], rtol=1e-12)
        np.testing.assert_allclose(window.response, TABLE[part], rtol=1e-12)


def commands(preload, folder, raw, band, **known):
    """Run the two commands, with what only the user knows written between them, and return the modes that they list."""
    of_map = folder / "map.toml"
    checked = preload("check", raw, "--write-map", of_map)
    assert checked.exit_code == 0, checked.err
    of_map.write_text(filled(of_map.read_text(encoding="utf-8"), **known), encoding="utf-8")
    answer = preload("frf", raw, "--map", of_map, "--json", *(["--band-hz", *band] if band else []))
    assert answer.exit_code == 0, answer.err
    (found,) = answer.json()["measurements"]
    return found


@pytest.mark.parametrize(
    ("number", "log"),
    canary(
        [
            (0, {"band": (11.0, 300.0), "n_periods": 20}),
            (1, {"band": (302.0, 800.0), "period": 400, "n_periods": 50}),
        ]
    ),
)
def test_the_two_modes_of_a_log_come_from_the_file_in_two_commands(preload, tmp_path, number, log):
    """A control that writes nothing but numbers in nanometres: the multisines of a laboratory, each over one mode."""
    current, angle, table = drive_log(noise=2e-9, **log)
    variables = {"iq_ad": current, "theta_m": angle, "pos_t": np.round(1e9 * table), "fs": RATE}
    scipy.io.savemat(tmp_path / "log.mat", variables)
    found = commands(
        preload, tmp_path, tmp_path / "log.mat", None,
        unit=['"A"', '"nm"'], started_at="2025-03-01T06:00:00Z", position_mm=100,
    )  # fmt: skip
    truth, stated = poles()[number], found["frequency_standard_uncertainty_hz"]
    assert not found["refused"]
    assert abs(found["frequency_hz"] - truth) < 3.0 * stated + 0.01
    assert abs(found["frequency_hz"] - truth) < (0.3, 3.0)[number]


@pytest.mark.parametrize(("every", "precision"), canary([(2, np.float32), (1, np.float64), (2, np.float64)]))
def test_a_commanded_multisine_holds_nothing_between_its_lines_and_still_shows_the_mode(tmp_path, every, precision):
    """What was commanded has no noise: between its lines, and above its band, it is zero but for rounding."""
    commanded, _, table = drive_log(n_periods=20, noise=2e-9, every=every, of_current=0.0)
    raw = saved(tmp_path / "log.npz", i=commanded.astype(precision), x=np.round(1e9 * table))
    text = MAP.replace('"current", source = "drive", unit = "A"', '"acceleration", source = "commanded", unit = "m/s2"')
    (measured,) = judge_session(imported(raw, text).session, AxisSettings())
    frequency = measured.outcome.modal.mode.frequency
    assert abs(frequency.value - poles()[0]) < 3.0 * frequency.standard_uncertainty + 0.01


def test_the_commands_of_the_page_lead_to_its_numbers(preload, tmp_path, monkeypatch):
    page = (PROJECT_ROOT / "docs/how-to/drive-signals.md").read_text(encoding="utf-8")
    current, angle, table = drive_log(n_periods=20, noise=1e-8)
    columns = np.column_stack([0.5 * np.arange(current.size), current, np.round(1e8 * table) / 100.0, angle])
    monkeypatch.chdir(tmp_path)
    np.savetxt(
        "axis-x.csv", columns, "%.9g", ",", header="t [ms],Current [A],Scale [um],Motor angle [rad]", comments=""
    )
    blocks = re.findall(r"```console\n\$ \.venv/bin/preload (\S+ axis-x\.csv.*?)\n(.*?)```", page, re.DOTALL)
    assert [command.split()[0] for command, _ in blocks] == ["check", "frf"]
    for command, expected in blocks:
        answer = preload(*command.split())
        assert answer.exit_code == 0, answer.err
        for line in expected.strip().splitlines():
            pattern = ".*".join(re.escape(part).replace("\\ ", r"\s+") for part in re.split(r"\.\.\.|\s{2,}", line))
            assert re.search(pattern, " ".join(answer.out.split())), line
        if command.startswith("check"):
            written = filled((tmp_path / "axis-x.toml").read_text(encoding="utf-8"), **KNOWN_OF_PAGE)
            (of_page,) = re.findall(r'```toml title="axis-x.toml"\n(.*?)```', page, re.DOTALL)
            assert tomllib.loads(written) == tomllib.loads(of_page)
            (tmp_path / "axis-x.toml").write_text(of_page, encoding="utf-8")


def h1_of_stage():
    """Return the natural frequency of the stage by numpy alone, from H1 of 19 periods and a pole over a polynomial.

    Friction distorts these lines: one order in one band moves by half a hertz with either, so the median counts.
    """
    file = scipy.io.loadmat(STAGE)
    rate, period = float(file["fs"].item()), int(file["nrofs"].item())
    current, scale = (file[name].reshape(-1, period)[1:] for name in ("iq_ad", "pos_t"))
    frequency = np.fft.rfftfreq(period, 1.0 / rate)
    u, y = np.fft.rfft(current), -((2.0 * np.pi * frequency) ** 2) * np.fft.rfft(1e-9 * scale)
    h1 = (y * u.conj()).sum(axis=0) / (np.abs(u) ** 2).sum(axis=0)
    bands = ((110.0, 150.0), (100.0, 160.0), (90.0, 170.0), (80.0, 180.0), (70.0, 200.0))
    return float(np.median([pole_of(frequency, h1, *of) for of in itertools.product(bands, range(3, 7))]))


def pole_of(frequency, h1, band, order):
    """Return the natural frequency [Hz] of a rational fit, as Sanathanan and Koerner (1963) make it linear."""
    lines = (frequency >= band[0]) & (frequency <= band[1])
    s, response = 1j * frequency[lines] / 130.0, h1[lines]
    weight = np.ones(s.size)
    for _ in range(30):
        columns = np.column_stack([*(s**power for power in range(order + 1)), -response * s, -response])
        columns, wanted = columns / weight[:, None], response * s**2 / weight
        parts = np.vstack([columns.real, columns.imag]), np.concatenate([wanted.real, wanted.imag])
        *_, a, b = np.linalg.lstsq(*parts, rcond=None)[0]
        weight = np.abs(s**2 + a * s + b)
    return 130.0 * math.sqrt(b)


@pytest.mark.skipif(not STAGE.exists(), reason="needs the measured stage of the shared reference")
def test_the_stage_of_a_laboratory_comes_to_its_frequency_in_two_commands(preload, tmp_path):
    known = {"unit": ['"A"', '"nm"'], "started_at": "2015-03-01T06:00:00Z", "position_mm": 100}
    found = commands(preload, tmp_path, STAGE, None, **known)
    assert not found["refused"]
    assert abs(found["frequency_hz"] - h1_of_stage()) < 0.3
    assert 'samples_per_window = "nrofs"' in (tmp_path / "map.toml").read_text(encoding="utf-8")
