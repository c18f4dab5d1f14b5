"""What a file states of its numbers stands beside what the map says: used where they agree, refused where they do not.

The numbers of each case are converted by hand from the definitions of the units (SI brochure; NIST SP 811).
"""

import math
from functools import partial

import numpy as np
import pytest
import scipy.signal

from monitor_core.errors import RecordingFormatError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from monitor_core.recordings import import_session, read_channel_map
from monitor_core.recordings.elements.units import response_factor, unit_of
from monitor_core.recordings.raw.channels import FrequencyResponse
from monitor_core.recordings.raw.mapping.counts import unwrapped
from monitor_core.recordings.raw.mapping.imported import import_motion
from monitor_core.recordings.raw.mapping.imported_frf import import_frf_set
from monitor_core.recordings.raw.mapping.map_records import MappedChannel
from monitor_core.recordings.raw.mapping.stated_units import agreed_unit, resolved_response
from tests.recordings.test_uff_responses import written

ROWS = np.array([[0.0, 100.0, 0.5], [0.001, -50.0, -1.0], [0.002, 25.0, 2.0], [0.003, 10.0, 0.0]])
HALF = 'channel = "{name}"\nquantity = "{quantity}"\nsource = "sensor"\n{entries}'


def session(tmp_path, drive, acc, *entries, time="Time [s]"):
    drive_entries, acc_entries = entries or ("", "")
    rows = "\n".join(",".join(f"{value:g}" for value in row) for row in ROWS)
    (tmp_path / "a.csv").write_text(f"{time},{drive},{acc}\n{rows}\n", encoding="utf-8")
    (tmp_path / "map.toml").write_text(
        f"axis_id = 'a'\n[excitation]\n{HALF.format(name=drive, quantity='torque', entries=drive_entries)}\n"
        f"[response]\nchannel = '{acc}'\n{acc_entries}\n[time]\nchannel = '{time}'\n"
        "[window]\nstarted_at = 2025-03-01T06:00:00Z\nposition_mm = 0\nposition_span_mm = 0\n",
        encoding="utf-8",
    )
    (window,) = import_session([tmp_path / "a.csv"], read_channel_map(tmp_path / "map.toml")).session.windows
    return window


#: Name of drive and acceleration, entries of the map, and what one of each number is in SI.
AGREED = {
    "units in the names alone": (("Torque [Nm]", "Acc [m/s2]", "", ""), 1.0, 1.0),
    "of other sizes": (("Torque (mNm)", "Acc (mg)", "", ""), 1e-3, 9.80665e-3),
    "at the end of names": (("torque_nm", "acc_mm_s2", "", ""), 1.0, 1e-3),
    "another spelling in the map": (("Torque [N-m]", "Acc [m/s^2]", 'unit = "Nm"', 'unit = "m/s²"'), 1.0, 1.0),
    "a raw unit in the name": (
        ("Torque [V]", "Acc [g]", 'sensitivity = 2.0\nsensitivity_unit = "V/(N.m)"', ""), 0.5, 9.80665,
    ),
    "per cent of a rated torque of 12.7 N.m": (
        ("Torque [%]", "Acc [g]", 'unit = "%"\nsensitivity = 12.7\nsensitivity_unit = "N.m/100%"', ""), 0.127, 9.80665,
    ),
    "per mille of it": (
        ("Torque", "Acc [g]", 'unit = "0.1%"\nsensitivity = 12.7\nsensitivity_unit = "N.m/100%"', ""), 0.0127, 9.80665,
    ),
    "ounces and inches": (("Torque [oz-in]", "Acc [in/s^2]", "", ""), 0.0254 * 4.4482216152605 / 16.0, 0.0254),
    "a name whose letter is of another thing": (("pos_torque [Nm]", "acc_a", "", 'unit = "m/s2"'), 1.0, 1.0),
    "words that are no units": (("Torque (motor)", "Acc (nut)", 'unit = "N.m"', 'unit = "g"'), 1.0, 9.80665),
}  # fmt: skip


