"""What windows state twice is compared: of a plant whose traces are true, and of statements that are not."""

from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from benchmarks.stated_twice import (
    REGIMES,
    SETTINGS,
    SPOILT,
    WIRINGS,
    WITHIN_STROKE,
    Spoil,
    answer,
    doubted,
    late,
    tagged_off,
    traced,
)
from monitor_core.cross_checks import looks_like_unit
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import check_window, judge_measurement
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.session import calibrate_session
from tests.plant.chain import Condition
from tests.plant.shop import CASES, MEDIUM, Truth, calibration_session, case_session, recorded_session


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return calibrate_session(calibration_session(MEDIUM, np.random.default_rng([53, 0])), SETTINGS)


@pytest.fixture(scope="module")
def healthy() -> Truth:
    return case_session(MEDIUM, CASES["healthy"], np.random.default_rng([53, 1]), day=0)


@pytest.mark.release
def test_no_measurement_that_contradicts_itself_is_silent_and_outside(calibration: Calibration, healthy: Truth) -> None:
    wrong = []
    names = healthy.session.measurements
    for number, (what, (spoil, expected)) in enumerate(SPOILT.items()):
        place = number % len(names)
        windows = [spoil(window) for window in healthy.session.windows_of(names[place])]
        found = answer(windows, healthy.preload[place], calibration)
        if expected not in found.said or (found.outside and not found.said):
            wrong.append((what, names[place], found))
    assert wrong == []


def test_windows_that_agree_are_not_doubted(healthy: Truth) -> None:
    agreeing = {
        "as recorded": lambda w: w,
        "a tag of another place of the travel": tagged_off(0.0025),
        "a trace from a start of its own": traced(lambda x, w: x - x[0]),
        "a trace that is a sample late": late(1),
        "an accelerometer mounted the other way round": lambda w: replace(w, response=-w.response),
        "torque counted the other way round": lambda w: replace(w, excitation=-w.excitation),
        # positive towards the fixed bearing, from which positions count: as of half of all axes
        "both counted the other way round": lambda w: replace(w, response=-w.response, excitation=-w.excitation),
        "a trace counted the other way round": traced(lambda x, w: x.min() + x.max() - x),
        "no trace": lambda w: replace(w, position_trace=None),
    }
    for what, change in agreeing.items():
        for name in healthy.session.measurements[:2]:
            assert doubted([change(w) for w in healthy.session.windows_of(name)]) == [], what


@pytest.mark.parametrize("wiring", WIRINGS.values(), ids=WIRINGS)
def test_a_reversed_trace_is_told_by_the_way_that_the_calibration_saw_it_driven(healthy: Truth, wiring: Spoil) -> None:
    seen = []
    for name in healthy.session.measurements[:2]:
        windows = [wiring(w) for w in healthy.session.windows_of(name)]
        calibrated = judge_measurement(windows, SETTINGS, None).modal
        as_made = judge_measurement(healthy.session.windows_of(name), SETTINGS, None).modal
        assert isinstance(calibrated, ModalMeasurement)
        assert isinstance(as_made, ModalMeasurement)
        # friction takes work, whichever way torque, acceleration and position count
        assert calibrated.friction_torque == pytest.approx(as_made.friction_torque, rel=1e-9)
        seen.append(calibrated.trace_polarity)
        assert doubted(windows, calibrated.trace_polarity) == []
        mirrored = [traced(lambda x, w: x.min() + x.max() - x)(w) for w in windows]
        assert doubted(mirrored, calibrated.trace_polarity) == ["trace-contradicts-motion"]
        assert doubted(mirrored, None) == []  # of a calibration that did not look
    assert seen == [-1 if wiring is WIRINGS["torque backward"] or wiring is WIRINGS["both backward"] else 1] * 2


