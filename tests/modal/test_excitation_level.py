"""The excitation stands with a mode, and a measurement that was driven otherwise than the others is said to be."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.modal import ModeGate, measure_mode, session_remarks
from monitor_core.recording import ExcitationSource
from tests.modal.test_near_zero import windows_of

BAND = (100.0, 260.0)


def measured(force):
    windows = windows_of([(170.0, 0.03, 1.0)], 1000.0, 1000)
    scaled = [replace(w, excitation=force * w.excitation, response=force * w.response) for w in windows]
    return measure_mode(scaled, band=BAND, gate=ModeGate()), scaled


def test_the_rms_is_that_of_the_lines_of_the_band():
    answer, windows = measured(1.0)
    lines = np.fft.rfft(np.array([w.excitation for w in windows]), axis=1) / 1000.0
    inside = (np.fft.rfftfreq(1000, 1e-3) >= BAND[0]) & (np.fft.rfftfreq(1000, 1e-3) <= BAND[1])
    assert answer.excitation_rms == pytest.approx(np.sqrt(2.0 * np.mean(np.sum(np.abs(lines[:, inside]) ** 2, axis=1))))


@pytest.mark.parametrize(
    ("forces", "said"), [((1.0, 8.0), [0, 1]), ((1.0, 1.1, 4.0), [2]), ((1.0, 1.2), []), ((1.0,), [])]
)
def test_a_measurement_under_another_force_is_said_to_be(forces, said):
    remarks = session_remarks([measured(force)[0] for force in forces])
    assert [i for i, remark in enumerate(remarks) if remark is not None] == said


@pytest.mark.parametrize(("change", "said"), [(-0.01, "falls"), (0.01, "rises"), (0.0, None)])
def test_a_frequency_that_follows_the_level_is_said_to(change, said):
    # a mode of 170 Hz whose frequency changes by so much from force to twice that force
    forces, place = [1.0, 2.0, 4.0, 8.0], measured(1.0)[0]
    session = [softened(place, force, 170.0 * (1.0 + change * np.log2(force))) for force in forces]
    remarks = session_remarks(session)
    assert [remark is None for remark in remarks] == [False, True, True, False]
    of_level = "here it {} with the level, from 170 Hz at "
    assert [said is not None and of_level.format(said) in remarks[i] for i in (0, 3)] == 2 * [said is not None]
    assert said is not None or "here it" not in remarks[3]
    # another place has another frequency: that is no dependence on the level
    elsewhere = [replace(m, conditions=replace(m.conditions, position=0.1 * i)) for i, m in enumerate(session)]
    assert all("here it" not in remark for remark in session_remarks(elsewhere) if remark is not None)


def softened(measurement, force, frequency):
    """Return the measurement under another force, whose frequency is another for it."""
    mode = replace(measurement.mode, frequency=replace(measurement.mode.frequency, value=frequency))
    return replace(measurement, mode=mode, excitation_level=force * measurement.excitation_level)


def test_excitations_of_two_sources_are_not_compared():
    weak, strong = measured(1.0)[0], measured(8.0)[0]
    assert session_remarks([weak, replace(strong, excitation_source=ExcitationSource.DRIVE)]) == (None, None)
