"""A natural frequency that really falls: the circuit board of ``pcb_shock``, watched by the detector as it is."""

from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.trend import (
    Chart,
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
def test_the_fall_is_alarmed_while_the_shocks_of_the_baseline_fall(measured_data: Path) -> None:
    # Others took the first eight shocks for healthy, and found the fall with EWMA and CUSUM at shock 14 to 16. But the
    # board falls from the first shock on, at the pace of the later ones: that is to be said before it is learnt.
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
    assert alarmed_at <= BASELINE_SHOCKS
    assert state.status is TrendStatus.ALARM
    evidence = state.charts.alarm
    assert evidence is not None
    assert evidence.chart is Chart.TREND
    # what the later shocks, which the alarm has not seen, lose in as many days
    later = track.shock.index(BASELINE_SHOCKS)
    pace = np.polyfit(track.shock[later:], track.frequency[later:], 1)[0]
    lost = pace * (alarmed_at - track.shock[0])
    assert abs(evidence.change.value - lost) <= evidence.change.expanded_uncertainty
