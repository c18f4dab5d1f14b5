"""Newtons: coverage of the stated interval, position independence, influence quantities, and refusals."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from monitor_core.errors import OutsideValidityError
from monitor_core.preload import (
    Calibration,
    InfluenceCoefficients,
    ModalReading,
    PreloadEstimate,
    PreloadFeatureCoefficients,
    axial_frequency,
    calibrate,
    estimate_preload,
    preload_sensitivity,
    systematic_uncertainty_between,
)
from monitor_core.preload.budget import uncertainty_budget
from monitor_core.preload.feature import from_reference
from monitor_core.recording import Conditions, ExcitationQuantity, ExcitationSource, Rejection, RejectionReason
from monitor_core.uncertainty import Estimate, IntervalKind
from tests.conftest import canary

K = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
INFLUENCE = InfluenceCoefficients(inverse_moving_mass=1.0 / 23.864, temperature=1e-8)
POSITIONS = (0.25, 0.4, 0.5, 0.6, 0.75)
PRELOADS = (50.0, 100.0, 200.0, 300.0)
HIDDEN = [(x, p) for x in (0.31, 0.5, 0.74) for p in (60.0, 150.0, 290.0)]  # neither position nor preload calibrated


def true_frequency(position: float, preload: float, payload: float = 0.0, temperature: float = 20.0) -> float:
    at_reference = axial_frequency(position, preload, K) ** -2.0
    return float(from_reference(at_reference, payload, temperature - 20.0, INFLUENCE)) ** -0.5


def calibration_of(
    rng: np.random.Generator,
    *,
    own: float = 0.05,
    between: float = 0.2,
    positions: tuple[float, ...] = POSITIONS,
    preloads: tuple[float, ...] = PRELOADS,
    influences: tuple[tuple[float | None, float | None], ...] = ((None, None),),
) -> Calibration:
    """Simulate a calibration: own stated uncertainty and scatter between measurements, in hertz."""
    readings = [
        ModalReading(
            true_frequency(x, p, m or 0.0, 20.0 if t is None else t) + rng.normal(0.0, math.hypot(own, between)),
            Conditions(x, m, t, p),
            own,
        )
        for x in positions
        for p in preloads
        for m, t in influences
    ]
    return calibrate(readings, weighting="none", excitation_source=ExcitationSource.SENSOR)


def estimated(
    frequency: float, conditions: Conditions, calibration: Calibration, uncertainty: float = 0.05
) -> PreloadEstimate:
    answer = estimate_preload(Estimate(frequency, uncertainty), conditions, calibration)
    assert isinstance(answer, PreloadEstimate)
    return answer


SMALL = calibration_of(np.random.default_rng(0), own=0.005, between=0.0)
ONE = calibration_of(np.random.default_rng(1))


@pytest.mark.release
@pytest.mark.parametrize(
    ("positions", "preloads", "own", "between"),
    [
        (POSITIONS, PRELOADS, 0.05, 0.2),  # 16 degrees of freedom
        ((0.25, 0.5, 0.75), (50.0, 100.0, 300.0), 0.05, 0.2),  # 5
        ((0.25, 0.5, 0.75), (50.0, 300.0), 0.05, 0.2),  # 2
        (POSITIONS, PRELOADS, 0.3, 0.3),
    ],
)
def test_intervals_cover_19_times_in_20(
    positions: tuple[float, ...], preloads: tuple[float, ...], own: float, between: float
) -> None:
    """600 calibrations, each with one measurement at nine places that were not calibrated."""
    rng = np.random.default_rng(20)
    covered = np.zeros(len(HIDDEN))
    below = above = 0
    n = 600
    for _ in range(n):
        calibration = calibration_of(rng, own=own, between=between, positions=positions, preloads=preloads)
        for i, (x, p) in enumerate(HIDDEN):
            measured = true_frequency(x, p) + rng.normal(0.0, math.hypot(own, between))
            answer = estimate_preload(Estimate(measured, own), Conditions(x), calibration)
            # a refusal (above every preload) is the event of an interval without upper end that starts too high
            interval = answer.interval if isinstance(answer, PreloadEstimate) else None
            covered[i] += interval is not None and interval.covers(p)
            below += interval is not None and interval.upper < p
            above += interval is None or interval.lower > p
    # binomial, 600 trials at each place: 99.99 % of honest 95 % intervals are covered between these counts
    low, high = stats.binom.interval(0.9999, n, 0.95)
    assert np.all((low <= covered) & (covered <= high)), covered / n
    # the misses fall on both sides alike: 2.5 % of 5400 each, correlated within a calibration (hence a third)
    assert below == pytest.approx(0.5 * (below + above), rel=0.35)


@pytest.mark.release
def test_intervals_cover_under_payload_and_temperature() -> None:
    """Both influences fitted, then measured with 4 kg at 26 °C: inside the calibrated range, at no calibrated value.

    Between no payload and the 10 kg calibrated, the logarithm of what a payload does bends by a hundredth of that at
    10 kg (standard deviation, half way), as is declared.
    """
    rng = np.random.default_rng(21)
    influences = ((0.0, 20.0), (0.0, 30.0), (10.0, 20.0))
    n, covered, untagged = 400, 0, 0
    for _ in range(n):
        calibration = calibration_of(rng, influences=influences)
        bend = 0.01 * rng.standard_normal() * 4.0 * 0.4 * 0.6
        most = true_frequency(0.31, 150.0, 10.0, 26.0) / true_frequency(0.31, 150.0, 0.0, 26.0)
        measured = true_frequency(0.31, 150.0, 4.0, 26.0) * most**bend + rng.normal(0.0, math.hypot(0.05, 0.2))
        answer = estimated(measured, Conditions(0.31, 4.0, 26.0), calibration)
        covered += answer.interval.covers(150.0)
        untagged += estimated(measured, Conditions(0.31), calibration).interval.covers(150.0)
    low, high = stats.binom.interval(0.9999, n, 0.95)
    assert low <= covered <= high
    assert untagged == n  # 4 kg untagged are 7.6 % of the frequency: what may lie on the table widens by as much


@given(position=st.floats(0.25, 0.75), preload=st.floats(50.0, 300.0))
def test_preload_does_not_depend_on_position(position: float, preload: float) -> None:
    # scatter of the calibration 0.005 Hz: below 1 N at 300 N (100 N/Hz)
    answer = estimated(true_frequency(position, preload), Conditions(position), SMALL, 0.005)
    assert answer.preload == pytest.approx(preload, abs=1.0)
    assert answer.interval.covers(preload)


def test_interval_is_the_tangent_one_where_uncertainty_is_small() -> None:
    """Fieller's interval meets the delta method: ± t·u(f)·dP/df for a frequency that dominates everything else."""
    answer = estimated(true_frequency(0.5, 150.0), Conditions(0.5), SMALL, 0.05)
    half = 1.96 * 0.05 * preload_sensitivity(true_frequency(0.5, 150.0), 150.0, K)
    # 1 % from the calibration's share of the variance, 2 % from the curvature of P^(−1/3)
    assert 0.5 * (answer.interval.upper - answer.interval.lower) == pytest.approx(half, rel=0.03)


