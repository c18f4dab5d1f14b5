"""What peaks that have not been measured would say: their Jacobians."""

from collections.abc import Mapping, Sequence

from monitor_core.arrays import FloatArray
from monitor_core.fitting.joint_coordinates import JointCoordinates
from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.fitting.residuals.peak_search import Band, Place, find_peaks, peak_grid
from monitor_core.fitting.residuals.peaks import AMPLITUDE_UNCERTAINTY, FREQUENCY_UNCERTAINTY, modal_problem
from monitor_core.models.protocol import DriveConditions, MotorEnd


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
