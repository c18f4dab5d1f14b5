"""Add to a response what modal superposition leaves out: damping between modes, hysteresis, higher modes."""

import numpy as np
import scipy.fft

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.generator.scan import modes_below
from monitor_core.models.protocol import DriveConditions, DriveModel, ExcitationPoint, NormalModes, ResponsePoint

#: A record continued by as many zeros: what still rings after twice its length would come around to its beginning.
_LENGTHS = 2


def acceleration_beyond_modes(
    model: DriveModel,
    conditions: DriveConditions,
    excitation: ExcitationPoint,  # where the torque acts
    *,
    modes: NormalModes,  # that were advanced; of those above half the sampling rate there is no motion
    torque: FloatArray,  # from rest to rest, shape (n_samples, n_windows) [N·m]
    sample_rate: float,  # [Hz]
) -> FloatArray:
    r"""Return what is missing from the acceleration of advanced modes for it to be the model's own, in m/s².

    .. math:: a(t) = \mathcal{F}^{-1}\left\{ \left[ H(f) + \sum_n \frac{\omega^2 \varphi_n \phi_n}
        {\omega_n^2 - \omega^2 + 2j \zeta_n \omega_n \omega} \right] T(f) \right\}

    with the model's torque accelerance H and the shapes φ where the torque acts and at the table. At rest both are the
    motion of the rigid drive. Shape as the torque.
    """
    n_samples = torque.shape[0]
    frequency = scipy.fft.rfftfreq(_LENGTHS * n_samples, 1.0 / sample_rate)
    asked = model.frequency_response(
        frequency[1:], conditions, excitation=excitation, response=ResponsePoint.ACCELERATION_AT_TABLE
    )
    missing = np.zeros(frequency.size, dtype=np.complex128)
    missing[1:] = asked.response - _of_modes(modes_below(modes, 0.5 * sample_rate), frequency[1:])
    spectrum = missing[:, None] * scipy.fft.rfft(torque, _LENGTHS * n_samples, axis=0)
    return np.asarray(scipy.fft.irfft(spectrum, _LENGTHS * n_samples, axis=0)[:n_samples])


def _of_modes(modes: NormalModes, frequency: FloatArray) -> ComplexArray:
    """Return the torque accelerance by modal superposition, shape (n_frequencies,)."""
    omega, own = 2.0 * np.pi * frequency, 2.0 * np.pi * modes.frequency[:, None]
    shapes = (modes.angle_at_motor * modes.displacement_at_table)[:, None]
    stiffness = own**2 - omega**2 + 2j * modes.damping_ratio[:, None] * own * omega
    return np.asarray(-(omega**2) * np.sum(shapes / stiffness, axis=0))