def test_interval_is_wider_upwards() -> None:
    answer = estimated(true_frequency(0.5, 300.0), Conditions(0.5), ONE)
    assert answer.interval.kind is IntervalKind.COVERAGE
    assert answer.interval.upper - answer.preload > 1.1 * (answer.preload - answer.interval.lower)


def test_newtons_widen_with_the_four_thirds_power_of_the_preload() -> None:
    width = {
        p: (i := estimated(true_frequency(0.5, p), Conditions(0.5), SMALL, 0.01).interval).upper - i.lower
        for p in (60.0, 240.0)
    }
    frequencies = true_frequency(0.5, 60.0) / true_frequency(0.5, 240.0)
    # calibration shares differ a little between the two
    assert width[240.0] / width[60.0] == pytest.approx(4 ** (4 / 3) * frequencies**3, rel=0.1)


def test_no_upper_end_where_no_preload_is_too_high() -> None:
    answer = estimated(true_frequency(0.5, 300.0), Conditions(0.5), ONE, uncertainty=5.0)
    assert answer.interval.upper == math.inf
    assert 0.0 < answer.interval.lower < 300.0


def test_a_frequency_of_two_readings_says_little() -> None:
    many, two = (estimate_preload(Estimate(176.0, 0.2, dof), Conditions(0.5), SMALL) for dof in (math.inf, 1.0))
    assert isinstance(many, PreloadEstimate)
    assert isinstance(two, PreloadEstimate)
    assert two.interval.lower < many.interval.lower
    assert two.interval.upper > many.interval.upper


