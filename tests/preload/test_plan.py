"""The plan of a calibration obeys the laws of least squares, and agrees with what calibrations turn out to see."""

import itertools
import statistics

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload import (
    ExpectedReadings,
    ModalReading,
    PlannedSetting,
    PreloadFeatureCoefficients,
    Weighting,
    axial_frequency,
    calibrate,
    minimum_detectable_loss,
    plan_calibration,
    smallest_loss,
)
from monitor_core.recording import Conditions

#: Least squares on Table 2 of Nguyen et al. (2018), and its scatter.
K = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
EXPECTED = ExpectedReadings(K, 0.2)
PLACES, PRELOADS = (0.1, 0.3, 0.5, 0.7, 0.9), (100.0, 200.0, 300.0)
GRID = tuple(PlannedSetting(x, force) for x, force in itertools.product(PLACES, PRELOADS))
HEALTHY = 300.0

drawn = st.lists(st.sampled_from(GRID), min_size=0, max_size=30)


def loss(measured) -> float | None:
    return smallest_loss(measured, EXPECTED, PLACES, HEALTHY)


@given(measured=drawn, more=st.sampled_from(GRID))
def test_one_more_setting_is_never_worse(measured, more) -> None:
    before, after = loss(measured), loss([*measured, more])
    assert before is None or (after is not None and after <= before * (1.0 + 1e-9))


@settings(max_examples=40, deadline=None)
@given(measured=drawn)
@pytest.mark.release
def test_the_proposed_setting_beats_the_average_other(measured) -> None:
    plan = plan_calibration(measured, GRID, EXPECTED, healthy_preload=HEALTHY, wished_loss=60.0)
    others = [loss([*measured, item]) for item in GRID if item != plan.proposed]
    if all(other is not None for other in others):
        assert plan.smallest_loss_then is not None
        assert plan.smallest_loss_then <= statistics.mean(others)


def test_from_nothing_the_proposals_soon_suffice_for_a_fit() -> None:
    measured: list[PlannedSetting] = []
    for _ in range(8):
        measured.append(plan_calibration(measured, GRID, EXPECTED, healthy_preload=HEALTHY, wished_loss=60.0).proposed)
    assert loss(measured) is not None
    assert len({item.position for item in measured}) >= 3
    assert {item.preload for item in measured} >= {100.0, 300.0}  # the ends of a range tell its slope


def test_so_many_are_left_as_it_takes_and_then_none() -> None:
    measured: list[PlannedSetting] = []
    left = plan_calibration(measured, GRID, EXPECTED, healthy_preload=HEALTHY, wished_loss=80.0).n_left
    assert left is not None
    assert left > 4
    for remaining in range(left, 0, -1):
        plan = plan_calibration(measured, GRID, EXPECTED, healthy_preload=HEALTHY, wished_loss=80.0)
        assert plan.n_left == remaining
        measured.append(plan.proposed)
    seen = loss(measured)
    assert seen is not None
    assert seen <= 80.0


def test_a_loss_that_the_scatter_hides_is_not_promised() -> None:
    plan = plan_calibration([], GRID, EXPECTED, healthy_preload=HEALTHY, wished_loss=1.0)
    assert plan.n_left is None


def test_many_readings_see_what_a_calibration_of_them_says() -> None:
    rng = np.random.default_rng(7)
    many = [item for item in GRID for _ in range(60)]
    readings = [
        ModalReading(
            float(axial_frequency(item.position, item.preload, K) + rng.normal(0.0, EXPECTED.scatter)),
            Conditions(item.position, None, None, item.preload),
        )
        for item in many
    ]
    fitted = calibrate(readings, weighting=Weighting.NONE, excitation_source=None)
    assert loss(many) == pytest.approx(minimum_detectable_loss(fitted, HEALTHY), rel=0.05)  # s of 900 readings: 2.4 %


def test_what_was_measured_nearby_is_no_hole() -> None:
    plan = plan_calibration([PlannedSetting(0.515, 195.0)], GRID, None, healthy_preload=HEALTHY, wished_loss=30.0)
    assert PlannedSetting(0.5, 200.0) not in plan.holes
    assert len(plan.holes) == len(GRID) - 1 == plan.n_left
    assert plan.smallest_loss is None
    assert plan.smallest_loss_then is None


def test_a_grid_that_could_not_be_fitted_is_refused() -> None:
    with pytest.raises(NotIdentifiableError, match="three positions"):
        plan_calibration([], GRID[:6], EXPECTED, healthy_preload=HEALTHY, wished_loss=30.0)
    with pytest.raises(OutsideValidityError, match="must be positive"):
        plan_calibration([], GRID, EXPECTED, healthy_preload=0.0, wished_loss=30.0)
