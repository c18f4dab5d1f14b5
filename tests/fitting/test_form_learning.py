"""The form error learnt from healthy machines: a planted spectrum is recovered, noise of the measurement is not."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.learnt_form import learn_form_error
from monitor_core.models.protocol import ResponsePoint
from tests.discrepancy.axes import measured, settings, subject, true_subject

POINT = ResponsePoint.ACCELERATION_AT_TABLE
BAND = np.geomspace(30.0, 1200.0, 240)
NOISE = 0.001  # of every line


def planted(frequency):
    """Return a form error that grows from 0.2 % at 150 Hz to 1 % at 1000 Hz. [-]."""
    return np.interp(np.log(frequency), np.log([150.0, 1000.0]), [0.002, 0.010])


def machine(seed, size=1.0, *, common=False):
    """Return responses whose lines are off by what was planted, at each setting anew or at all of them alike."""
    rng = np.random.default_rng([seed, 7])
    conditions = settings((0.2, 0.45, 0.7), (150.0, 300.0))
    scatter = rng.standard_normal((2, 1 if common else len(conditions), BAND.size)) * size * planted(BAND)
    off = np.broadcast_to(np.exp(scatter[0] + 1j * scatter[1]), (len(conditions), BAND.size))
    clean = measured(true_subject(seed), conditions, seed=seed, noise=NOISE, lines=BAND)
    return [
        replace(observation, response=observation.response * factor)
        for observation, factor in zip(clean, off, strict=True)
    ], subject()


@pytest.mark.release
@pytest.mark.parametrize("common", [False, True])
def test_a_planted_spectrum_is_recovered(common) -> None:
    """Within 20 %: 160 values and more in each of twelve bands know it to 6 %."""
    form = learn_form_error([machine(seed, common=common) for seed in (1, 2, 3, 4)])
    assert list(form.spectra) == [POINT]
    spectrum = form.of(POINT)
    assert spectrum.frequency[0] < 40.0
    assert spectrum.frequency[-1] > 900.0
    np.testing.assert_allclose(spectrum.deviation, planted(np.array(spectrum.frequency)), rtol=0.2)


def test_a_planted_error_where_the_response_is_steep_is_recovered() -> None:
    """Frequency or damping at each line 0.1 % off: where that counts, within 30 % of its deviation."""
    rng = np.random.default_rng(8)
    healthy, steep = [], []
    for seed in (1, 2, 3, 4):
        clean, described = machine(seed, size=0.0)
        shifted = []
        for observation in clean:
            slope = np.gradient(
                np.log(np.abs(observation.response)) + 1j * np.unwrap(np.angle(observation.response)), np.log(BAND)
            )
            scatter = 0.001 * (rng.standard_normal(BAND.size) + 1j * rng.standard_normal(BAND.size))
            shifted.append(replace(observation, response=observation.response * np.exp(scatter * slope)))
            steep.append((observation.response, np.abs(slope)))
        healthy.append((shifted, described))
    spectrum = learn_form_error(healthy).of(POINT)
    for response, slope in steep:
        counts = slope > 10.0
        found = spectrum.relative_deviation(BAND, response)[counts] / slope[counts]
        assert np.median(found) == pytest.approx(0.001, rel=0.3)
    assert np.median(spectrum.deviation) < 0.001


def test_noise_is_not_taken_for_form() -> None:
    """Of a model that is right no more is left than what no model is counted on to undercut."""
    spectrum = learn_form_error([machine(3, size=0.0)]).of(POINT)
    assert np.min(spectrum.deviation) > 0.0
    assert np.median(spectrum.deviation) <= 0.5 * NOISE


def test_machines_are_pooled() -> None:
    """The mean of the squares: a machine of twice the error beside one of none makes √2 times it."""
    alone, pooled = (
        learn_form_error(machines).of(POINT).deviation
        for machines in ([machine(4)], [machine(4, size=2.0), machine(5, size=0.0)])
    )
    np.testing.assert_allclose(pooled[4:], np.sqrt(2.0) * np.array(alone[4:]), rtol=0.2)


def test_without_a_machine_there_is_nothing_to_learn() -> None:
    with pytest.raises(NotIdentifiableError, match="at least one healthy machine; got none"):
        learn_form_error([])
