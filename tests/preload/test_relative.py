"""1/f² without a calibration: the law that an axis shows itself, and what a fall may be of the preload."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from monitor_core.axis_state import AxisState, ChartedFeature, advance_feature, charts_see, expected_frequency
from monitor_core.preload import (
    UNSTATED_SHARE,
    ConditionLaw,
    SessionSums,
    learn_law,
    preload_lost,
    preload_lost_interval,
)
from monitor_core.recording import Conditions
from monitor_core.trend import DetectorDesign, DetectorSettings, LossDirection, design_detector
from monitor_core.uncertainty import Estimate, Interval, IntervalKind

START = datetime(2026, 1, 5, tzinfo=UTC)
#: Of the screw of a machine of our own: fixed at one end, 1.4 m, 140 Hz in the middle; no formula of the product.
LENGTH, OF_SCREW, REST = 1.4, 2.2e-5, 4.0e-5


def inverse_square(position: float, payload: float = 0.0) -> float:
    """Return 1/f² of that machine: two ends carry the screw, and what is carried moves with it."""
    return (REST + OF_SCREW * position * (1.0 - position / LENGTH) / LENGTH) * (1.0 + payload / 95.0)


@pytest.mark.parametrize(
    ("share", "of_1", "of_2_1", "of_5"),
    # of a hand calculation: percent lost where the frequency falls by 1, 2.1 and 5 %
    [(0.2, 25, 45, 73), (0.35, 16, 30, 55), (0.5, 11, 22, 44), (0.8, 7, 15, 32)],
)
def test_a_fall_is_as_much_of_the_preload_as_its_share_of_the_compliance_says(
    share: float, of_1: int, of_2_1: int, of_5: int
) -> None:
    for fall, lost in ((0.01, of_1), (0.021, of_2_1), (0.05, of_5)):
        # whole percent of a fall of .1 %: half of a last digit of the fall moves what is lost by .9 % at most
        assert 100.0 * preload_lost((1.0 - fall) ** -2 - 1.0, share) == pytest.approx(lost, abs=1.0)


def test_eq_8_of_the_paper_gives_its_own_preloads_back() -> None:
    k3, rest = 2097e-8, 1.0e-5
    healthy, worn = (rest + k3 * preload ** (-1.0 / 3.0) for preload in (300.0, 120.0))
    share = k3 * 300.0 ** (-1.0 / 3.0) / healthy
    assert preload_lost(worn / healthy - 1.0, share) == pytest.approx(1.0 - 120.0 / 300.0, rel=1e-12)
    between = preload_lost_interval(Interval(0.01, 0.02, IntervalKind.COVERAGE), UNSTATED_SHARE)
    assert between.lower == pytest.approx(preload_lost(0.01, UNSTATED_SHARE.upper))
    assert between.upper == pytest.approx(preload_lost(0.02, UNSTATED_SHARE.lower))


def sessions_of(
    rng: np.random.Generator, places: list[list[float]], *, drift: float = 0.0, day: float = 2e-4, own: float = 5e-5
) -> list[SessionSums]:
    """Return sessions with a place each, or several: 1/f² drifts by ``drift`` of itself over all of them."""
    sessions = []
    for number, of_session in enumerate(places):
        level = 1.0 + drift * number / len(places) + rng.normal(0.0, day)
        sums = SessionSums()
        for position in of_session:
            value = inverse_square(position) * (level + rng.normal(0.0, own))
            sums = sums.with_measurement(value, (own * value) ** 2, Conditions(position))
        sessions.append(sums)
    return sessions


def miss(law: ConditionLaw, position: float, other: float) -> tuple[float, float]:
    """Return by how much a law misses the difference between two places, and its uncertainty of it [s²]."""
    true = inverse_square(position) - inverse_square(other)
    at, there = Conditions(position), Conditions(other)
    a = np.array(law.reference) * 0.0
    a[:2] = position - other, position**2 - other**2
    variance = float(a @ np.reshape(law.covariance, (4, 4)) @ a)
    return law.shift(at) - law.shift(there) - true, variance**0.5


def test_several_places_of_a_session_tell_the_law_though_the_axis_wears_meanwhile() -> None:
    rng = np.random.default_rng(5)
    # outwards, day by day, while 1/f² rises by three percent: between days, wear looks like position
    places = [[0.2 + 0.02 * i, 0.5 + 0.02 * i, 0.8 + 0.02 * i] for i in range(20)]
    off, uncertainty = miss(learn_law(sessions_of(rng, places, drift=0.03)), 0.9, 0.4)
    assert abs(off) < 0.002 * REST
    assert abs(off) < 3.0 * uncertainty


@pytest.mark.parametrize(("draws", "most"), [(40, 7), pytest.param(600, 51, marks=pytest.mark.release)])
@pytest.mark.parametrize("n_places", [1, 3])
def test_uncertainty_of_the_law_covers_whether_places_come_together_or_one_a_day(
    n_places: int, draws: int, most: int
) -> None:
    """Misses are binomial: of 600, .066 for the 16 degrees of freedom of one place a day, 51 in 96 of 100 cases."""
    rng = np.random.default_rng([6, n_places, draws])
    missed = 0
    for _ in range(draws):
        places = [rng.uniform(0.2, 1.2, n_places).tolist() for _ in range(20)]
        off, uncertainty = miss(learn_law(sessions_of(rng, places)), 1.0, 0.4)
        missed += abs(off) > 1.96 * uncertainty
    assert missed <= most
    assert draws < 100 or missed >= 15  # .05 less four standard deviations: not wider than it need be


def test_of_places_that_no_session_has_seen_nothing_is_known() -> None:
    rng = np.random.default_rng(7)
    law = learn_law(sessions_of(rng, [[0.5]] * 20))
    assert law.shift(Conditions(0.5)) == pytest.approx(0.0, abs=1e-12 * REST)
    assert law.uncertainty(Conditions(0.5)) < 1e-6 * REST
    assert law.uncertainty(Conditions(0.9)) > 0.3 * REST


@pytest.fixture(scope="module")
def design() -> DetectorDesign:
    return design_detector(DetectorSettings(loss=LossDirection.RISE))


def fold(
    rng: np.random.Generator, design: DetectorDesign, n_days: int, *, lost_from: int | None = None, n_places: int = 3
) -> AxisState:
    state = AxisState()
    for day in range(n_days):
        level = (1.01 if lost_from is not None and day >= lost_from else 1.0) + rng.normal(0.0, 5e-4)
        for number, position in enumerate(rng.uniform(0.2, 1.2, n_places).tolist()):
            value = inverse_square(position) * (level + rng.normal(0.0, 1e-4))
            charted = ChartedFeature(
                START + timedelta(days=day, minutes=number), Estimate(value, 1e-4 * value), Conditions(position)
            )
            state = advance_feature(state, charted, calibration=None, design=design)
            if state.detector.alarm is not None:
                return state
    return state


@pytest.mark.parametrize("n_places", [1, 3])
def test_a_loss_is_alarmed_at_any_places_and_a_healthy_axis_is_not(design: DetectorDesign, n_places: int) -> None:
    healthy = fold(np.random.default_rng(8), design, 45, n_places=n_places)
    assert (healthy.detector.alarm, healthy.detector.alert) == (None, None)
    worn = fold(np.random.default_rng(8), design, 60, lost_from=40, n_places=n_places)
    assert worn.detector.alarm is not None
    assert START + timedelta(days=40) <= worn.detector.alarm.raised_at <= START + timedelta(days=43)


def test_expected_frequency_is_that_of_the_machine_at_each_place(design: DetectorDesign) -> None:
    state = fold(np.random.default_rng(9), design, 25)
    for position in (0.3, 0.7, 1.1):
        expected = expected_frequency(state, Conditions(position))
        assert expected is not None
        assert abs(expected.value - inverse_square(position) ** -0.5) < 1.96 * expected.standard_uncertainty


def test_a_payload_that_was_never_carried_is_not_compared(design: DetectorDesign) -> None:
    state = fold(np.random.default_rng(10), design, 25)
    assert charts_see(state, Conditions(0.6))
    assert not charts_see(state, Conditions(0.6, 20.0))
