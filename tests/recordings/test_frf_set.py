"""FRF sets: exact round trip, files of other writers, and one scenario for each thing that may be wrong."""

import itertools
import json
import shutil
import time

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from monitor_core.errors import OutsideValidityError, RecordingFormatError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings import check_file
from monitor_core.recordings.elements.units import response_unit
from monitor_core.recordings.frf_set import (
    FrequencyResponseSet,
    MeasuredResponse,
    read_frf_set,
    write_frf_set,
)
from service.cli.check import check

N_LINES = 16
SECOND = "conditions/0001"
FIELDS_OF_CONDITIONS = (
    DriveConditions(0.25),
    DriveConditions(0.1234, preload=300.0, payload_mass=12.5, temperature_deviation=-1.7, excitation_level=0.013),
)


def response_of(
    number=0,
    conditions=FIELDS_OF_CONDITIONS[1],
    excitation=ExcitationPoint.TORQUE_AT_SCREW,
    response=ResponsePoint.ACCELERATION_AT_TABLE,
    temperature=None,
):
    rng = np.random.default_rng(number)
    values = rng.normal(size=N_LINES) + 1j * rng.normal(size=N_LINES)
    observation = FrequencyResponseObservation(
        conditions,
        np.linspace(140.1, 230.3, N_LINES),
        values,
        rng.uniform(0.01, 0.02, N_LINES),
        excitation,
        response,
        resolution=0.5 * number,
    )
    return MeasuredResponse(observation, temperature)


@pytest.fixture
def frf_file(tmp_path):
    """Write a good set of two conditions, open for damage."""
    path = tmp_path / "axis.frf.h5"
    write_frf_set(path, FrequencyResponseSet((response_of(0), response_of(1))))
    return path