def test_units_that_agree_are_used(tmp_path, subtests):
    for case, ((drive, acc, of_drive, of_acc), factor, of_g) in AGREED.items():
        with subtests.test(case=case):
            window = session(tmp_path, drive, acc, of_drive, of_acc)
            np.testing.assert_allclose(window.excitation, factor * ROWS[:, 1], rtol=1e-13)
            np.testing.assert_allclose(window.response, of_g * ROWS[:, 2], rtol=1e-13)


NM, G = 'unit = "N.m"', 'unit = "m/s2"'
CONTRADICTED = {
    "per cent": (("Torque [%]", "Acc [m/s2]", NM, G), "expected 'N.m' as the map says; its name says '%'"),
    "how to state the rating": (("Torque [%]", "Acc", NM, G), 'sensitivity_unit = "N.m/100%"'),
    "g": (("Torque [Nm]", "Acc [g]", NM, G), "Acc [g]: expected 'm/s2' as the map says; its name says 'g'"),
    "mg": (("Torque", "Acc (mg)", NM, 'unit = "g"'), "its name says 'mg'"),
    "another quantity": (("Torque [kN]", "Acc", NM, G), "its name says 'kN'"),
    "a velocity": (("Torque", "Acc [mm/s]", NM, G), "its name says 'mm/s'"),
    "a temperature": (("Torque [°C]", "Acc", NM, G), "its name says"),
    "at the end of a name": (("torque_nm", "acc_g", NM, G), "its name says 'g'"),
    "decibels": (("Torque [dB]", "Acc", NM, G), "its name says 'dB'"),
    "none at all": (("Torque", "Acc", NM, ""), "Acc: expected unit, what the numbers are in; neither file nor map"),
    "per cent without a rating": (("Torque [%]", "Acc", "", G), "a raw unit needs sensitivity"),
}


def test_units_that_contradict_are_refused_with_what_is_said_where(tmp_path, subtests):
    for case, (arguments, sentence) in CONTRADICTED.items():
        with subtests.test(case=case), pytest.raises(RecordingFormatError) as caught:
            session(tmp_path, *arguments)
        with subtests.test(sentence=case):
            assert sentence in str(caught.value)
    with pytest.raises(RecordingFormatError, match="expected a unit of time"):
        session(tmp_path, "Torque [Nm]", "Acc [g]", time="Time [N]")


def test_a_unit_is_its_product_of_powers_however_it_is_spelt():
    same = [
        ("m/(N.s2)", "(m/s²)/N", "m/s^2/N", "m s-2 / N"), ("N.m", "Nm", "N-m", "N·m", "m.N"), ("lbf.in", "in-lb"),
        ("m/s2", "m/s/s", "m·s⁻²", "ms-2"), ("g", "G", "gn"), ("um", "µm", "1000 nm"), ("rad/s", "2 rad / 2 s"),
    ]  # fmt: skip
    for first, *others in same:
        assert all(unit_of(other).is_same(unit_of(first)) for other in others), first
    assert not unit_of("nm").is_same(unit_of("Nm"))
    assert [unit_of(text) for text in ("", "-", "1", "furlong", "m/", "m^99", "(m", "MM", "a" * 99)] == [None] * 9


FRF = """
axis_id = "a"
[frf]
input = "force-at-table"
output = "{output}"
relative = 0.02
{entries}
[window]
position_mm = 250
"""


def responses(path, entries, output="acceleration-at-table"):
    (path.parent / "map.toml").write_text(FRF.format(entries=entries, output=output), encoding="utf-8")
    made = import_frf_set([path], read_channel_map(path.parent / "map.toml")).responses
    (measured,) = made.measured
    return measured.observation


def bode(tmp_path, names, columns):
    rows = "\n".join(",".join(f"{float(value)!r}" for value in row) for row in zip(*columns, strict=True))
    (tmp_path / "bode.csv").write_text(f"{','.join(names)}\n{rows}\n", encoding="utf-8")
    return tmp_path / "bode.csv"


def of_columns(names, units):
    said = [f', unit = "{unit}"' if unit else "" for unit in units]
    return "\n".join(
        f'{role} = {{channel = "{name}"{unit}}}'
        for role, name, unit in zip(("frequency", "magnitude", "phase"), names, said, strict=True)
    )


