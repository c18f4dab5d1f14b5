"""The rigid-body line below the mode: a line that was put in is found, and none where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from tests.modal.test_measure import windows_of

#: Of the rigid axis, beside a mode of gain 1 [m/(N·m·s²)]
LINE = 2.5


def on_a_rigid_axis(seed: int, line: float = LINE, delay: float = 0.0) -> ModalMeasurement:
    """Measure a mode whose axis also moves as a whole; the acceleration comes later by ``delay`` samples."""
    windows = windows_of(seed, n_windows=12)
    whole = [w.response + line * w.excitation for w in windows]
    whole = [np.interp(np.arange(r.size) - delay, np.arange(r.size), r) for r in whole] if delay else whole
    windows = [replace(w, response=r) for w, r in zip(windows, whole, strict=True)]
    outcome = measure_mode(windows, band=(120.0, 240.0), gate=ModeGate(), maximum_modes=1)
    assert isinstance(outcome, ModalMeasurement), outcome
    return outcome


def test_line_is_found_and_its_uncertainty_covers() -> None:
    found = [on_a_rigid_axis(seed).rigid_line for seed in range(30)]
    scores = [(line.value - LINE) / line.standard_uncertainty for line in found if line is not None]
    assert len(scores) == 30
    assert all(line.standard_uncertainty < 0.005 * LINE for line in found if line is not None)
    # 30 draws: a standard deviation of 1 lies between 0.75 and 1.3 in 99 of 100; leakage makes lines depend on others
    assert 0.5 < np.std(scores) < 1.5
    assert abs(np.mean(scores)) < 0.7


def test_two_per_cent_more_inertia_is_two_per_cent_less_of_the_line() -> None:
    both = [on_a_rigid_axis(3, line).rigid_line for line in (LINE, LINE / 1.02)]
    assert both[0] is not None
    assert both[1] is not None
    assert both[0].value / both[1].value == pytest.approx(1.02, rel=1e-3)


def test_turned_accelerometer_and_a_delay_leave_the_line() -> None:
    turned, late = on_a_rigid_axis(4, -LINE).rigid_line, on_a_rigid_axis(4, LINE, delay=0.5).rigid_line
    assert turned is not None
    assert turned.value == pytest.approx(LINE, rel=0.01)
    assert late is not None
    # half a sample of 2 kHz: the second order of the delay, and what the interpolation takes at 100 Hz, half a percent
    assert late.value == pytest.approx(LINE, rel=0.02)


def test_an_axis_that_cannot_move_as_a_whole_has_no_line() -> None:
    assert on_a_rigid_axis(5, line=0.0).rigid_line is None


def test_a_line_that_drift_of_the_amplifier_hides_is_none() -> None:
    windows = windows_of(6, n_windows=12, noise=0.0)
    rng = np.random.default_rng(6)
    walk = [np.cumsum(rng.standard_normal(w.n_samples)) for w in windows]  # its power lies below the mode
    windows = [
        replace(w, response=w.response + 0.05 * w.excitation + 0.02 * r) for w, r in zip(windows, walk, strict=True)
    ]
    outcome = measure_mode(windows, band=(120.0, 240.0), gate=ModeGate(), maximum_modes=1)
    assert isinstance(outcome, ModalMeasurement)
    assert outcome.rigid_line is None
