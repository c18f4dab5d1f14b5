"""The main job on the independent plant: calibration session → hidden preloads, position independence, alarms.

The plant (``tests/plant``) shares no formula with the code under test: a finite-element chain in the time domain, with
friction, servo and noise. Sessions are those of ``replay_data/``, so what a user sees in the demonstration is tested.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
import pytest

from monitor_core.axis_state import AxisState, advance
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import (
    AxisSettings,
    MeasurementOutcome,
    calibrate_from_measurements,
    check_window,
    judge_measurement,
)
from monitor_core.preload import Calibration, PreloadEstimate
from monitor_core.recording import Rejection, Window
from monitor_core.recordings import open_session
from monitor_core.trend import DetectorDesign, DetectorSettings, LossDirection, TrendStatus, design_detector
from tests.conftest import PROJECT_ROOT
from tests.plant.chain import Condition
from tests.plant.measurements import CALIBRATION_SCATTER, simulate_measurements, to_windows

pytestmark = pytest.mark.release
SETTINGS = AxisSettings(search_band=(140.0, 230.0))
WINDOWS = 15  # of each simulated measurement
#: Windows of a measurement as recorded, and what came of it.
Judged = tuple[tuple[Window, ...], MeasurementOutcome | None]


@cache
def judged(session: str, *, calibrated: bool = True) -> tuple[Judged, ...]:
    """Gate and judge the measurements of a bundled session; ``None`` where every window was refused."""
    calibration = bundled_calibration() if calibrated else None

    def measurements() -> Iterator[Judged]:
        with open_session(PROJECT_ROOT / "replay_data" / f"{session}.session.h5") as reader:
            for name in reader.measurements:
                windows = reader.windows_of(name)
                accepted = [w for w in windows if not isinstance(check_window(w, SETTINGS, calibration), Rejection)]
                yield windows, judge_measurement(accepted, SETTINGS, calibration) if accepted else None

    return tuple(measurements())


@cache
def bundled_calibration() -> Calibration:
    modes = [outcome.modal for _, outcome in judged("calibration", calibrated=False) if outcome is not None]
    return calibrate_from_measurements([m for m in modes if isinstance(m, ModalMeasurement)], settings=SETTINGS)


@cache
def charts() -> DetectorDesign:
    return design_detector(DetectorSettings(loss=LossDirection.RISE))


@dataclass(frozen=True)
class Watched:
    """A monitoring session after all of it: how many measurements until the alarm, and the state at the end."""

    refused: int
    alarm_after: int | None  # measurements from the first one after learning
    status: TrendStatus
    preloads: tuple[float, ...]


@cache
def watched(session: str) -> Watched:
    calibration, design = bundled_calibration(), charts()
    state, preloads, refused, alarm_after = AxisState(), [], 0, None
    for windows, outcome in judged(session):
        if outcome is None or not isinstance(outcome.preload, PreloadEstimate):
            refused += 1
            continue
        preloads.append(outcome.preload.preload)
        state = advance(state, outcome, windows[0].started_at, calibration=calibration, design=design)
        if alarm_after is None and state.detector.alarm is not None:
            alarm_after = len(preloads) - design.settings.baseline_size
    return Watched(refused, alarm_after, state.detector.status, tuple(preloads))


def test_every_measurement_of_the_calibration_is_judged() -> None:
    outcomes = [outcome for _, outcome in judged("calibration", calibrated=False)]
    assert all(outcome is not None and isinstance(outcome.modal, ModalMeasurement) for outcome in outcomes)
    # Eq. (8) itself holds on the plant to 0.006 Hz rms; what is left is friction and noise, some 0.03 Hz
    assert bundled_calibration().residual_sd < 0.05


def test_hidden_session_is_covered() -> None:
    covered = [
        outcome.preload.interval.covers(windows[0].conditions.preload)
        for windows, outcome in judged("hidden")
        if outcome is not None and isinstance(outcome.preload, PreloadEstimate)
    ]
    assert len(covered) == len(judged("hidden"))
    assert sum(covered) >= 17  # of 20; a 95 % interval misses more than three with probability 1.6 %


@dataclass(frozen=True)
class Trial:
    """One axis calibrated anew, then measured at preloads and positions that its calibration has not seen."""

    calibration: Calibration
    tagged: list[Condition]
    estimates: list[PreloadEstimate]


def measured(tagged: list[Condition], rng: np.random.Generator, *, preload_known: bool) -> list[tuple[Window, ...]]:
    """Simulate measurements with the plant's stated scatter of position, temperature and friction."""
    recorded = simulate_measurements(tagged, rng, scatter=CALIBRATION_SCATTER)
    starts = [datetime(2026, 1, 1, tzinfo=UTC) + timedelta(hours=i) for i in range(len(tagged))]
    windows = to_windows(recorded, tagged, starts, preload_known=preload_known)
    return [windows[WINDOWS * i : WINDOWS * (i + 1)] for i in range(len(tagged))]


