"""How long a loss stays unnoticed: as charts do that are run, longer for stricter limits and smaller losses."""

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.trend import DetectorSettings, design_detector, detection_delay
from monitor_core.trend.charts import DetectorDesign

DESIGN = design_detector(DetectorSettings(false_alarms_per_year=1.0))
N_RUNS = 4000


def sessions_of_charts(design: DetectorDesign, shift: float) -> np.ndarray:
    """Run the charts of so many axes until each alarms, residual by residual."""
    rng = np.random.default_rng(20)
    cusum, before, alarmed_at = np.zeros(N_RUNS), np.zeros(N_RUNS, dtype=bool), np.zeros(N_RUNS)
    session = 0
    while not alarmed_at.all():
        session += 1
        residual = rng.normal(shift, 1.0, N_RUNS)
        cusum = np.maximum(0.0, cusum + np.minimum(residual - design.cusum_reference, design.largest_increment))
        beyond = residual > design.shewhart_limit
        alarms = (cusum > design.cusum_limit) | (beyond & before)
        alarmed_at[alarms & (alarmed_at == 0)] = session
        before = beyond
    return alarmed_at


@pytest.mark.parametrize("shift", [0.5, 1.0, 2.0, 4.0])
def test_it_is_that_of_charts_that_are_run(shift: float) -> None:
    runs = sessions_of_charts(DESIGN, shift)
    # four standard errors of the mean of the runs, and the 1 % of the cells of the chain
    allowed = 4.0 * runs.std() / np.sqrt(N_RUNS) + 0.01 * runs.mean()
    assert detection_delay(DESIGN, shift).sessions == pytest.approx(runs.mean(), abs=allowed)


def test_a_stricter_limit_and_a_smaller_loss_take_longer() -> None:
    strict = design_detector(DetectorSettings(false_alarms_per_year=0.1))
    assert detection_delay(strict, 1.0).days > detection_delay(DESIGN, 1.0).days > detection_delay(DESIGN, 2.0).days


def test_days_follow_from_how_often_is_measured() -> None:
    weekly = design_detector(DetectorSettings(false_alarms_per_year=1.0, measurements_per_year=52.0))
    found = detection_delay(weekly, 1.0)
    assert found.days == pytest.approx(found.sessions * 365.0 / 52.0)


def test_a_gain_is_no_loss() -> None:
    with pytest.raises(OutsideValidityError, match="must not be negative"):
        detection_delay(DESIGN, -1.0)
