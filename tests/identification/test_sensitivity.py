"""Which mode shows the nut, how small a loss, and where to measure next."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.peak_search import Place, find_peaks, peak_grid
from monitor_core.fitting.residuals.peaks import peak_problem
from monitor_core.identification.cases import ResponseCase
from monitor_core.identification.cases.mode_tracks import track_modes
from monitor_core.identification.cases.peaks import planned_peaks
from monitor_core.identification.sensitivity import (
    PeakSensitivity,
    peak_sensitivities,
    rank_modes_to_monitor,
    rank_next_positions,
)
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.models.published.receptance import ReceptanceModel
from tests.identification import tian

#: The joints that Tian's peaks give (weighted, three positions).
IDENTIFIED = replace(
    tian.axis(), bearing_stiffness=4.66e7, far_bearing_stiffness=2.76e7, nut_stiffness=6.75e8, coupling_stiffness=20.7,
    bearing_damping=2630.0, far_bearing_damping=5340.0, nut_damping=100.0, coupling_damping=0.0037,
)  # fmt: skip
JOINTS = tian.free(IDENTIFIED)
AT = JOINTS.start
PLACES = [DriveConditions(x) for x in tian.POSITIONS.values()]
NUT = JOINTS.free.index("nut_stiffness_n_per_m")


@pytest.fixture(scope="module")
def peaks():
    return peak_sensitivities(IDENTIFIED, PLACES, tian.BANDS)


def of_mode(peaks, mode):
    return [peak.of_frequency for peak in peaks if peak.mode == mode]


def test_sensitivity_of_each_order_to_the_nut(peaks):
    # reference values at l1 to l6, found with another implementation by differences of peaks
    np.testing.assert_allclose(of_mode(peaks, 4), [0.083, 0.113, 0.153, 0.195, 0.156, 0.102], atol=0.0015)
    assert all(0.0265 < sensitivity < 0.0305 for sensitivity in of_mode(peaks, 2))
    np.testing.assert_allclose(of_mode(peaks, 1), 0.0, atol=5e-4)


def test_third_order_does_not_see_the_nut_at_mid_screw(peaks):
    undamped = track_modes(IDENTIFIED, PLACES, n_modes=4).nut_sensitivity
    assert undamped[3, 2] == pytest.approx(0.0, abs=5e-4)
    at_node = [peak.of_frequency for peak in peaks if peak.mode == 3 and peak.conditions.position == 1.3]
    assert np.allclose(at_node, 0.0, atol=5e-4)  # also if the peak is lost in the damping
    # peaks and undamped modes tell the same, but for damping
    for mode in (1, 2, 4):
        np.testing.assert_allclose(of_mode(peaks, mode), undamped[:, mode - 1], atol=0.008)


def test_a_tenth_of_the_stiffness_moves_the_fourth_order_by_hertz(peaks):
    softer = replace(IDENTIFIED, nut_stiffness=0.9 * IDENTIFIED.nut_stiffness)
    moved = {}
    for conditions in PLACES:
        grid = peak_grid(IDENTIFIED, [Place(conditions, tian.BANDS[mode]) for mode in (2, 4)])
        before, after = (find_peaks(grid, p.joints(conditions)).frequency for p in (IDENTIFIED, softer))
        moved[conditions.position] = before - after
    assert all(0.3 < shifts[0] < 0.4 for shifts in moved.values())
    assert all(6.0 < shifts[1] < 16.0 for shifts in moved.values())
    predicted = [peak.of_frequency * 0.1 * peak.frequency for peak in peaks if peak.mode == 4]
    np.testing.assert_allclose(predicted, [shifts[1] for shifts in moved.values()], rtol=0.12)


def test_fourth_order_at_mid_screw_is_the_one_to_monitor(peaks):
    ranked = rank_modes_to_monitor(peaks, dict.fromkeys(tian.BANDS, 1e-3))
    assert (ranked[0].peak.mode, ranked[0].peak.conditions.position) == (4, 1.3)
    losses = [monitored.stiffness_loss for monitored in ranked if monitored.stiffness_loss is not None]
    assert losses == sorted(losses)
    blind = [monitored for monitored in ranked if monitored.peak.mode == 1]
    assert all(monitored.preload_loss is None or monitored.preload_loss > 0.9 for monitored in blind)
    # ten times steadier, the second order is the better one
    steady = rank_modes_to_monitor(peaks, {1: 1e-3, 2: 1e-4, 3: 1e-3, 4: 1e-3})
    assert steady[0].peak.mode == 2


def test_smallest_loss_is_seen_as_often_as_stated():
    peak = PeakSensitivity(DriveConditions(1.3), 4, 710.0, 0.2, -0.3)
    (found,) = rank_modes_to_monitor([peak], {4: 2e-3})
    rng = np.random.default_rng(0)
    scatter = 2e-3 * rng.standard_normal(200_000)
    threshold = stats.norm.ppf(0.95) * 2e-3
    falls = -0.2 * np.log1p(-found.stiffness_loss)
    assert np.mean(scatter > threshold) == pytest.approx(0.05, abs=0.002)
    assert np.mean(falls + scatter > threshold) == pytest.approx(0.90, abs=0.003)


def test_preload_goes_with_the_third_power_of_the_stiffness():
    peak = PeakSensitivity(DriveConditions(1.3), 4, 710.0, 0.2, -0.3)
    (found,) = rank_modes_to_monitor([peak], {4: 2e-3})
    assert 1.0 - found.preload_loss == pytest.approx((1.0 - found.stiffness_loss) ** 3, rel=1e-12)
    (blind,) = rank_modes_to_monitor([replace(peak, of_frequency=0.0)], {4: 2e-3})
    assert (blind.stiffness_loss, blind.preload_loss) == (None, None)


# --- where to measure next


def test_next_position_is_the_one_that_brings_most():
    measured = peak_problem(JOINTS, tian.as_labelled(tian.measured("l1", "l3")), bands=tian.BANDS).jacobian(AT)
    places = [DriveConditions(float(x)) for x in np.linspace(0.4, 2.2, 10)]
    candidates = planned_peaks(JOINTS, AT, places, tian.BANDS)
    assert len(candidates) == 10
    ranked = rank_next_positions(measured, candidates, parameter=NUT)
    before = np.sqrt(np.linalg.inv(measured.T @ measured)[NUT, NUT])
    for advised in ranked:
        added = dict(candidates)[advised.conditions]
        covariance = np.linalg.inv(measured.T @ measured + added.T @ added)
        assert advised.standard_uncertainties[NUT] == pytest.approx(np.sqrt(covariance[NUT, NUT]), rel=1e-4)
        assert advised.log_volume == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-6)
        assert advised.standard_uncertainties[NUT] < before
    by_nut = [advised.standard_uncertainties[NUT] for advised in ranked]
    assert by_nut == sorted(by_nut)
    by_volume = [advised.log_volume for advised in rank_next_positions(measured, candidates)]
    assert by_volume == sorted(by_volume)


def test_far_side_of_the_screw_tells_the_bearings_apart():
    # two positions near the fixed bearing leave the split of the bearings open; the far side closes it
    near = [DriveConditions(0.5), DriveConditions(0.6)]
    measured = np.concatenate([j for _, j in planned_peaks(JOINTS, AT, near, tian.BANDS)])
    candidates = planned_peaks(JOINTS, AT, [DriveConditions(x) for x in (0.55, 1.0, 2.1)], tian.BANDS)
    ranked = rank_next_positions(measured, candidates, parameter=0)
    assert ranked[0].conditions.position == 2.1
    assert ranked[-1].conditions.position == 0.55


def test_planned_responses_know_more_than_planned_peaks():
    frequency = np.linspace(10.0, 1000.0, 800)
    response = (
        ReceptanceModel(IDENTIFIED)
        .frequency_response(
            frequency,
            PLACES[0],
            excitation=ExcitationPoint.FORCE_AT_TABLE,
            response=ResponsePoint.DISPLACEMENT_AT_TABLE,
        )
        .response
    )
    measured = FrequencyResponseObservation(PLACES[0], frequency, response, 0.05 * np.abs(response))
    by_peaks = planned_peaks(JOINTS, AT, PLACES[:3], tian.BANDS)
    by_lines = ResponseCase(JOINTS, (measured,)).planned(AT, PLACES[:3])
    known = [np.linalg.inv(np.sum([j.T @ j for _, j in planned], axis=0)) for planned in (by_peaks, by_lines)]
    assert np.all(np.diag(known[1]) < np.diag(known[0]))


def test_what_stays_unseen_is_said():
    blind = np.zeros((3, 3))
    blind[:, 0] = 1.0
    candidates = [(DriveConditions(1.0), np.array([[0.0, 1.0, 0.0]]))]
    (advised,) = rank_next_positions(blind, candidates, parameter=1)
    np.testing.assert_allclose(advised.standard_uncertainties, [1 / np.sqrt(3), 1.0, np.inf])
    assert advised.log_volume == np.inf
    with pytest.raises(NotIdentifiableError, match="no candidate position"):
        rank_next_positions(blind, candidates, parameter=2)
    with pytest.raises(NotIdentifiableError, match="no candidate position"):
        rank_next_positions(blind, candidates)


def test_wrong_questions_are_refused(peaks):
    with pytest.raises(OutsideValidityError, match="joint must be one of"):
        peak_sensitivities(IDENTIFIED, PLACES, tian.BANDS, joint="table_mass")
    with pytest.raises(OutsideValidityError, match="mode 1 needs a positive relative_frequency_uncertainty"):
        rank_modes_to_monitor(peaks, {})
    with pytest.raises(OutsideValidityError, match="must lie between 0 and 1"):
        rank_modes_to_monitor(peaks, dict.fromkeys(tian.BANDS, 1e-3), detection=1.0)
    with pytest.raises(OutsideValidityError, match="needs candidates"):
        rank_next_positions(np.eye(3), [])
    with pytest.raises(OutsideValidityError, match="one of 3 coordinates; got 3"):
        rank_next_positions(np.eye(3), [(DriveConditions(1.0), np.eye(3))], parameter=3)
