"""The second plant: the screw as wave lines in tension and in torsion, exact in travel time.

A record of torque is taken as one period of a random torque that has gone on for ever, so that nothing starts from rest
and a window shorter than the record leaks as in reality. Torque and motion have no constant part: a drive that is free
to turn has no place of its own. The motion is exact line by line of frequency; what is not linear in the axis is a
force upon these lines, found in time.
"""

from collections.abc import Sequence

import numpy as np
import scipy.fft

from tests.hidden_effects.truth.axis import Axis, Setting
from tests.hidden_effects.truth.wave_forces import Record, nonlinear_forces
from tests.hidden_effects.truth.wave_network import ComplexArray, FloatArray, lines_of, network_of


def frequency_response(axis: Axis, setting: Setting, frequency: FloatArray) -> tuple[ComplexArray, ...]:
    """Return acceleration and angle per torque of the axis without what is not linear in it.

    Parameters
    ----------
    axis : Axis
    setting : Setting
    frequency : ndarray, shape (n_lines,)
        Above zero. [Hz]

    Returns
    -------
    tuple of two ndarray, shape (n_lines,)
        In m/(N·m·s²) and rad/(N·m).
    """
    return network_of(axis, setting, lines_of(axis, frequency)).seen(1.0)


def respond(
    axis: Axis, settings: Sequence[Setting], torque: FloatArray, sample_rate: float
) -> tuple[FloatArray, FloatArray]:
    """Return how table and rotor move for ever under a torque of which the record is one period.

    Parameters
    ----------
    axis : Axis
        Motor or table must be damped to ground.
    settings : sequence of Setting
    torque : ndarray, shape (n_settings, n_samples)
        At the rotor, band-limited; a constant part moves nothing. [N·m]
    sample_rate : float
        [Hz]

    Returns
    -------
    tuple of two ndarray, shape (n_settings, n_samples)
        Acceleration of the table as its accelerometer gives it [m/s²] and angle of the rotor [rad], without what is
        at or beyond half the sampling rate.
    """
    if torque.ndim != 2 or torque.shape[0] != len(settings):
        raise ValueError(f"torque must have a row for each of {len(settings)} settings; got shape {torque.shape}")
    if axis.hidden.nut_backlash or axis.hidden.nut_contact_loss:
        raise ValueError("a nut that loses contact is solved in steps; take the finite elements")
    record = Record(torque.shape[1], sample_rate)
    spectra = scipy.fft.rfft(torque)[:, record.inside]
    forces = nonlinear_forces(axis, settings, spectra, record)
    lines = lines_of(axis, record.frequency)
    seen = np.zeros((2, len(settings), record.n_samples // 2 + 1), dtype=np.complex128)
    for k, setting in enumerate(settings):
        seen[:, k, record.inside] = network_of(axis, setting, lines).seen(spectra[k], *forces[:, k])
    acceleration, angle = scipy.fft.irfft(seen, record.n_samples)
    return acceleration, angle