def test_a_tag_is_compared_with_the_middle_of_long_strokes() -> None:
    acquisition = replace(REGIMES["long strokes"](MEDIUM.acquisition), n_windows=4)
    tagged = [Condition(0.5, MEDIUM.healthy)]
    truth = recorded_session(MEDIUM, tagged, tagged, np.random.default_rng(54), acquisition=acquisition)
    windows = truth.session.windows
    assert min(w.position_span for w in windows) > 0.011
    assert doubted(windows) == []
    for off in (0.0025, -0.0025):
        assert doubted([tagged_off(off)(w) for w in windows]) == []
    for spoil, expected in WITHIN_STROKE.values():
        modal = judge_measurement([spoil(w) for w in windows], SETTINGS, None).modal
        assert isinstance(modal, ModalMeasurement)
        assert expected in doubted([spoil(w) for w in windows])
        assert modal.conditions.position == pytest.approx(np.mean([w.position_trace for w in windows]), abs=1e-6)
    # windows that walk along a stroke, of one tag: it is right for the middle of it, and not for its end
    ways = (-0.006, -0.002, 0.002, 0.006)
    walking = [traced(lambda x, w, way=way: x + way)(w) for w, way in zip(windows, ways, strict=True)]
    assert doubted(walking) == []
    assert doubted([tagged_off(-0.006)(w) for w in walking]) == ["position-contradicts-trace"]


def test_where_a_stroke_rests_at_one_end_its_tag_may_be_there_or_in_the_middle(healthy: Truth) -> None:
    n, rate, stroke = 1024, 1024.0, 0.018
    way = np.clip((np.arange(n) - 100.0) / 100.0, 0.0, 1.0) - np.clip((np.arange(n) - 320.0) / 100.0, 0.0, 1.0)
    trace = 0.5 + stroke * way  # there and back in a third of the window
    rings = np.zeros(n)
    for edge in (100, 200, 320, 420):
        rings[edge : edge + 60] += np.cos(0.9 * np.arange(60)) * np.exp(-np.arange(60) / 15.0)
    made = replace(healthy.session.windows[0], sample_rate=rate, response=rings, excitation=rings, position_trace=trace)
    for tag, said in ((trace.mean(), False), (0.5 + 0.5 * stroke, False), (0.5 - 0.006, True), (0.5 + stroke, True)):
        window = replace(made, conditions=replace(made.conditions, position=float(tag)))
        assert ("position-contradicts-trace" in doubted([window])) is said, tag


def test_a_doubt_stands_with_the_mode_too_and_a_calibration_rests_on_the_trace(healthy: Truth) -> None:
    windows = healthy.session.windows_of(healthy.session.measurements[0])
    modal = judge_measurement([tagged_off(0.1)(window) for window in windows], SETTINGS, None).modal
    assert isinstance(modal, ModalMeasurement)
    assert modal.conditions.position == pytest.approx(windows[0].conditions.position, abs=2e-3)
    assert "expected the position tag at the mean of the position trace" in modal.warnings[0]


def test_rate_and_times_are_compared_but_for_windows_that_overlap(healthy: Truth) -> None:
    windows = healthy.session.windows_of(healthy.session.measurements[0])
    start = windows[0].started_at
    slow = [replace(w, sample_rate=0.4 * w.sample_rate) for w in windows]
    assert doubted(slow)[0] == "rate-contradicts-times"
    overlapping = [
        replace(
            windows[0],
            started_at=start + timedelta(seconds=0.5 * i),
            excitation=np.roll(windows[0].excitation, -512 * i),
            response=np.roll(windows[0].response, -512 * i),
            position_trace=None,
        )
        for i in range(15)
    ]
    assert doubted(overlapping) == []


def test_samples_of_a_trace_that_are_no_numbers_refuse_their_window(healthy: Truth) -> None:
    window = healthy.session.windows[0]
    for missing in (slice(7, 8), slice(None)):
        broken = traced(lambda x, w, at=missing: np.where(np.isin(np.arange(x.size), np.arange(x.size)[at]), np.nan, x))
        refusal = check_window(broken(window), SETTINGS, None)
        assert isinstance(refusal, Rejection)
        assert refusal.reason is RejectionReason.NOT_FINITE


def test_units_are_recognised_by_their_factor() -> None:
    assert looks_like_unit(1.4) is None
    assert looks_like_unit(0.0) is None
    for factor, unit in ((1000.0, "mm"), (9.81, "g for"), (2.0 * np.pi, "rad"), (60.0, "minutes"), (57.3, "degrees")):
        for ratio in (factor, 1.0 / factor, -factor, 1.01 * factor):
            assert unit in (looks_like_unit(ratio) or ""), ratio
        assert looks_like_unit(1.12 * factor) is None
    assert "mm" in (looks_like_unit(1100.0, 0.05) or "")
