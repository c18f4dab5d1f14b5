"""The form error learnt from healthy machines: a planted spectrum is recovered, noise of the measurement is not."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.form_learning import learn_form_error
from monitor_core.errors import NotIdentifiableError
from monitor_core.models.protocol import ResponsePoint
from tests.discrepancy.axes import measured, settings, subject, true_subject

POINT = ResponsePoint.ACCELERATION_AT_TABLE
BAND = np.geomspace(30.0, 1200.0, 240)
NOISE = 0.001  # of every line


def planted(frequency):
    """Return a form error that grows from 0.2 % at 150 Hz to 1 % at 1000 Hz. [-]."""
    return np.interp(np.log(frequency), np.log([150.0, 1000.0]), [0.002, 0.010])


def machine(seed, size=1.0):
    """Return responses whose lines are off by what was planted, beside noise of 0.1 %."""
    rng = np.random.default_rng([seed, 7])
    observations = [
        replace(
            one,
            response=one.response
            * np.exp(
                size * planted(one.frequency) * (rng.standard_normal(BAND.size) + 1j * rng.standard_normal(BAND.size))
            ),
        )
        for one in measured(
            true_subject(seed), settings((0.2, 0.45, 0.7), (150.0, 300.0)), seed=seed, noise=NOISE, lines=BAND
        )
    ]
    return observations, subject()


def test_a_planted_spectrum_is_recovered() -> None:
    """Within 20 %: 480 values in each of twelve bands know it to 4 %."""
    form = learn_form_error([machine(seed) for seed in (1, 2)])
    assert list(form.spectra) == [POINT]
    spectrum = form.of(POINT)
    assert spectrum.frequency[0] < 40.0
    assert spectrum.frequency[-1] > 900.0
    np.testing.assert_allclose(spectrum.typical, planted(np.array(spectrum.frequency)), rtol=0.2)
    np.testing.assert_allclose(spectrum.deviation, planted(np.array(spectrum.frequency)), rtol=0.2)


def test_noise_is_not_taken_for_form() -> None:
    """Of a model that is right nothing is left beyond it but chance: √(2/240) of the noise's square in each band."""
    spectrum = learn_form_error([machine(3, size=0.0)]).of(POINT)
    assert np.mean(np.square(spectrum.typical)) < 2.0 * np.sqrt(2.0 / 240.0) * NOISE**2
    assert np.all(np.array(spectrum.deviation) > 0.0)


def test_machines_are_pooled() -> None:
    """The mean of the squares: a machine of twice the error beside one of none makes √2 times it."""
    alone, pooled = (
        learn_form_error(machines).of(POINT).typical
        for machines in ([machine(4)], [machine(4, size=2.0), machine(5, size=0.0)])
    )
    np.testing.assert_allclose(pooled[4:], np.sqrt(2.0) * np.array(alone[4:]), rtol=0.2)


def test_without_a_machine_there_is_nothing_to_learn() -> None:
    with pytest.raises(NotIdentifiableError, match="at least one healthy machine; got none"):
        learn_form_error([])