def test_shares_add_up_and_follow_what_is_uncertain() -> None:
    known, unknown = (estimated(178.0, Conditions(0.5), ONE, uncertainty=u).shares for u in (0.0, 2.0))
    for shares in (known, unknown):
        parts = (shares.frequency, shares.reproducibility, shares.calibration, shares.payload, shares.temperature)
        assert sum(parts) == pytest.approx(1.0)
    assert known.frequency == 0.0
    assert unknown.frequency > 0.9


def test_errors_of_the_fitted_model_are_not_taken_for_scatter() -> None:
    frequency = Estimate(178.0, 0.05)
    every_time = estimate_preload(frequency, Conditions(0.5), ONE, random_uncertainty=0.01)
    unknown = estimate_preload(frequency, Conditions(0.5), ONE)
    assert isinstance(every_time, PreloadEstimate)
    assert isinstance(unknown, PreloadEstimate)
    assert every_time.feature_own_uncertainty == pytest.approx(0.2 * unknown.feature_own_uncertainty)
    assert every_time.interval == unknown.interval  # the preload may be wrong by them all the same


def test_random_and_systematic_parts_make_the_whole() -> None:
    answer = estimated(178.0, Conditions(0.5), ONE)
    # 2/f³ per hertz, of the stated uncertainty and of the scatter between measurements
    assert answer.feature_own_uncertainty == pytest.approx(2.0 * 0.05 / 178.0**3)
    random = 2.0 * math.hypot(0.05, ONE.reproducibility) / 178.0**3
    assert answer.feature.standard_uncertainty == pytest.approx(
        math.hypot(random, answer.feature_systematic_uncertainty)
    )


def test_declared_moving_mass_corrects_a_payload_and_widens() -> None:
    readings = [ModalReading(true_frequency(x, p), Conditions(x, preload=p), 0.01) for x in POSITIONS for p in PRELOADS]
    calibration = calibrate(
        readings, weighting="none", excitation_source=ExcitationSource.SENSOR, moving_mass=Estimate(23.864, 1.0)
    )
    loaded = estimated(true_frequency(0.5, 150.0, 2.0), Conditions(0.5, 2.0), calibration)
    empty = estimated(true_frequency(0.5, 150.0), Conditions(0.5), calibration)
    assert loaded.preload == pytest.approx(150.0, rel=1e-6)
    assert loaded.shares.payload > 0.5
    assert loaded.interval.upper > empty.interval.upper
    # 1 kg in 23.9 of moving mass is 1 kg·2 kg/(25.9 kg·23.9 kg) of 1/f² = 0.32 %, half of it in frequency
    of_feature = 2.0 / (23.864 + 2.0) / 23.864 / axial_frequency(0.5, 150.0, K) ** 2
    assert systematic_uncertainty_between(
        loaded.feature.value, Conditions(0.5, 2.0), [Conditions(0.5)], calibration
    ) == pytest.approx(of_feature, rel=1e-6)


