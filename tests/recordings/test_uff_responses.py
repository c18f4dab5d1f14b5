"""Frequency responses of universal files (function type 4), as pyuff writes them and as analysers do."""

import warnings

import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import unit_of
from monitor_core.recordings.raw.binary import uff58
from tests.recordings.test_raw import SAMPLES, refusal, uff_set

pyuff = pytest.importorskip("pyuff")
FREQUENCY = 20.0 + 0.5 * np.arange(40)
RESPONSE = 1.0 / (50.0**2 - FREQUENCY**2 + 2j * 0.02 * 50.0 * FREQUENCY)


def written(path, *sets, **settings):
    for label, response in sets:
        stated = {
            "binary": 1, "func_type": 4, "id1": label, "rsp_node": 1, "rsp_dir": 3, "ref_node": 2, "ref_dir": -3,
            "x": FREQUENCY, "data": response, "abscissa_spacing": 1, "abscissa_min": FREQUENCY[0], "abscissa_inc": 0.5,
            "ordinate_spec_data_type": 12, "ordinate_axis_units_lab": "m/s2", "orddenom_spec_data_type": 13,
            "orddenom_axis_units_lab": "N", "abscissa_axis_units_lab": "Hz",
        }  # fmt: skip
        with warnings.catch_warnings(action="ignore"):  # pyuff leaves its file open
            pyuff.UFF(str(path)).write_sets(pyuff.prepare_58(**(stated | settings)), "add")
    return path


@pytest.mark.parametrize("even", [1, 0])
def test_complex_responses_are_read_to_the_last_digit_with_both_units(tmp_path, even):
    path = written(tmp_path / "a.uff", ("point 1", RESPONSE), ("point 2", 2 * RESPONSE), abscissa_spacing=even)
    channels = uff58.read_channels(path)
    assert channels.channels == ()
    assert [response.name for response in channels.responses] == ["point 1", "point 2"]
    for factor, response in enumerate(channels.responses, start=1):
        np.testing.assert_array_equal(response.frequency, FREQUENCY)
        np.testing.assert_array_equal(response.response, factor * RESPONSE)
        assert (response.response_unit, response.reference_unit) == ("m/s2", "N")


def test_labels_that_are_not_distinct_give_way_to_numbers(tmp_path):
    path = written(tmp_path / "a.uff", ("H", RESPONSE), ("H", RESPONSE))
    assert [response.name for response in uff58.read_channels(path).responses] == ["1", "2"]


def test_time_histories_with_the_responses_are_both_read(tmp_path):
    path = written(tmp_path / "a.uff", ("H", RESPONSE))
    path.write_bytes(path.read_bytes() + uff_set(SAMPLES))
    channels = uff58.read_channels(path)
    assert channels.names == ("Acc 1",)
    assert [response.name for response in channels.responses] == ["H"]


def test_a_response_over_another_abscissa_is_refused(tmp_path):
    path = written(tmp_path / "a.uff", ("H", RESPONSE), abscissa_axis_units_lab="rpm")
    assert "expected an abscissa in Hz; got 'rpm'" in refusal(uff58.read_channels, path)


def test_an_amplitude_alone_is_no_frequency_response(tmp_path):
    path = tmp_path / "a.uff"
    path.write_bytes(uff_set(SAMPLES, function=4))
    assert "expected a time history or an FRF in data set 58; got function type 4 (FRF)" in refusal(
        uff58.read_channels, path
    )


def in_units(path, length, force, **labels):
    """Write a response and its history in the units of data set 164, whose factors bring them to SI."""
    factors = {"length": length, "force": force, "temp": 1.0, "temp_offset": 0.0}
    made = pyuff.prepare_164(units_code=9, units_description="user", temp_mode=1, **factors)
    with warnings.catch_warnings(action="ignore"):
        pyuff.UFF(str(path)).write_sets(made, "overwrite")
    written(path, ("H", RESPONSE), **labels)
    return uff58.read_channels(path).responses[0]


def test_numbers_without_a_label_are_in_the_units_of_the_file(tmp_path):
    none = {"ordinate_axis_units_lab": "NONE", "orddenom_axis_units_lab": "NONE"}
    inches = 1.0 / 0.0254, 1.0 / 4.4482216152605  # of a metre and a newton: inch and pound-force
    read = in_units(tmp_path / "a.uff", *inches, **none)
    assert unit_of(read.response_unit).is_same(unit_of("in/s2"))
    assert unit_of(read.reference_unit).is_same(unit_of("lbf"))
    read = in_units(tmp_path / "b.uff", 1.0, 1.0, **none)
    assert (read.response_unit, read.reference_unit) == (None, None)
    read = in_units(tmp_path / "c.uff", *inches, ordinate_axis_units_lab="g", orddenom_axis_units_lab="lbf")
    assert (read.response_unit, read.reference_unit) == ("g", "lbf")
    with pytest.raises(RecordingFormatError, match=r"'m/s2', and data set 164 that numbers are in 0\.001 m/s2"):
        in_units(tmp_path / "d.uff", 1e3, 1e3)