def refusal(path) -> str:
    with pytest.raises(RecordingFormatError) as caught:
        read_frf_set(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    return message


# ---- round trip ---------------------------------------------------------------------------------------------------


def test_what_is_written_is_read_bit_for_bit(tmp_path, subtests):
    for excitation, point in itertools.product(ExcitationPoint, ResponsePoint):
        with subtests.test(excitation=excitation, point=point):
            path = tmp_path / "axis.frf.h5"
            written = FrequencyResponseSet(
                tuple(
                    response_of(number, conditions, excitation, point, temperature)
                    for number, (conditions, temperature) in enumerate(
                        zip(FIELDS_OF_CONDITIONS, (None, 23.4), strict=True)
                    )
                )
            )
            write_frf_set(path, written)
            back = read_frf_set(path)
            assert [response.temperature for response in back.measured] == [None, 23.4]
            for a, b in zip(written.observations, back.observations, strict=True):
                assert (a.conditions, a.excitation, a.response_point) == (b.conditions, b.excitation, b.response_point)
                for name in ("frequency", "response", "standard_deviation"):
                    assert getattr(b, name).dtype == getattr(a, name).dtype
                    assert getattr(b, name).tobytes() == getattr(a, name).tobytes()


def test_conditions_keep_their_order_beyond_four_digits(tmp_path):
    path = tmp_path / "axis.frf.h5"
    write_frf_set(path, FrequencyResponseSet(tuple(response_of(i, DriveConditions(i * 1e-3)) for i in (3, 1, 2))))
    with h5py.File(path, "r+") as file:
        file["conditions"].move("0001", "10000")
        file["conditions"].move("0002", "9999")
    assert [observation.conditions.position for observation in read_frf_set(path).observations] == [0.003, 0.002, 0.001]


def test_the_same_set_gives_the_same_bytes_at_another_time_and_replaces_what_was_there(frf_file, tmp_path):
    other = tmp_path / "other.frf.h5"
    other.write_bytes(b"something longer than nothing")
    time.sleep(1.1)  # HDF5 time stamps count seconds
    write_frf_set(other, read_frf_set(frf_file))
    assert other.read_bytes() == frf_file.read_bytes()


def test_a_set_without_conditions_is_not_written(tmp_path):
    with pytest.raises(RecordingFormatError, match="expected at least one condition; got none"):
        write_frf_set(tmp_path / "a.frf.h5", FrequencyResponseSet(()))
    assert not (tmp_path / "a.frf.h5").exists()


@pytest.mark.parametrize("temperature", [-300.0, np.nan, np.inf])
def test_a_temperature_that_cannot_be_is_refused(temperature):
    with pytest.raises(OutsideValidityError, match=r"above -273\.15 °C"):
        response_of(temperature=temperature)


# ---- files of other writers ---------------------------------------------------------------------------------------

FREQUENCY = np.array([100.0, 150.0, 200.0])
RESPONSE = np.array([1.0 + 0.5j, 0.25 - 2.0j, -0.125 - 0.75j])
DEVIATION = np.array([0.1, 0.2, 0.3])
REQUIRED = {
    "position_mm": 123.4,
    "input": "torque-at-screw",
    "output": "acceleration-at-table",
    "response_unit": "m/(N.m.s2)",
}


def foreign(path, attributes, frequency=FREQUENCY, response=RESPONSE, deviation=DEVIATION):
    """Write one condition with nothing but h5py, as the format's description says."""
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "preload-frf-set"
        file.attrs["version"] = 1
        group = file.create_group("/conditions/0000")
        for name, values in {"frequency_hz": frequency, "response": response, "standard_deviation": deviation}.items():
            group.create_dataset(name, data=values)
        for name, value in attributes.items():
            group.attrs[name] = value
    return path


def only(path) -> FrequencyResponseObservation:
    (observation,) = read_frf_set(path).observations
    return observation


def test_a_file_of_another_writer_is_read(tmp_path):
    stated = {
        "preload_n": 250, "payload_kg": 5.0, "temperature_c": 26.5, "temperature_delta_c": 6.5,
        "excitation_rms_nm": 0.02, "operator_note": "belt squeaks", "lamp": True,
    }  # fmt: skip
    path = foreign(tmp_path / "a.frf.h5", REQUIRED | stated)
    assert read_frf_set(path).measured[0].temperature == 26.5
    observation = only(path)
    assert observation.conditions == DriveConditions(0.1234, 250.0, 5.0, 6.5, 0.02)
    assert (observation.excitation, observation.response_point) == (
        ExcitationPoint.TORQUE_AT_SCREW,
        ResponsePoint.ACCELERATION_AT_TABLE,
    )
    np.testing.assert_array_equal(observation.frequency, FREQUENCY)
    np.testing.assert_array_equal(observation.response, RESPONSE)
    np.testing.assert_array_equal(observation.standard_deviation, DEVIATION)


def test_a_force_has_its_level_in_newtons(tmp_path):
    force = {"input": "force-at-table", "output": "displacement-at-table", "response_unit": "m/N"}
    observation = only(foreign(tmp_path / "a.frf.h5", REQUIRED | force | {"excitation_rms_n": 7.5}))
    assert observation.conditions.excitation_level == 7.5
    assert observation.excitation is ExcitationPoint.FORCE_AT_TABLE


def test_what_is_not_stated_is_not_there(tmp_path):
    path = foreign(tmp_path / "a.frf.h5", REQUIRED)
    assert only(path).conditions == DriveConditions(0.1234, None, 0.0, 0.0, 0.0)
    assert read_frf_set(path).measured[0].temperature is None


def test_whole_frequencies_single_precision_and_big_endian_are_read_by_value(tmp_path):
    path = foreign(
        tmp_path / "a.frf.h5", REQUIRED, FREQUENCY.astype("i4"), RESPONSE.astype(">c16"), DEVIATION.astype(">f4")
    )
    observation = only(path)
    np.testing.assert_array_equal(observation.frequency, FREQUENCY)
    np.testing.assert_array_equal(observation.response, RESPONSE)
    np.testing.assert_array_equal(observation.standard_deviation, DEVIATION.astype("f4").astype("f8"))


def test_compressed_numbers_are_read(frf_file):
    with h5py.File(frf_file, "r+") as file:
        _replace(file, "response", data=np.ones(N_LINES, "c16"), chunks=(5,), compression="gzip")
    np.testing.assert_array_equal(read_frf_set(frf_file).observations[1].response, np.ones(N_LINES))


def test_fixed_length_texts_and_arrays_of_one_are_what_matlab_writes(tmp_path):
    matlab = {name: np.bytes_(value) if isinstance(value, str) else [[value]] for name, value in REQUIRED.items()}
    path = foreign(tmp_path / "a.frf.h5", matlab)
    with h5py.File(path, "r+") as file:
        file.attrs["format"] = np.bytes_(b"preload-frf-set")
    assert only(path).conditions.position == 0.1234
    report = check_file(path)
    assert (report.format, report.valid, report.problems) == ("preload-frf-set", True, ())


SPELLINGS = {
    ("torque-at-screw", "acceleration-at-table"): (
        "m/(N.m.s2)", "m/s2/N.m", "m/s2/(N.m)", "(m/s2)/(N.m)", "m/s^2/Nm", "(m/s²)/(N·m)", "m/(s2.N.m)",
        "(m/s**2)/(N*m)", "m/s2 / (N m)",
    ),
    ("force-at-table", "acceleration-at-table"): ("m/(N.s2)", "m/s2/N", "(m/s2)/N", "m/s²/N"),
    ("torque-at-screw", "displacement-at-table"): ("m/(N.m)", "m/N.m", "m/Nm"),
    ("force-at-table", "displacement-at-table"): ("m/N",),
    ("torque-at-motor", "angle-at-motor"): ("rad/(N.m)", "rad/Nm"),
    ("force-at-table", "angle-at-motor"): ("rad/N",),
}  # fmt: skip
EVERY_SPELLING = [(points, unit) for points, units in SPELLINGS.items() for unit in units]


@pytest.mark.release
@pytest.mark.parametrize(("points", "unit"), EVERY_SPELLING)
def test_a_unit_is_known_in_its_usual_spellings_and_belongs_to_its_points_alone(tmp_path, points, unit):
    for others, units in SPELLINGS.items():
        stated = REQUIRED | dict(zip(("input", "output"), others, strict=True)) | {"response_unit": unit}
        path = foreign(tmp_path / "a.frf.h5", stated)
        if others == points:
            assert len(read_frf_set(path).observations) == 1
        else:
            assert f"response_unit: expected {units[0]!r} for {others[1]} per {others[0]}; got {unit!r}" in refusal(
                path
            )


@pytest.mark.parametrize("points", SPELLINGS)
def test_the_unit_that_is_written_is_the_one_a_refusal_asks_for(points):
    assert response_unit(ExcitationPoint(points[0]), ResponsePoint(points[1])) == SPELLINGS[points][0]


# ---- refused, each with one sentence -------------------------------------------------------------------------------

TORQUE_ACCELERANCE = "response_unit: expected 'm/(N.m.s2)' for acceleration-at-table per torque-at-screw"
WRONG_ATTRIBUTES = {
    "no position": ("position_mm", None, "position_mm: expected a number [mm]; it is missing"),
    "position that is no number": ("position_mm", np.nan, "position_mm: expected a finite number; got nan mm"),
    "position as a text": ("position_mm", "250", "position_mm: expected a number [mm]; got str '250'"),
    "positions": ("position_mm", [1.0, 2.0], "expected a single number or text; got float64 of shape (2,)"),
    "position as a truth value": ("position_mm", True, "expected a single number or text; got bool"),
    "no input": ("input", None, "input: expected a text; it is missing"),
    "unknown input": ("input", "current", "'torque-at-motor' or 'force-at-table'; got 'current'"),
    "no output": ("output", None, "output: expected a text; it is missing"),
    "unknown output": ("output", "velocity", "or 'angle-at-motor'; got 'velocity'"),
    "no unit": ("response_unit", None, "response_unit: expected a text; it is missing"),
    "unit of the response alone": ("response_unit", "m/s2", f"{TORQUE_ACCELERANCE}; got 'm/s2'"),
    "millimetres": ("response_unit", "mm/s2/N.m", f"{TORQUE_ACCELERANCE}; got 'mm/s2/N.m'"),
    "millinewton metres": ("response_unit", "m/s2/mNm", f"{TORQUE_ACCELERANCE}; got 'm/s2/mNm'"),
    "g": ("response_unit", "g/(N.m)", f"{TORQUE_ACCELERANCE}; got 'g/(N.m)'"),
    "no preload": ("preload_n", 0.0, "preload must be positive; got 0.0 N"),
    "negative preload": ("preload_n", -1.0, "preload must be positive; got -1.0 N"),
    "negative payload": ("payload_kg", -1.0, "payload_mass must not be negative; got -1.0 kg"),
    "endless payload": ("payload_kg", np.inf, "payload_kg: expected a finite number; got inf kg"),
    "negative level": ("excitation_rms_nm", -0.1, "excitation_level must not be negative; got -0.1"),
    "level of a force": ("excitation_rms_n", 1.0, "excitation_rms_nm for an input in N.m; got excitation_rms_n"),
    "below absolute zero": ("temperature_c", -300.0, "temperature must lie above -273.15 °C"),
    "deviation as a text": ("temperature_delta_c", "6", "temperature_delta_c: expected a number [K]; got str '6'"),
    "text that is not UTF-8": ("input", np.bytes_(b"\xff\xfe"), "input: expected UTF-8 text"),
}  # fmt: skip


def put(attributes, name, value):
    if name in attributes:
        del attributes[name]
    if value is not None:
        attributes[name] = value


def test_a_wrong_attribute_of_a_condition_is_named_with_its_place(frf_file, subtests):
    for case, (name, value, sentence) in WRONG_ATTRIBUTES.items():
        with subtests.test(case=case):
            damaged = shutil.copyfile(frf_file, frf_file.with_name("damaged.frf.h5"))
            with h5py.File(damaged, "r+") as file:
                put(file[SECOND].attrs, name, value)
            message = refusal(damaged)
            assert sentence in message
            assert "/conditions/0001" in message


WRONG_ROOT = {
    "no format": ("format", None, "format: expected a text; it is missing"),
    "another format": ("format", "preload-session", "expected 'preload-frf-set'; got 'preload-session'"),
    "a later version": ("version", 2, "version: expected 1; got 2"),
    "no version": ("version", None, "version: expected a number"),
}


@pytest.mark.parametrize("case", WRONG_ROOT)
def test_a_wrong_attribute_of_the_file_is_named(frf_file, case):
    name, value, sentence = WRONG_ROOT[case]
    with h5py.File(frf_file, "r+") as file:
        put(file.attrs, name, value)
    assert sentence in refusal(frf_file)


def _replace(file, name, **dataset):
    del file[SECOND][name]
    file[SECOND].create_dataset(name, **dataset)


def _write_half(file):
    _replace(file, "response", shape=(N_LINES,), dtype="c16", chunks=(8,))
    file[SECOND]["response"][:8] = 1.0


def _change(file, name, line, value):
    values = file[SECOND][name][()]
    values[line] = value
    file[SECOND][name][()] = values


WRONG_STRUCTURE = {
    "no conditions": (lambda f: f.pop("conditions"), "/conditions: expected a group; it is missing"),
    "no condition": (
        lambda f: [f["conditions"].pop(n) for n in list(f["conditions"])], "at least one condition; got none",
    ),
    "named otherwise": (lambda f: f["conditions"].move("0001", "second"), "at least 4 digits; got 'second'"),
    "a dataset for a condition": (
        lambda f: f["conditions"].create_dataset("0002", data=[1.0]), "0002: expected a group; got a dataset",
    ),
    "a group for a dataset": (
        lambda f: [f[SECOND].pop("response"), f[SECOND].create_group("response")],
        "0001/response: expected a dataset; got a group",
    ),
    "no frequencies": (lambda f: f[SECOND].pop("frequency_hz"), "0001/frequency_hz: expected a dataset; it is missing"),
    "no response": (lambda f: f[SECOND].pop("response"), "0001/response: expected a dataset; it is missing"),
    "no noise": (
        lambda f: f[SECOND].pop("standard_deviation"), "0001/standard_deviation: expected a dataset; it is missing",
    ),
    "unequal lengths": (
        lambda f: _replace(f, "standard_deviation", data=np.ones(15)),
        "expected as many values in each dataset; got 16 in frequency_hz, 16 in response, 15 in standard_deviation",
    ),
    "no lines": (
        lambda f: [_replace(f, n, data=np.zeros(0, t)) for n, t in
                   (("frequency_hz", "f8"), ("response", "c16"), ("standard_deviation", "f8"))],
        "must be of one length, at least 1; got shapes (0,)",
    ),
    "a scalar": (lambda f: _replace(f, "response", data=np.complex128(1)), "expected one dimension; got shape ()"),
    "two-dimensional": (
        lambda f: _replace(f, "response", data=np.ones((16, 1), "c16")), "expected one dimension; got shape (16, 1)",
    ),
    "a real response": (lambda f: _replace(f, "response", data=np.ones(16)), "expected complex128; got float64"),
    "half the precision": (
        lambda f: _replace(f, "response", data=np.ones(16, "c8")), "expected complex128; got complex64",
    ),
    "complex frequencies": (
        lambda f: _replace(f, "frequency_hz", data=np.ones(16, "c16")), "int64 or int32; got complex128",
    ),
    "frequencies as texts": (
        lambda f: _replace(f, "frequency_hz", data=np.full(16, b"1")), "int64 or int32; got |S1",
    ),
    "a frequency that is no number": (
        lambda f: _change(f, "frequency_hz", 3, np.nan),
        "0001: expected positive, finite frequencies [Hz]; value 4 of 16 is nan",
    ),
    "a line at rest": (
        lambda f: _change(f, "frequency_hz", 0, 0.0), "positive, finite frequencies [Hz]; value 1 of 16 is 0.0",
    ),
    "a negative frequency": (
        lambda f: _change(f, "frequency_hz", 0, -1.0), "positive, finite frequencies [Hz]; value 1 of 16 is -1.0",
    ),
    "unsorted frequencies": (
        lambda f: _change(f, "frequency_hz", 5, 100.0), "expected rising frequencies [Hz]; value 6 of 16 is 100.0",
    ),
    "a frequency twice": (
        lambda f: _change(f, "frequency_hz", 1, 140.1), "expected rising frequencies [Hz]; value 2 of 16 is 140.1",
    ),
    "a response that is no number": (
        lambda f: _change(f, "response", 15, complex(0.0, np.nan)), "a finite response; value 16 of 16 is nanj",
    ),
    "no noise on a line": (
        lambda f: _change(f, "standard_deviation", 2, 0.0), "finite standard deviations; value 3 of 16 is 0.0",
    ),
    "negative noise": (
        lambda f: _change(f, "standard_deviation", 2, -0.1), "finite standard deviations; value 3 of 16 is -0.1",
    ),
    "endless noise": (
        lambda f: _change(f, "standard_deviation", 2, np.inf), "finite standard deviations; value 3 of 16 is inf",
    ),
    "announced but never written": (
        lambda f: _replace(f, "response", shape=(16,), dtype="c16"), "announced but never written",
    ),
    "announced in pieces, not all written": (_write_half, "announced but never written"),
    "a length no response has": (
        lambda f: _replace(f, "response", shape=(10**12,), dtype="c16", chunks=(1024,)), "expected at most",
    ),
}  # fmt: skip


def test_a_wrong_structure_is_refused(frf_file, subtests):
    for case, (damage, sentence) in WRONG_STRUCTURE.items():
        with subtests.test(case=case):
            damaged = shutil.copyfile(frf_file, frf_file.with_name("damaged.frf.h5"))
            with h5py.File(damaged, "r+") as file:
                damage(file)
            assert sentence in refusal(damaged)


def test_temperatures_without_deviations_are_from_their_mean_and_never_mixed_with_others(frf_file):
    with h5py.File(frf_file, "r+") as file:
        first, second = (file["conditions"][name].attrs for name in ("0000", "0001"))
        first["temperature_c"], second["temperature_c"] = 20.0, 20.0
        del first["temperature_delta_c"], second["temperature_delta_c"]
    assert [observation.conditions.temperature_deviation for observation in read_frf_set(frf_file).observations] == [
        0.0,
        0.0,
    ]
    with h5py.File(frf_file, "r+") as file:
        file[SECOND].attrs["temperature_c"] = 35.0
    assert [observation.conditions.temperature_deviation for observation in read_frf_set(frf_file).observations] == [
        -7.5,
        7.5,
    ]
    with h5py.File(frf_file, "r+") as file:
        file[SECOND].attrs["temperature_delta_c"] = 15.0
    assert (
        "/conditions/0000, temperature_delta_c: expected a deviation from the reference [K], because the temperatures "
        "of the set differ (20 to 35 °C) and not all stand alone; it is missing" in refusal(frf_file)
    )


def test_a_set_does_not_reach_into_other_files(frf_file, tmp_path):
    secret = tmp_path / "secret.h5"
    secret.write_bytes(frf_file.read_bytes())
    with h5py.File(frf_file, "r+") as file:
        del file[SECOND]
        file[SECOND] = h5py.ExternalLink(str(secret), SECOND)
    assert "/conditions/0001: expected a group inside the file; got a link" in refusal(frf_file)


def test_numbers_stored_outside_the_file_are_refused(frf_file, tmp_path):
    (tmp_path / "secret.bin").write_bytes(np.ones(N_LINES).tobytes())
    with h5py.File(frf_file, "r+") as file:
        _replace(file, "standard_deviation", shape=(N_LINES,), dtype="f8",
                 external=[(str(tmp_path / "secret.bin"), 0, N_LINES * 8)])  # fmt: skip
    assert "standard_deviation: expected numbers inside the file; they are stored in another one" in refusal(frf_file)


# ---- damaged files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [b"", b"not HDF5 at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_what_is_no_hdf5_file_is_refused(tmp_path, content):
    path = tmp_path / "axis.frf.h5"
    path.write_bytes(content)
    refusal(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    assert "nothing is at this path" in refusal(tmp_path / "nothing.frf.h5")
    assert "folder" in refusal(tmp_path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused_and_known_by_its_name(frf_file, share):
    content = frf_file.read_bytes()
    frf_file.write_bytes(content[: int(share * len(content))])
    refusal(frf_file)
    assert check_file(frf_file).format == "preload-frf-set"


# ---- preload check ------------------------------------------------------------------------------------------------


def checked(path) -> tuple[int, dict]:
    outcome = CliRunner().invoke(check, [str(path), "--json"])
    return outcome.exit_code, json.loads(outcome.stdout)


def test_check_reports_a_good_set(frf_file):
    exit_code, document = checked(frf_file)
    assert exit_code == 0
    assert [document[key] for key in ("format", "valid", "problems", "channels")] == ["preload-frf-set", True, [], []]
    assert document["usable_by"] == ["identify", "explain"]


def test_check_knows_a_set_whatever_its_name(frf_file):
    report = check_file(frf_file.rename(frf_file.with_name("a.h5")))
    assert (report.format, report.valid, report.problems) == ("preload-frf-set", True, ())


def test_check_lists_every_bad_condition(frf_file):
    with h5py.File(frf_file, "r+") as file:
        del file["conditions/0000/response"]
        file[SECOND].attrs["response_unit"] = "m/N"
    code, report = checked(frf_file)
    assert (code, report["format"], report["valid"]) == (2, "preload-frf-set", False)
    assert report["problems"] == [
        "axis.frf.h5 /conditions/0000/response: expected a dataset; it is missing",
        f"axis.frf.h5 /conditions/0001, {TORQUE_ACCELERANCE}; got 'm/N'",
    ]