@pytest.fixture(scope="module")
def trials() -> list[Trial]:
    """Eight calibrations of 25 measurements, 40 hidden ones each: an interval must cover over calibrations too."""
    rng = np.random.default_rng(20)
    result = []
    for _ in range(8):
        levels = [
            Condition(x, preload, 0.0, 22.0)
            for x in (0.15, 0.32, 0.5, 0.67, 0.85)
            for preload in (50.0, 100.0, 170.0, 270.0, 400.0)
        ]
        modes = [judge_measurement(w, SETTINGS, None).modal for w in measured(levels, rng, preload_known=True)]
        calibration = calibrate_from_measurements(
            [m for m in modes if isinstance(m, ModalMeasurement)],
            settings=SETTINGS,
            between_sessions=0.0,  # hidden ones are of the same session: repeatability alone, without declared parts
        )
        hidden = [
            Condition(float(rng.uniform(0.17, 0.83)), float(rng.uniform(60.0, 380.0)), 0.0, 22.0) for _ in range(40)
        ]
        estimates = []
        for windows in measured(hidden, rng, preload_known=False):
            answer = judge_measurement(windows, SETTINGS, calibration).preload
            assert isinstance(answer, PreloadEstimate), answer
            estimates.append(answer)
        result.append(Trial(calibration, hidden, estimates))
    return result


def test_intervals_cover_hidden_preloads_as_stated(trials: list[Trial]) -> None:
    covered = [
        estimate.interval.covers(tagged.preload)
        for trial in trials
        for estimate, tagged in zip(trial.estimates, trial.tagged, strict=True)
    ]
    assert 0.92 <= np.mean(covered) <= 0.98


def test_intervals_cover_at_other_temperatures() -> None:
    rng = np.random.default_rng(21)
    tagged = [
        Condition(float(rng.uniform(0.2, 0.8)), float(rng.uniform(60.0, 380.0)), 0.0, float(rng.uniform(20.0, 38.0)))
        for _ in range(80)
    ]
    answers = [
        judge_measurement(windows, SETTINGS, bundled_calibration()).preload
        for windows in measured(tagged, rng, preload_known=False)
    ]
    covered = [
        isinstance(answer, PreloadEstimate) and answer.interval.covers(condition.preload)
        for answer, condition in zip(answers, tagged, strict=True)
    ]
    assert np.mean(covered) >= 0.9  # 80 measurements on one calibration: 95 % less twice the standard error of 2.4 %


def test_preload_does_not_depend_on_the_position() -> None:
    """The spread over positions stays within the spread over repeats, and is what the calibration says it may be.

    Eight places, six repeats each, one preload. The variance of the means over places is that of a mean of repeats
    plus what the calibration's own errors do; F of (7, 40) degrees of freedom exceeds 2.25 with probability 5 %.
    """
    rng, places, repeats = np.random.default_rng(22), np.linspace(0.2, 0.8, 8), 6
    tagged = [Condition(float(x), 250.0, 0.0, 22.0) for x in places for _ in range(repeats)]
    estimates = []
    for windows in measured(tagged, rng, preload_known=False):
        answer = judge_measurement(windows, SETTINGS, bundled_calibration()).preload
        assert isinstance(answer, PreloadEstimate), answer
        estimates.append(answer)
    feature = np.array([e.feature.value for e in estimates]).reshape(places.size, repeats)
    calibration = np.mean([e.feature_systematic_uncertainty**2 for e in estimates])
    within = feature.var(axis=1, ddof=1).mean()
    between = feature.mean(axis=1).var(ddof=1)
    assert between <= within
    assert between <= 2.25 * (within / repeats + calibration)


def test_a_loss_under_payload_is_alarmed() -> None:
    """What the payload correction does not know is a dead zone, but not so wide that a fifth can be lost in it."""
    rng, design = np.random.default_rng(23), charts()
    calibration, state = bundled_calibration(), AxisState()
    for windows, outcome in judged("payload-change")[:20]:
        assert outcome is not None
        state = advance(state, outcome, windows[0].started_at, calibration=calibration, design=design)
    tagged = [Condition(float(x), 240.0, 9.0, 22.0) for x in rng.uniform(0.3, 0.7, 8)]
    for day, windows in enumerate(measured(tagged, rng, preload_known=False), start=1):
        outcome = judge_measurement(windows, SETTINGS, calibration)
        at = windows[0].started_at + timedelta(days=day)
        state = advance(state, outcome, at, calibration=calibration, design=design)
    assert state.detector.status is TrendStatus.ALARM


@pytest.mark.parametrize("session", ["healthy-month", "payload-change", "temperature-drift"])
def test_healthy_axis_stays_silent(session: str) -> None:
    result = watched(session)
    assert result.alarm_after is None
    assert result.refused == 0
    assert result.status in (TrendStatus.NORMAL, TrendStatus.ALERT)


def test_sudden_loss_is_alarmed_at_the_second_measurement() -> None:
    # 300 → 200 N; one measurement alone never alarms
    assert watched("sudden-loss").alarm_after is not None
    lost = next(i for i, p in enumerate(watched("sudden-loss").preloads) if p < 250.0)
    assert watched("sudden-loss").alarm_after - (lost + 1 - 20) == 1
    assert watched("sudden-loss").status is TrendStatus.ALARM


def test_slow_wear_is_alarmed_before_a_tenth_is_lost() -> None:
    result = watched("slow-wear")
    assert result.alarm_after is not None
    healthy = float(np.mean(result.preloads[:20]))
    assert result.preloads[19 + result.alarm_after] > 0.9 * healthy
    assert result.status is TrendStatus.ALARM


def test_bad_windows_are_refused_and_do_not_alarm() -> None:
    result = watched("bad-windows")
    assert result.refused >= 8
    assert result.alarm_after is None
    # what was accepted among the trouble is right: the axis has 300 N throughout
    assert np.all(np.abs(np.array(result.preloads) - 300.0) < 25.0)