def test_a_payload_that_was_stated_once_and_is_not_now_is_covered_up_to_a_twentieth_of_what_moves() -> None:
    rng = np.random.default_rng(35)
    empty = calibration_of(rng, own=0.005, between=0.02, influences=((0.0, None),))
    never = calibration_of(rng, own=0.005, between=0.02)
    covered, narrower = [], []
    for payload in rng.uniform(0.0, 0.05 * 23.864, 300):
        measured = true_frequency(0.5, 150.0, payload) + rng.normal(0.0, 0.02)
        answer = estimated(measured, Conditions(0.5), empty)
        covered.append(answer.interval.covers(150.0))
        assert [better.quantities for better in answer.if_stated] == [("payload",)]
        narrower.append(answer.if_stated[0].interval.upper)
    # uniform: at most √3 of its standard uncertainty off
    assert np.mean(covered) >= stats.binom.ppf(0.001, 300, 0.95) / 300
    stated = estimated(true_frequency(0.5, 150.0), Conditions(0.5, 0.0), empty)
    assert stated.if_stated == ()
    assert min(narrower) < stated.interval.upper * 1.05
    # nobody ever stated one: what it does is in the scatter of the readings
    assert estimated(true_frequency(0.5, 150.0), Conditions(0.5), never).shares.payload == 0.0


def test_nothing_systematic_between_equal_conditions() -> None:
    # a feature of 300 N is 3e-6 s²; what is left is the rounding of a mean
    assert systematic_uncertainty_between(4e-6, Conditions(0.4), [Conditions(0.4)] * 3, ONE) < 1e-18


def test_systematic_uncertainty_between_positions_is_the_scatter_over_calibrations() -> None:
    """300 calibrations read one true frequency at each of two positions: only their errors differ."""
    rng = np.random.default_rng(22)
    differences, stated = [], []
    for _ in range(300):
        calibration = calibration_of(rng)
        there, here = (estimated(true_frequency(x, 150.0), Conditions(x), calibration) for x in (0.3, 0.5))
        differences.append(there.feature.value - here.feature.value)
        stated.append(
            systematic_uncertainty_between(here.feature.value, Conditions(0.3), [Conditions(0.5)], calibration)
        )
        assert stated[-1] < there.feature_systematic_uncertainty + here.feature_systematic_uncertainty
    # a standard deviation of 300 is known to 4 %
    assert np.std(differences) == pytest.approx(np.sqrt(np.mean(np.square(stated))), rel=0.16)


@pytest.mark.release
@pytest.mark.parametrize("preload", canary([30.0, 300.0]))
def test_budget_of_the_calibration_is_the_scatter_over_calibrations(preload: float) -> None:
    """400 calibrations read one true frequency: θ = preload^(−1/3) scatters as their joint covariance says."""
    rng = np.random.default_rng(25)
    frequency = Estimate(true_frequency(0.5, preload), 0.0)
    theta, stated = [], []
    for _ in range(400):
        calibration = calibration_of(rng)
        feature = estimated(frequency.value, Conditions(0.5), calibration, 0.0).feature.value
        budget = uncertainty_budget(frequency, feature, Conditions(0.5), calibration)
        theta.append(feature / calibration.coefficients.k3)
        stated.append(sum(budget.parameters.values()) / calibration.coefficients.k3**2)
    # a standard deviation of 400 is known to 3.5 %
    assert np.std(theta) == pytest.approx(np.sqrt(np.mean(stated)), rel=0.14)


