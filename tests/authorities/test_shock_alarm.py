"""A natural frequency that really falls: the circuit board of ``pcb_shock``, watched by the detector as it is."""

from datetime import timedelta
from pathlib import Path

import pytest

from monitor_core.trend import (
    DetectorSettings,
    DetectorState,
    LossDirection,
    Observation,
    Prior,
    TrendStatus,
    design_detector,
    step,
)
from monitor_core.trend.belief import STRUCTURES
from tests.authorities.real_records import BASELINE_SHOCKS, START, shock_frequency_track


@pytest.mark.release
def test_the_fall_is_alarmed_between_shock_13_and_17(measured_data: Path) -> None:
    # others found 14 to 16 with EWMA and CUSUM on the same baseline of eight shocks and a plainer estimator
    track = shock_frequency_track(measured_data)
    settings = DetectorSettings(baseline_size=BASELINE_SHOCKS, baseline_span=timedelta(0), loss=LossDirection.FALL)
    design = design_detector(settings)
    # one test on one bench, shock after shock: no days between them that could make them depend on each other
    independent = Prior(weights=(1.0, *(1e-6,) * (len(STRUCTURES) - 1)))
    state, alarmed_at = DetectorState(prior=independent), None
    for shock, frequency in zip(track.shock, track.frequency, strict=True):
        state = step(state, Observation(START + timedelta(days=shock), frequency), design)
        if alarmed_at is None and state.status is TrendStatus.ALARM:
            alarmed_at = shock
    assert alarmed_at is not None
    assert 13 <= alarmed_at <= 17
    assert state.status is TrendStatus.ALARM