def test_a_unit_that_is_unknown_is_said_of_lines_responses_and_clocks_too(tmp_path):
    told = "the file says {!r}, which is no unit known here; {!r} of the map is used".format
    units, unit = "\n[text]\nheader_row = 1\nunit_row = 2\n", "m/(N.s2)"
    (tmp_path / "a.csv").write_text("f,H,phi\ncycles,furlong,grads\n1,2,3\n2,3,4\n")
    (tmp_path / "map.toml").write_text(
        FRF.format(entries=of_columns(("f", "H", "phi"), ("Hz", unit, "deg")), output="acceleration-at-table") + units
    )
    made = import_frf_set([tmp_path / "a.csv"], read_channel_map(tmp_path / "map.toml"))
    assert made.remarks == (
        f"a.csv, f: {told('cycles', 'Hz')}",
        f"a.csv, H: {told('furlong', unit)}",
        f"a.csv, phi: {told('grads', 'deg')}",
    )
    written(tmp_path / "a.uff", ("H", np.full(40, 1.0 + 1j)), orddenom_axis_units_lab="hammer")
    entries = f'response = {{channel = "H", unit = "{unit}"}}'
    (tmp_path / "map.toml").write_text(FRF.format(entries=entries, output="acceleration-at-table"))
    made = import_frf_set([tmp_path / "a.uff"], read_channel_map(tmp_path / "map.toml"))
    assert made.remarks == (f"a.uff, H: {told('hammer', unit)}",)
    rows = "".join(f"{k / 1000},{k % 7},{k % 5}\n" for k in range(100))
    (tmp_path / "b.csv").write_text(f"t,F,a\nticks,N,g\n{rows}")
    (tmp_path / "map.toml").write_text(
        "axis_id = 'a'\nexcitation = {channel = 'F', quantity = 'force', source = 'sensor'}\n"
        "response = {channel = 'a'}\ntime = {channel = 't', unit = 's'}\n[window]\n"
        f"started_at = 2025-03-01T06:00:00Z\nposition_mm = 0\nposition_span_mm = 0\n{units}"
    )
    made = import_session([tmp_path / "b.csv"], read_channel_map(tmp_path / "map.toml"))
    assert f"b.csv, t: {told('ticks', 's')}" in made.remarks


LINES = [2.0, 4.0, 6.0]
TRUTH = np.array([0.01 * np.exp(1j * 3.0), 0.1 * np.exp(1j * 2.0), 0.5 * np.exp(-1j * 0.5)])
LEVEL = [20.0 * math.log10(abs(value)) for value in TRUTH]
DEGREES = [math.degrees(np.angle(value)) for value in TRUTH]


def test_a_bode_plot_in_decibels_and_degrees_is_read_where_the_map_says_what_0_db_is(tmp_path):
    names = ("Frequency [Hz]", "Magnitude [dB]", "Phase [deg]")
    path = bode(tmp_path, names, (LINES, LEVEL, DEGREES))
    read = responses(path, of_columns(names, ("", "dB re 1 g/N", "")))
    np.testing.assert_allclose(read.response, 9.80665 * TRUTH, rtol=1e-12)
    radians = ("w [rad/s]", "|H| (g/kN)", "Phase [rad]")
    columns = ([2 * math.pi * f for f in LINES], [1e3 * abs(h) for h in TRUTH], [float(np.angle(h)) for h in TRUTH])
    read = responses(bode(tmp_path, radians, columns), of_columns(radians, ("", "", "")))
    np.testing.assert_allclose(read.frequency, LINES, rtol=1e-12)
    np.testing.assert_allclose(read.response, 9.80665 * TRUTH, rtol=1e-12)


