"""Say how long the charts take to alarm after a loss: the other side of a rate of false alarms."""

from dataclasses import dataclass

from monitor_core.errors import OutsideValidityError
from monitor_core.trend.design import DetectorDesign
from monitor_core.trend.run_length import cusum_run_length


@dataclass(frozen=True, slots=True)
class DetectionDelay:
    """Average run length of the charts after a sudden loss, from empty charts to the alarm."""

    sessions: float  # [-]
    days: float  # at the sessions a year of the settings


def detection_delay(design: DetectorDesign, shift: float) -> DetectionDelay:
    r"""Return how long a loss stays unnoticed on average, by the run lengths that the limits were solved with.

    The chain of :func:`monitor_core.trend.run_length.cusum_run_length` with the Shewhart rule, at a residual
    N(shift, 1). It holds for sessions that are independent of each other and a baseline that is known; where
    neighbouring sessions resemble each other it takes longer. What all sessions together say comes on top, and may
    alarm earlier.

    Parameters
    ----------
    design : DetectorDesign
        Limits of the charts.
    shift : float
        The loss in standard deviations of what is predicted of a healthy session, not negative. [-]

    Returns
    -------
    DetectionDelay
        Sessions up to and including the one that alarms, and the days that they take.

    Raises
    ------
    OutsideValidityError
        If the shift is negative.

    Examples
    --------
    A loss of no size is alarmed as often as a healthy axis is falsely by these two, nine times of ten alarms:

    >>> from monitor_core.trend import DetectorSettings, design_detector
    >>> design = design_detector(DetectorSettings(false_alarms_per_year=1.0))
    >>> round(detection_delay(design, 0.0).days)
    406
    """
    if not shift >= 0.0:
        raise OutsideValidityError(f"shift must not be negative; got {shift}")
    run_length = cusum_run_length(
        design.cusum_limit,
        reference=design.cusum_reference,
        shift=shift,
        largest_increment=design.largest_increment,
        confirmed_limit=design.shewhart_limit,
    )
    sessions = float(run_length)
    return DetectionDelay(sessions, sessions * 365.0 / design.sessions_per_year)