@pytest.mark.parametrize(
    ("source", "quantity"), [(ExcitationSource.DRIVE, None), (ExcitationSource.SENSOR, ExcitationQuantity.FORCE)]
)
def test_another_excitation_is_refused(source: ExcitationSource, quantity: ExcitationQuantity | None) -> None:
    """The drive's torque sees another pole than a sensor's, some 7 Hz off: more than all preload together."""
    calibration = replace(ONE, excitation_quantity=ExcitationQuantity.TORQUE)
    answer = estimate_preload(
        Estimate(178.0, 0.1), Conditions(0.5), calibration, excitation_source=source, excitation_quantity=quantity
    )
    assert isinstance(answer, Rejection)
    assert answer.reason is RejectionReason.EXCITATION_SOURCE_MISMATCH


def test_a_calibration_that_hides_its_source_serves_no_stated_one() -> None:
    calibration = replace(ONE, excitation_source=None)
    answer = estimate_preload(
        Estimate(178.0, 0.1), Conditions(0.5), calibration, excitation_source=ExcitationSource.SENSOR
    )
    assert isinstance(answer, Rejection)


def test_a_frequency_above_every_preload_is_refused() -> None:
    answer = estimate_preload(Estimate(195.0, 0.1), Conditions(0.5), ONE)  # no preload, however high, gives 189 Hz
    assert isinstance(answer, Rejection)
    assert answer.reason is RejectionReason.OUTSIDE_CALIBRATION
    assert "195.00 Hz" in answer.detail


def test_a_payload_that_cannot_be_corrected_is_refused() -> None:
    answer = estimate_preload(Estimate(176.0, 0.1), Conditions(0.5, payload_mass=1.0), ONE)
    assert isinstance(answer, Rejection)
    assert "moving mass" in answer.detail


def test_a_frequency_that_is_none_is_a_broken_contract() -> None:
    with pytest.raises(OutsideValidityError, match="frequency must be positive"):
        estimate_preload(Estimate(0.0, 0.1), Conditions(0.5), ONE)


@pytest.mark.parametrize(
    ("position", "preload", "outside"),
    [
        (0.5, 150.0, ()),
        (0.2501, 150.0, ()),
        (0.2499, 150.0, ()),  # an encoder's repeatability is no extrapolation
        (0.20, 150.0, ("position",)),
        (0.5, 400.0, ("preload",)),
        (0.9, 20.0, ("position", "preload")),
    ],
)
def test_extrapolation_says_in_what(position: float, preload: float, outside: tuple[str, ...]) -> None:
    answer = estimated(true_frequency(position, preload), Conditions(position), SMALL)
    assert answer.outside == outside
    assert answer.extrapolated is bool(outside)


@given(preload=st.floats(20.0, 450.0), uncertainty=st.floats(0.02, 2.0))
def test_a_preload_is_outside_only_if_the_calibration_has_seen_none_of_its_interval(
    preload: float, uncertainty: float
) -> None:
    """A reading of 300.4 N ± 5 N was outside of a calibration up to 300 N."""
    answer = estimate_preload(Estimate(true_frequency(0.5, preload), uncertainty), Conditions(0.5), SMALL)
    assert isinstance(answer, PreloadEstimate)
    overlap = min(answer.interval.upper, PRELOADS[-1]) - max(answer.interval.lower, PRELOADS[0])
    assert answer.outside == (("preload",) if overlap < 0.0 else ())


def test_temperature_outside_the_calibrated_range_is_said() -> None:
    calibration = calibration_of(np.random.default_rng(23), influences=((0.0, 20.0), (0.0, 30.0), (10.0, 20.0)))
    conditions = Conditions(0.5, 15.0, 45.0)
    answer = estimated(true_frequency(0.5, 150.0, 15.0, 45.0), conditions, calibration)
    assert answer.outside == ("payload", "temperature")


def test_what_is_not_stated_is_named() -> None:
    calibration = calibration_of(np.random.default_rng(24), influences=((0.0, 20.0), (0.0, 30.0), (10.0, 20.0)))
    assumptions = " | ".join(estimated(178.0, Conditions(0.5), calibration).assumptions)
    assert "taken as the calibration's sensor" in assumptions
    assert "0 kg" in assumptions
    assert "23.3 °C" in assumptions
