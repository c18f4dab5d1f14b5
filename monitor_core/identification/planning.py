"""What a measurement that has not been made would say: Jacobians of planned peaks and planned responses."""

from collections.abc import Mapping, Sequence

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.identification.coordinates import JointCoordinates
from monitor_core.identification.modal_problem import AMPLITUDE_UNCERTAINTY, FREQUENCY_UNCERTAINTY, modal_problem
from monitor_core.identification.observations import AssignedPeak, FrequencyResponseObservation, ModalObservation
from monitor_core.identification.peaks import Band, Place, find_peaks, peak_grid
from monitor_core.identification.response_problem import response_problem
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd
from monitor_core.models.receptance.closed_form import position_terms, table_receptance


def planned_peaks(
    joints: JointCoordinates,
    coordinates: FloatArray,
    conditions: Sequence[DriveConditions],
    bands: Mapping[int, Band],
    *,
    relative_frequency_uncertainty: float = FREQUENCY_UNCERTAINTY,
    relative_amplitude_uncertainty: float = AMPLITUDE_UNCERTAINTY,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> tuple[tuple[DriveConditions, FloatArray], ...]:
    """Return for each position the Jacobian of the peaks that would be read there, for ``rank_next_positions``.

    Parameters
    ----------
    joints : JointCoordinates
    coordinates : ndarray, shape (n_parameters,)
        Of the fit.
    conditions : sequence of DriveConditions
        Where one could measure; a position without a peak is left out.
    bands : mapping of int to Band
    relative_frequency_uncertainty, relative_amplitude_uncertainty : float
        Of one peak. [-]
    motor_end : MotorEnd
    """
    planned = []
    for one in conditions:
        grid = peak_grid(joints.axis, [Place(one, band) for band in bands.values()], motor_end)
        peaks = find_peaks(grid, joints.joints(coordinates, one))
        expected = [
            AssignedPeak(
                ModalObservation(
                    one,
                    frequency,
                    relative_frequency_uncertainty * frequency,
                    amplitude,
                    relative_amplitude_uncertainty * amplitude,
                ),
                mode,
            )
            for mode, found, frequency, amplitude in zip(
                bands, peaks.found, peaks.frequency.tolist(), peaks.amplitude.tolist(), strict=True
            )
            if found
        ]
        if expected:
            problem = modal_problem(
                joints, expected, bands=bands, minimum_positions=0, minimum_data=1, motor_end=motor_end
            )
            planned.append((one, problem.jacobian(coordinates)))
    return tuple(planned)


def planned_responses(
    joints: JointCoordinates,
    coordinates: FloatArray,
    conditions: Sequence[DriveConditions],
    frequency: FloatArray,
    *,
    relative_noise: float,
) -> tuple[tuple[DriveConditions, FloatArray], ...]:
    """Return for each position the Jacobian of the receptance that would be measured, for ``rank_next_positions``.

    Parameters
    ----------
    joints : JointCoordinates
    coordinates : ndarray, shape (n_parameters,)
        Of the fit.
    conditions : sequence of DriveConditions
        Where one could measure.
    frequency : ndarray, shape (n_frequencies,)
        [Hz]
    relative_noise : float
        Standard deviation of real and of imaginary part over |H|. [-]
    """
    planned = []
    for one in conditions:
        terms = position_terms(joints.axis, 2.0 * np.pi * np.asarray(frequency), one)
        response = table_receptance(terms, joints.joints(coordinates, one))
        expected = FrequencyResponseObservation(
            one, frequency, response, relative_noise * np.abs(response), ExcitationPoint.FORCE_AT_TABLE
        )
        planned.append((one, response_problem(joints, [expected]).jacobian(coordinates)))
    return tuple(planned)
