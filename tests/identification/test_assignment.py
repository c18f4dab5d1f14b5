"""Peaks find their modes by frequency, position and shape; modes keep their numbers along the screw."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.observations import ModalObservation
from monitor_core.identification.cases.mode_tracks import track_modes
from monitor_core.identification.cases.peaks import assign_modes
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceModel
from monitor_core.models.published.receptance.chain import discretise, undamped_frequencies
from tests.identification import tian
from tests.models.finite_elements import Assembly
from tests.models.test_receptance import axis_of

AXIS = tian.axis()
TABLE = tian.measured(*tian.POSITIONS)
#: Joints as one knows them from catalogues: off by a fifth here and there.
CATALOGUE = replace(
    AXIS, bearing_stiffness=3.5e7, far_bearing_stiffness=3.5e7, nut_stiffness=9e8, coupling_stiffness=25.0
)


def test_third_in_the_list_at_mid_screw_is_the_fourth_mode():
    # Table 1 has three peaks at l4: 24, 116 and 717 Hz
    unlabelled = [replace(observation, order=None) for observation in TABLE]
    for parameters in (AXIS, CATALOGUE):
        found = assign_modes(parameters, unlabelled)
        assert [peak.mode for peak in found.peaks] == [observation.order for observation in TABLE]
        (missing,) = found.missing
        assert (missing.mode, missing.conditions.position, missing.masked) == (3, 1.3, True)
        assert missing.frequency == pytest.approx(590.0, rel=0.01)
        assert missing.sentence.endswith("has no peak at 1300 mm: the table stands at its node")


def test_order_of_the_list_plays_no_part():
    shuffled = [TABLE[k] for k in np.random.default_rng(0).permutation(len(TABLE))]
    found = assign_modes(CATALOGUE, shuffled)
    assert [peak.mode for peak in found.peaks] == [observation.order for observation in shuffled]


def test_a_wrong_label_is_only_a_label():
    mislabelled = [replace(observation, order=5 - observation.order) for observation in TABLE]
    assert [peak.mode for peak in assign_modes(AXIS, mislabelled).peaks] == [observation.order for observation in TABLE]


def test_a_peak_that_should_be_there_is_reported_as_such():
    without = [observation for observation in TABLE if (observation.order, observation.conditions.position) != (4, 0.8)]
    missing = {(peak.mode, peak.conditions.position): peak for peak in assign_modes(AXIS, without).missing}
    assert set(missing) == {(3, 1.3), (4, 0.8)}
    assert not missing[4, 0.8].masked
    assert missing[4, 0.8].sentence.endswith("at 800 mm, where it should be seen")


def test_the_other_positions_decide_where_one_cannot():
    # the nut is softer than the model's, so mode 4 is lower by a tenth everywhere; at 1.1 m a lone peak of it at 641 Hz
    # is nearer to the model's mode 3 (584 Hz) than to its mode 4 (707 Hz)
    places = [DriveConditions(x) for x in (0.6, 0.8, 1.1, 1.6, 1.9)]
    truth = track_modes(replace(AXIS, nut_stiffness=4.2e8), places, n_modes=4).frequency
    lone = ModalObservation(places[2], float(truth[2, 3]))
    others = [ModalObservation(places[k], float(f)) for k in (0, 1, 3, 4) for f in truth[k, 2:]]
    assert assign_modes(AXIS, [lone]).peaks[0].mode == 3
    found = assign_modes(AXIS, [lone, *others])
    assert [peak.mode for peak in found.peaks] == [4, *[3, 4] * 4]
    model = track_modes(AXIS, places, n_modes=4).frequency
    assert found.shift[4] == pytest.approx(np.mean(np.log(truth[:, 3] / model[:, 3])), rel=1e-9)


@pytest.mark.parametrize(
    ("extra", "sentence"),
    [
        (
            300.0,
            "must lie within 25% of a mode of the model; the peak at 300 Hz at 1000 mm is nearest to one at 572 Hz",
        ),
        (580.0, "the peak at 565 Hz at 1000 mm and that at 580 Hz both belong to mode 3"),
    ],
)
def test_lists_that_cannot_be_assigned_are_refused(extra, sentence):
    with pytest.raises(NotIdentifiableError, match=sentence):
        assign_modes(AXIS, [*TABLE, ModalObservation(DriveConditions(1.0), extra)])


EVERYWHERE = (0.6, 0.8, 1.0, 1.3, 1.6, 1.9)


@pytest.mark.parametrize("frame", [300.0, 420.0, 900.0])
def test_a_mode_of_the_frame_is_dropped_everywhere_for_it_stays_where_axial_modes_move(frame):
    places = [DriveConditions(x) for x in EVERYWHERE[: 3 if frame > 400.0 else None]]
    found = assign_modes(AXIS, [*TABLE, *(ModalObservation(place, frame) for place in places)], drop=True)
    assert [(peak.observation.order, peak.mode) for peak in found.peaks] == [(p.order, p.order) for p in TABLE]
    assert [peak.observation.conditions for peak in found.dropped] == places
    for peak in found.dropped:
        assert peak.moved == 0.0
        assert peak.elsewhere is not None
        # what that mode does between the two positions, by the finite elements
        own = [
            Assembly(axis_of(AXIS, MotorEnd.FREE), 60, 96, where.conditions.position).modes(6)[0][peak.mode]
            for where in (peak.observation, peak.elsewhere)
        ]
        assert peak.mode_moves == pytest.approx(frame * (own[0] / own[1] - 1.0), abs=0.1)
        assert abs(peak.mode_moves) > 0.028 * frame
        assert f"it moved by +0 Hz from {peak.elsewhere.conditions.position * 1e3:g} mm, where mode " in peak.sentence


def test_between_two_modes_that_have_their_own_peaks_there_is_none():
    # mode 2 moves by 2 % only: that a peak at 200 Hz stays says nothing
    found = assign_modes(AXIS, [*TABLE, ModalObservation(DriveConditions(1.0), 200.0)], drop=True)
    (dropped,) = found.dropped
    assert (dropped.own_peaks, dropped.moved) == ((2, 3), None)
    assert dropped.sentence.endswith(
        "no other position has a peak near it; next to it is mode 2 near 116 Hz; modes 2 and 3 have their own"
    )


@pytest.mark.parametrize("extra", [24.2, 28.0, 580.0, 640.0, 10.0])
def test_a_peak_that_may_be_a_mode_or_a_reading_of_one_is_refused(extra):
    # a repeated reading; beside a mode that hardly moves; moving as its neighbour; what a wrong joint may do
    with pytest.raises(NotIdentifiableError):
        assign_modes(AXIS, [*TABLE, *(ModalObservation(DriveConditions(x), extra) for x in (0.6, 1.0))], drop=True)


@pytest.mark.parametrize("mode", [7, 8, 9])
def test_an_axial_mode_beyond_those_that_are_followed_is_not_dropped(mode):
    # the finite elements' own, at three positions, where the six that are followed end below
    own = [(x, Assembly(axis_of(AXIS, MotorEnd.FREE), 60, 96, x).modes(mode + 1)[0][mode]) for x in (0.6, 0.8, 1.0)]
    beyond = [ModalObservation(DriveConditions(x), float(frequency)) for x, frequency in own]
    with pytest.raises(NotIdentifiableError, match="must lie within 25% of a mode of the model"):
        assign_modes(AXIS, [*TABLE, *beyond], drop=True)


def test_a_list_of_which_no_peak_is_left_is_refused_with_its_reasons():
    # between modes 4 and 5, each too far away, and both move
    stays = [ModalObservation(DriveConditions(x), 900.0, frequency_uncertainty=0.5) for x in (0.6, 0.8)]
    with pytest.raises(
        NotIdentifiableError, match="no peak is left: the peak at 900 Hz at 600 mm is no axial mode: it"
    ):
        assign_modes(AXIS, stays, drop=True)


def test_an_empty_list_is_refused():
    with pytest.raises(NotIdentifiableError, match="the table has none"):
        assign_modes(AXIS, [])


# --- modes along the screw


def test_modes_are_those_of_the_finite_elements():
    tracks = track_modes(AXIS, [DriveConditions(1.0)], n_modes=4)
    frequency, shapes = Assembly(axis_of(AXIS, MotorEnd.FREE), 60, 96, 1.0).modes(5)
    np.testing.assert_allclose(tracks.frequency[0], frequency[1:], rtol=1e-4)
    model = ReceptanceModel(AXIS).normal_modes(DriveConditions(1.0))
    np.testing.assert_allclose(model.displacement_at_table[1:5] ** 2, shapes[1:, 0] ** 2, rtol=1e-2)


def test_modes_with_the_nut_a_micrometre_from_an_end_are_those_with_it_at_the_end():
    ends = [DriveConditions(position) for position in (1e-6, AXIS.screw_length - 1e-6)]
    tracks = track_modes(AXIS, ends, n_modes=4)
    for frequency, (n_near, n_far, place) in zip(
        tracks.frequency, ((2, 96, 1e-3), (96, 2, AXIS.screw_length - 1e-3)), strict=True
    ):
        of_elements, _ = Assembly(axis_of(AXIS, MotorEnd.FREE), n_near, n_far, place).modes(5)
        np.testing.assert_allclose(np.sort(frequency), of_elements[1:], rtol=2e-3)


def test_sensitivity_to_the_nut_is_the_slope_of_the_frequency():
    conditions = DriveConditions(0.9)
    for parameters in (AXIS, replace(AXIS, bracket_stiffness=5e8)):
        around = [
            np.log(
                undamped_frequencies(
                    discretise(replace(parameters, nut_stiffness=7.09e8 * f), conditions, MotorEnd.FREE)
                )
            )
            for f in (1.001, 0.999)
        ]
        slope = (around[0] - around[1])[:6] / np.log(1.001 / 0.999)
        found = track_modes(parameters, [conditions], n_modes=6).nut_sensitivity[0]
        np.testing.assert_allclose(np.sort(found), np.sort(slope), atol=1e-7)


def test_a_mode_keeps_its_number_where_two_cross():
    # with hardly any lead the torsional modes do not see the table, which the axial ones do: frequencies cross
    straight = replace(AXIS, screw_lead=1e-5, screw_nut_segment_inertia=0.0, table_mass=30.0)
    positions = [DriveConditions(float(x)) for x in np.linspace(0.3, 2.3, 21)]
    tracks = track_modes(straight, positions, n_modes=6)
    still = np.ptp(tracks.frequency, axis=0) < 1e-6 * tracks.frequency[0]
    in_order = np.all(np.diff(tracks.frequency, axis=1) > 0.0, axis=1)
    assert not in_order.all()  # they do cross
    free_torsion = track_modes(replace(straight, table_mass=300.0), positions[:1], n_modes=6).frequency[0]
    for frequency in tracks.frequency[0, still]:
        assert np.min(np.abs(free_torsion / frequency - 1.0)) < 1e-6  # torsional: the table's mass is nothing to them
    assert still.sum() >= 2
    others = tracks.frequency[:, ~still]
    assert np.max(np.abs(np.diff(np.log(others), axis=0))) < 0.12  # no jump from one mode to another


def test_table_share_is_one_where_the_mode_moves_the_table_most():
    positions = [DriveConditions(float(x)) for x in np.linspace(0.26, 2.34, 33)]
    share = track_modes(AXIS, positions, n_modes=4).table_share
    np.testing.assert_allclose(share.max(axis=0), 1.0, atol=0.02)
    assert share[16, 2] < 0.01  # order 3 at mid-screw


def test_preloads_are_followed_each_for_itself():
    nut = replace(AXIS, nut_stiffness=1e9, dynamic_load_rating=5e4)
    two = [DriveConditions(1.0, preload=p) for p in (1000.0, 4000.0)]
    both = track_modes(nut, two, n_modes=4)
    for k, conditions in enumerate(two):
        np.testing.assert_allclose(
            both.frequency[k], track_modes(nut, [conditions], n_modes=4).frequency[0], rtol=1e-12
        )
    assert both.frequency[1, 3] > both.frequency[0, 3] * 1.02


def test_nothing_to_follow_is_refused():
    with pytest.raises(OutsideValidityError, match="got 0 positions and 6 modes"):
        track_modes(AXIS, [])
    with pytest.raises(OutsideValidityError, match="9 modes"):
        track_modes(AXIS, [DriveConditions(1.0)], n_modes=9)
