"""What windows state twice is compared: of a plant whose traces are true, and of traces that are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.cross_checks import looks_like_unit
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import AxisSettings, judge_measurement
from monitor_core.preload import Calibration, PreloadEstimate
from monitor_core.recording import Window
from monitor_core.session import calibrate_session
from tests.plant.shop import CASES, MEDIUM, Truth, calibration_session, case_session

SETTINGS = AxisSettings(search_band=(120.0, 260.0))


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return calibrate_session(calibration_session(MEDIUM, np.random.default_rng([53, 0])), SETTINGS)


@pytest.fixture(scope="module")
def healthy() -> Truth:
    return case_session(MEDIUM, CASES["healthy"], np.random.default_rng([53, 1]), day=0)


Spoil = Callable[[Window], Window]


def tagged_off(metres: float) -> Spoil:
    return lambda w: replace(w, conditions=replace(w.conditions, position=w.conditions.position + metres))


#: What is done to the windows, and what is to be said of them; nothing: they contradict nothing.
STATED_TWICE: dict[str, tuple[Spoil, str]] = {
    "tag and trace agree": (lambda w: w, ""),
    "tag 10 mm off": (tagged_off(0.010), "position-contradicts-trace"),
    "tag 30 mm off": (tagged_off(-0.030), "position-contradicts-trace"),
    "tag 100 mm off": (tagged_off(0.100), "position-contradicts-trace"),
    "tag in metres": (
        lambda w: replace(w, conditions=replace(w.conditions, position=1e-3 * w.conditions.position)),
        "position-contradicts-trace",
    ),
    "tag of another end of the travel": (tagged_off(0.0025), ""),
    "a trace from a start of its own": (
        lambda w: replace(w, position_trace=w.position_trace - w.position_trace[0]),
        "",
    ),
}


def test_no_measurement_that_contradicts_itself_is_silent_and_outside(calibration: Calibration, healthy: Truth) -> None:
    wrong = []
    names = healthy.session.measurements
    for number, (what, (spoil, said)) in enumerate(STATED_TWICE.items()):
        place = number % len(names)
        windows = [spoil(window) for window in healthy.session.windows_of(names[place])]
        outcome = judge_measurement(windows, SETTINGS, calibration)
        assert isinstance(outcome.preload, PreloadEstimate), (what, outcome.preload)
        assert isinstance(outcome.modal, ModalMeasurement)
        reasons = [str(doubt.reason) for doubt in outcome.preload.doubts]
        if reasons != ([said] if said else []):
            wrong.append((what, reasons))
        if not outcome.preload.interval.covers(healthy.preload[place]):
            wrong.append((what, outcome.preload.preload))
        if [doubt.detail for doubt in outcome.preload.doubts] != [w for w in outcome.modal.warnings if "expected" in w]:
            wrong.append((what, outcome.modal.warnings))
    assert wrong == []


def test_a_calibration_rests_on_the_trace_where_a_tag_contradicts_it(healthy: Truth) -> None:
    windows = healthy.session.windows_of(healthy.session.measurements[0])
    modal = judge_measurement([tagged_off(0.1)(window) for window in windows], SETTINGS, None).modal
    assert isinstance(modal, ModalMeasurement)
    assert modal.conditions.position == pytest.approx(windows[0].conditions.position, abs=2e-3)


def test_units_are_recognised_by_their_factor() -> None:
    assert looks_like_unit(1.4) is None
    assert looks_like_unit(0.0) is None
    for factor, unit in ((1000.0, "mm"), (9.81, "g for"), (2.0 * np.pi, "rad"), (60.0, "minutes"), (57.3, "degrees")):
        for ratio in (factor, 1.0 / factor, -factor, 1.01 * factor):
            assert unit in (looks_like_unit(ratio) or ""), ratio
        assert looks_like_unit(1.12 * factor) is None
    assert "mm" in (looks_like_unit(1100.0, 0.05) or "")