def test_lines_in_another_unit_than_the_map_says_are_refused(tmp_path, subtests):
    linear = "m/(N.s2)"
    cases = [
        (("f [Hz]", "Magnitude [dB]", "Phase"), ("Hz", linear, "deg"), "its name says 'dB': decibels of"),
        (("f", "Magnitude", "Phase"), ("Hz", linear, "deg"), "expected magnitudes of 0 or above; line 1 is below"),
        (("f [rad/s]", "Mag", "Phase"), ("Hz", f"dB re 1 {linear}", "deg"), "its name says 'rad/s'"),
        (("f [kHz]", "Mag", "Phase"), ("Hz", f"dB re 1 {linear}", "deg"), "its name says 'kHz'"),
        (("f", "Mag", "Phase [rad]"), ("Hz", f"dB re 1 {linear}", "deg"), "its name says 'rad'"),
        (("f", "Mag", "Phase [deg]"), ("Hz", f"dB re 1 {linear}", "rad"), "its name says 'deg'"),
        (("f", "Mag (g/N)", "Phase"), ("Hz", f"dB re 1 {linear}", "deg"), "its name says 'g/N'"),
    ]
    for names, units, sentence in cases:
        with subtests.test(names=names, units=units), pytest.raises(RecordingFormatError) as caught:
            responses(bode(tmp_path, names, (LINES, LEVEL, DEGREES)), of_columns(names, units))
        with subtests.test(sentence=sentence):
            assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("above", "below", "said", "factor"),
    [
        ("g", "N", "g/N", 9.80665), ("g", "N", "", 9.80665), ("m/s2", "N", "m/(N.s2)", 1.0),
        ("g", "N", "m/(N.s2)", None),
        ("m/s", "N", "m/(N.s2)", None), ("m/s2", "kN", "m/(N.s2)", None), ("mm/s2", "N", "m/(N.s2)", None),
        ("g", None, "m/(N.s2)", None), ("m/s2", None, "m/(N.s2)", 1.0), ("m/(N.s2)", None, "m/(N.s2)", 1.0),
        ("g", None, "g/lbf", 9.80665 / 4.4482216152605), (None, None, "m/(N.s2)", 1.0), (None, None, "", None),
        ("EU", "EU", "m/(N.s2)", 1.0), ("m", "N", "", None),
    ],
)  # fmt: skip
def test_a_response_of_a_file_has_the_unit_of_the_file_and_of_the_map_or_is_refused(above, below, said, factor):
    convert = partial(
        response_factor, excitation=ExcitationPoint.FORCE_AT_TABLE, response=ResponsePoint.ACCELERATION_AT_TABLE
    )
    source = MappedChannel("H", said, convert(said, where="map") if said else math.nan, convert)
    response = FrequencyResponse("H", np.array(LINES), TRUTH, above, below)
    if factor is None:
        with pytest.raises(RecordingFormatError, match=r"^a\.uff, H"):
            resolved_response(source, response, "a.uff, H")
    else:
        assert resolved_response(source, response, "a.uff, H").factor == pytest.approx(factor, rel=1e-12)


# ---- numbers that begin anew --------------------------------------------------------------------------------------

MOTION = """
axis_id = "a"
[motion]
sample_rate_hz = 1000
position = {{channel = "x", {unit}}}
force = {{channel = "f", unit = "N"}}
"""
TRAVEL = 0.15 * np.sin(2.0 * np.pi * np.arange(2000) / 1000.0)  # [m]


def motion(tmp_path, numbers, unit):
    np.savez(tmp_path / "a.npz", x=numbers, f=np.cos(np.arange(2000) / 50.0))
    (tmp_path / "map.toml").write_text(MOTION.format(unit=unit), encoding="utf-8")
    return import_motion([tmp_path / "a.npz"], read_channel_map(tmp_path / "map.toml")).record.position


def test_counts_that_wrap_are_unwrapped_where_the_map_says_where_and_refused_elsewhere(tmp_path, subtests):
    counts = 'unit = "count", sensitivity = 1.0, sensitivity_unit = "um/count"'
    turns = 'unit = "deg", sensitivity = 10, sensitivity_unit = "mm/rev"'
    cases = {
        "16 bits": (np.mod(np.rint(TRAVEL * 1e6) + 1000, 65536), counts, 65536, 1e-6),
        "signed 16 bits": (np.mod(np.rint(TRAVEL * 1e6) + 32768, 65536) - 32768, counts, 65536, 1e-6),
        "a turn": (np.mod(TRAVEL / 0.01 * 360.0 + 1.0, 360.0), turns, 360, 1e-12),
        "the lead": (np.mod(TRAVEL * 1e3 + 1.0, 10.0), 'unit = "mm"', 10, 1e-12),
    }
    for case, (numbers, unit, wraps_at, digit) in cases.items():
        with subtests.test(case=case):
            position = motion(tmp_path, numbers, f"{unit}, wraps_at = {wraps_at}")
            np.testing.assert_allclose(position - position[0], TRAVEL - TRAVEL[0], rtol=0, atol=digit)
            with pytest.raises(RecordingFormatError, match=r"begin anew; they jump by .* wraps_at = ") as caught:
                motion(tmp_path, numbers, unit)
            assert str(wraps_at) in str(caught.value) or case == "the lead"
    plain = motion(tmp_path, TRAVEL, 'unit = "m"')  # a motion that turns, and one with a step in it, are no counts
    np.testing.assert_array_equal(plain, TRAVEL)
    stepped = np.where(np.arange(2000) < 700, 0.0, 0.2)
    np.testing.assert_array_equal(motion(tmp_path, stepped, 'unit = "m"'), stepped)


