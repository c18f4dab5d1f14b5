"""Preload through a calibration from current and scale, against the accelerometer's on the same moves."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import AxisSettings, calibrate_from_measurements, judge_measurement
from monitor_core.preload import PreloadEstimate
from monitor_core.recording import (
    Conditions,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    ResponseQuantity,
    Window,
)
from tests.plant.drive import Drive, Log, delayed, quantised, run

START = datetime(2026, 3, 2, 6, tzinfo=UTC)
SETTINGS = AxisSettings(search_band=(90.0, 220.0))
GRID = [(position, preload) for position in (0.2, 0.4, 0.6) for preload in (80.0, 160.0, 300.0)]
LATER = [(0.25, 100.0), (0.5, 140.0), (0.25, 220.0)]
DRIVE = Drive(damping=5e-5)
#: Of a good accelerometer, 3·10⁻⁴ m/s²/√Hz up to 1 kHz [m/s²].
ACCELEROMETER_NOISE = 1e-2


def recorded(
    log: Log, place: tuple[float, float], *, day: int, step: float | None, kind: ExcitationQuantity, is_set: bool
) -> list[Window]:
    """Return the windows of a log: of the accelerometer, or of a scale of this step that is one sample late."""
    rng = np.random.default_rng(day)
    if step is None:
        response = log.table_acceleration + ACCELEROMETER_NOISE * rng.normal(size=log.table.shape)
    else:
        response = quantised(delayed(log.table, 1.0), step, rng)
    quantity = ResponseQuantity.ACCELERATION if step is None else ResponseQuantity.DISPLACEMENT
    is_current = kind is ExcitationQuantity.CURRENT
    excitation = quantised(log.current, 0.005, rng) if is_current else log.commanded
    source = ExcitationSource.DRIVE if is_current else ExcitationSource.COMMANDED
    conditions = Conditions(place[0], 0.0, None, place[1] if is_set else None)
    return [
        Window(x, y, DRIVE.sample_rate, START + timedelta(days=day, seconds=3 * k), conditions, f"day {day}", kind,
               source, response_quantity=quantity, response_resolution=step)
        for k, (x, y) in enumerate(zip(excitation, response, strict=True))
    ]  # fmt: skip


def logged(kind: ExcitationQuantity, seed: int) -> dict[tuple[float, float], Log]:
    rng = np.random.default_rng(seed)
    how = {"torque": 0.3} if kind is ExcitationQuantity.CURRENT else {"torque": 0.0, "acceleration": 1.0}
    return {
        place: run(DRIVE, *place, n_windows=10, n_samples=2000, rng=rng, disturbance=2.0, **how)
        for place in GRID + LATER
    }


def judged(logs, kind, step) -> list[PreloadEstimate]:
    """Calibrate and judge with one sensor; what another day changes is left out, which would hide the sensor's part."""
    measurements = []
    for day, place in enumerate(GRID):
        windows = recorded(logs[place], place, day=day, step=step, kind=kind, is_set=True)
        modal = judge_measurement(windows, SETTINGS, None).modal
        assert isinstance(modal, ModalMeasurement), modal
        measurements.append(modal)
    calibration = calibrate_from_measurements(measurements, settings=SETTINGS, between_sessions=0.0)
    estimates = []
    for day, place in enumerate(LATER, start=50):
        windows = recorded(logs[place], place, day=day, step=step, kind=kind, is_set=False)
        preload = judge_measurement(windows, SETTINGS, calibration).preload
        assert isinstance(preload, PreloadEstimate), preload
        assert not preload.doubts, preload.doubts
        estimates.append(preload)
    if step is not None:  # a calibration of the scale is none for the accelerometer
        other = recorded(logs[LATER[0]], LATER[0], day=60, step=None, kind=kind, is_set=False)
        refused = judge_measurement(other, SETTINGS, calibration).preload
        assert isinstance(refused, Rejection)
        assert refused.reason is RejectionReason.EXCITATION_SOURCE_MISMATCH
        assert refused.detail == "the calibration holds for a displacement as response; got acceleration"
    return estimates


def require_as_good(kind: ExcitationQuantity, steps: tuple[float, ...], seeds: range) -> None:
    widths: dict[float | None, list[float]] = {step: [] for step in (None, *steps)}
    covered = []
    for seed in seeds:
        logs = logged(kind, seed)
        for step, found in widths.items():
            estimates = judged(logs, kind, step)
            found += [estimate.interval.upper - estimate.interval.lower for estimate in estimates]
            if step is not None:
                covered += [
                    e.interval.lower <= p <= e.interval.upper for e, (_, p) in zip(estimates, LATER, strict=True)
                ]
    for step in steps:
        # 1.3 is what is asked for
        assert np.median(np.array(widths[step]) / np.array(widths[None])) < 1.3
    assert np.mean(covered) >= 0.85


def test_a_scale_reads_a_preload_as_well_as_an_accelerometer_canary() -> None:
    require_as_good(ExcitationQuantity.CURRENT, (1e-7,), range(1))


@pytest.mark.release
@pytest.mark.parametrize("kind", [ExcitationQuantity.CURRENT, ExcitationQuantity.ACCELERATION])
def test_a_scale_reads_a_preload_as_well_as_an_accelerometer(kind) -> None:
    require_as_good(kind, (1e-8, 1e-7, 1e-6), range(10, 14))