def test_a_name_does_not_overrule_a_unit_on_which_file_and_map_agree():
    assert agreed_unit("mm", "m", "mm", "a, pos_m") == "mm"
    with pytest.raises(RecordingFormatError, match="the file says 'mm', and the name 'm'"):
        agreed_unit("mm", "m", "", "a, pos_m")


ROTATING = """
axis_id = "a"
excitation = {{channel = "tq", quantity = "torque", source = "sensor", unit = "N.m"}}
response = {{channel = "ac", unit = "m/s2"}}
position = {{channel = "x", unit = "mm", wraps_at = 10}}
{time}
[window]
started_at = 2025-03-01T06:00:00Z
{window}
"""


def rotating(tmp_path, text, shape, **more):
    wave = np.sin(np.arange(2000) / 3.0).reshape(shape)
    turning = np.mod(0.01 * np.arange(2000) + 5.0, 10.0).reshape(shape)
    np.savez(tmp_path / "a.npz", tq=wave, ac=wave, x=turning, **more)
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    return import_session([tmp_path / "a.npz"], read_channel_map(tmp_path / "map.toml"))


def test_turns_that_lie_in_a_break_or_between_the_windows_of_an_array_are_not_made_up(tmp_path):
    times = np.arange(2000) / 1000.0 + 58.0 * (np.arange(2000) >= 1000)
    drive = ROTATING.format(time='[time]\nchannel = "t"\nunit = "s"', window="")
    with pytest.raises(RecordingFormatError, match=r"x: .* without a break .* behind sample 999: how many turns"):
        rotating(tmp_path, drive, (2000,), t=times)
    windows = 'sample_rate_hz = 1000\nwindows_in = "rows"\nwindow_interval_s = 2'
    with pytest.raises(RecordingFormatError, match=r"x: .* one-dimensional .* for wraps_at; got shape \(4, 500\)"):
        rotating(tmp_path, ROTATING.format(time="", window=windows), (4, 500))


def test_vibrations_and_excitations_are_no_counts_that_wrap() -> None:
    rng, source = np.random.default_rng(3), MappedChannel("a", "m/s2", 1.0, float)
    signals = [
        scipy.signal.lfilter(*scipy.signal.butter(2, rng.uniform(0.05, 0.9)), rng.standard_normal(256))
        for _ in range(2000)
    ]
    held = np.repeat(rng.choice([-1.0, 1.0], 1000), 8)
    square = np.sign(np.sin(2.0 * np.pi * 5.0 * (np.arange(8000) + 0.5) / 5000.0))
    blows = np.where(np.arange(8000) % 2000 == 1000, 1.0, 0.0)
    blows += 0.7 * np.roll(blows, 1)
    signals += [
        driven + noise * rng.standard_normal(8000) for driven in (held, square, blows) for noise in (1e-3, 1e-2, 5e-2)
    ]
    signals += [signal.repeat(10) for signal in signals[:2000]]  # as a slow channel beside a fast one
    assert [number for number, signal in enumerate(signals) if _refused(signal, source)] == []
    slow = np.mod(np.arange(8000) // 7, 256.0)  # an encoder that stands for seven samples at each count
    assert _refused(slow, source)


def _refused(samples, source) -> bool:
    try:
        return unwrapped(samples, source, "a") is not samples
    except RecordingFormatError:
        return True
