"""What windows hold besides the frequency: regressions of known coefficients, and the friction that they correct."""

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial

import numpy as np
import pytest
from scipy import stats

from monitor_core.preload import Calibration, ModalReading, PreloadEstimate, calibrate, estimate_preload
from monitor_core.preload.budget import TEMPERATURE_LAG, THERMOMETER
from monitor_core.preload.doubts import (
    FALSE_DOUBTS,
    TEST_LEVEL,
    TOLERANCES,
    PlaceReading,
    causes_of_residue,
    of_whole_session,
    places_disagree,
)
from monitor_core.preload.feature import USUAL_FRICTION_SHARE, PreloadFeatureCoefficients, axial_frequency
from monitor_core.preload.witnesses import Setting, Witness, WitnessName, fit_witness
from monitor_core.recording import Conditions, DoubtReason, ExcitationQuantity, Rejection, RejectionReason
from monitor_core.uncertainty import Estimate

#: Regressed on Table 2 of Nguyen et al. (2018).
K = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
POSITIONS = (0.15, 0.3, 0.45, 0.6, 0.75)
PRELOADS = (100.0, 170.0, 250.0, 400.0)
MASS = 24.0  # [kg]
FRICTION = -1.5e-6  # what a newton metre of friction beyond the usual adds to 1/f² [s²/(N·m)]


def usual_friction(preload: float) -> float:
    """Return the friction torque of the made axis [N·m]."""
    return 0.06 * (preload / 300.0) ** 0.5


def residue(position: float, payload: float) -> float:
    """Return the residue of the made axis [m/(N·m·s²)]."""
    return 20.0 * (1.0 + 0.05 * position) / (1.0 + payload / MASS)


def rigid_line(payload: float) -> float:
    """Return the rigid-body line of the made axis, of whose inertia the table is 30 % [m/(N·m·s²)]."""
    return 4.7 / (1.0 + 0.3 * payload / MASS)


def reading(
    position: float,
    preload: float,
    rng: np.random.Generator,
    *,
    payload: float = 0.0,
    friction: float = 1.0,
    heavier: float = 0.0,
    damping: float = 0.012,
    noise: float = 0.003,
    unexplained: float = 1.0,
    mounted: float = 1.0,
    gain: float = 1.0,
    line: bool = False,
) -> ModalReading:
    """Make a reading whose friction is ``friction`` times the usual and whose table is ``heavier`` than stated [kg].

    The residue is ``mounted`` and ``gain`` times as large, the rigid-body line, where it is seen, ``gain`` times.

    Noise that no torque explains belongs to friction on the table: ``unexplained`` beyond that of ``friction``.
    """
    torque = usual_friction(preload) * friction * math.exp(noise * rng.standard_normal())
    plain = axial_frequency(position, preload, K) ** -2.0 + FRICTION * (torque - usual_friction(preload))
    inverse_square = float(plain) * (1.0 + (payload + heavier) / MASS)
    own = rng.spawn(1)[0]  # so that the other numbers are the same with and without it
    seen = {WitnessName.RIGID_LINE: gain * rigid_line(payload + heavier) * math.exp(0.001 * own.standard_normal())}
    return ModalReading(
        inverse_square**-0.5 + 0.005 * rng.standard_normal(),
        Conditions(position, payload_mass=payload, preload=preload),
        0.005,
        witnesses={
            WitnessName.DAMPING_RATIO: damping * math.exp(noise * rng.standard_normal()),
            WitnessName.RESIDUE: mounted
            * gain
            * residue(position, payload + heavier)
            * math.exp(noise * rng.standard_normal()),
            WitnessName.EXCITATION_LEVEL: 0.02 * math.exp(0.05 * rng.standard_normal()),
            WitnessName.FRICTION_TORQUE: torque,
            WitnessName.NOISE_LEVEL: 0.02 * friction * unexplained * math.exp(0.08 * rng.standard_normal()),
        }
        | (seen if line else {}),
    )


def calibrated(
    rng: np.random.Generator, *, spread: float = 0.05, between_sessions: float = 3e-4, line: bool = False
) -> Calibration:
    """Calibrate on readings whose friction varies by ``spread``."""
    readings = [
        reading(x, p, rng, friction=math.exp(spread * rng.standard_normal()), line=line)
        for x in POSITIONS
        for p in PRELOADS
    ]
    readings += [reading(x, 300.0, rng, payload=m, line=line) for x in POSITIONS[::2] for m in (6.0, 10.0)]
    return calibrate(readings, weighting="none", excitation_source=None, between_sessions=between_sessions)


def judged(calibration: Calibration, made: ModalReading, **changes: float | None) -> PreloadEstimate | Rejection:
    """Estimate the preload of a reading that does not state it."""
    return estimate_preload(
        made.estimate, replace(made.conditions, preload=None, **changes), calibration, witnesses=made.witnesses
    )


def test_regression_gives_known_coefficients_and_textbook_prediction_back() -> None:
    rng = np.random.default_rng(1)
    settings = [Setting(x, p) for x in POSITIONS for p in PRELOADS]
    values = [
        math.exp(0.3 + 0.8 * s.position - 0.4 * math.log(s.preload) + 0.01 * rng.standard_normal()) for s in settings
    ]
    witness = fit_witness(WitnessName.RESIDUE, values, settings)
    assert witness is not None
    assert witness.terms == ("constant", "position", "preload", "position_squared", "preload_squared")
    # ordinary least squares by another route: the normal equations
    x = np.array([[1, s.position, math.log(s.preload), s.position**2, math.log(s.preload) ** 2] for s in settings])
    beta = np.linalg.solve(x.T @ x, x.T @ np.log(values))
    row = np.array([1, 0.5, math.log(200.0), 0.25, math.log(200.0) ** 2])
    assert math.log(witness.expected(Setting(0.5, 200.0))) == pytest.approx(float(row @ beta), abs=1e-9)
    residual = np.log(values) - x @ beta
    s2 = float(residual @ residual) / (len(values) - 5)
    of_prediction = math.sqrt(s2 * (1.0 + float(row @ np.linalg.solve(x.T @ x, row))))
    deviation = witness.deviation(witness.expected(Setting(0.5, 200.0)) * 1.02, Setting(0.5, 200.0))
    assert deviation.standard_uncertainty == pytest.approx(of_prediction, rel=1e-6)
    assert deviation.logarithm == pytest.approx(math.log(1.02))
    p = 2.0 * stats.t.sf(abs(deviation.logarithm) / of_prediction, 15)
    assert deviation.score == pytest.approx(stats.norm.isf(p / 2.0), rel=1e-6)


def test_uncertainty_between_settings_is_the_scatter_of_that_difference_over_calibrations() -> None:
    """At 1.96 of it, 95 % of calibrations with the same scatter are no farther off between place, payload and those."""
    rng = np.random.default_rng(11)
    settings = [Setting(x, 300.0, factor) for x in (0.2, 0.4, 0.6) for factor in (1.0, 1.2)] * 2
    baseline, here = [Setting(0.5, 300.0), Setting(0.5, 300.0)], Setting(0.25, 300.0, 1.15)
    covered = 0
    for _ in range(400):
        ln = [-1.0 * math.log(of.payload_factor) + 0.02 * rng.normal() for of in settings]
        witness = fit_witness(WitnessName.RESIDUE, np.exp(ln).tolist(), settings)
        assert witness is not None
        wrong = math.log(witness.expected(here) / witness.expected(baseline[0])) + math.log(1.15)
        covered += abs(wrong) < 1.96 * witness.uncertainty_between(here, baseline)
    assert witness.uncertainty_between(baseline[0], baseline) == 0.0
    assert 0.92 < covered / 400 < 0.98


def test_slope_in_theta_is_the_derivative() -> None:
    witness = calibrated(np.random.default_rng(2)).witness(WitnessName.FRICTION_TORQUE)
    assert isinstance(witness, Witness)
    theta, step = 300.0 ** (-1.0 / 3.0), 1e-6
    at = [witness.expected(Setting(0.4, t**-3.0)) for t in (theta - step, theta + step)]
    assert witness.slope_in_theta(Setting(0.4, 300.0)) == pytest.approx((at[1] - at[0]) / (2.0 * step), rel=1e-5)


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_readings_teach_nothing(count: int) -> None:
    settings = [Setting(0.1 * i, 300.0) for i in range(count)]
    assert fit_witness(WitnessName.RESIDUE, [1.0] * count, settings) is None


def test_values_that_no_logarithm_has_teach_nothing() -> None:
    settings = [Setting(0.1 * i, 300.0) for i in range(20)]
    assert fit_witness(WitnessName.RESIDUE, [1.0] * 19 + [0.0], settings) is None


def test_coefficient_of_friction_is_found_where_friction_varies() -> None:
    found = [calibrated(np.random.default_rng(seed), spread=0.15).friction for seed in range(20)]
    scores = [(k.value - FRICTION) / k.standard_uncertainty for k in found if k is not None]
    assert len(scores) == 20
    assert np.std(scores) < 1.6
    assert abs(np.mean(scores)) < 0.7
    assert np.mean([k.standard_uncertainty for k in found if k is not None]) < 0.3 * abs(FRICTION)


def test_coefficient_of_friction_is_the_declared_one_where_it_never_varies() -> None:
    readings = [reading(x, p, np.random.default_rng(3), noise=0.0) for x in POSITIONS for p in PRELOADS]
    calibration = calibrate(readings, weighting="none", excitation_source=None)
    mean = np.mean([r.frequency**-2.0 for r in readings]) / np.mean([usual_friction(p) for p in PRELOADS])
    assert calibration.friction is not None
    assert calibration.friction.value == pytest.approx(-USUAL_FRICTION_SHARE * mean, rel=1e-3)
    assert calibration.friction.standard_uncertainty == pytest.approx(USUAL_FRICTION_SHARE * mean, rel=1e-3)


def test_a_few_readings_without_friction_leave_it_to_the_others() -> None:
    rng = np.random.default_rng(8)
    made = [reading(x, p, rng, friction=math.exp(0.15 * rng.standard_normal())) for x in POSITIONS for p in PRELOADS]
    untold = {k: v for k, v in made[7].witnesses.items() if k is not WitnessName.FRICTION_TORQUE}
    lacking = [*made[:7], replace(made[7], witnesses=untold), *made[8:]]
    fit = partial(calibrate, weighting="none", excitation_source=None, between_sessions=3e-4)
    few, whole, without = fit(lacking), fit(made), fit([*made[:7], *made[8:]])
    name = WitnessName.FRICTION_TORQUE
    told, alone = few.witness(name), without.witness(name)
    assert told is not None
    assert alone is not None
    # what is usual rests on the others, as if the reading were not there
    assert np.array_equal(told.coefficients.values, alone.coefficients.values)
    assert few.friction is not None
    assert whole.friction is not None
    assert abs(few.friction.value - FRICTION) < 3.0 * few.friction.standard_uncertainty
    assert few.friction.standard_uncertainty < 1.3 * whole.friction.standard_uncertainty
    assert few.n_readings == whole.n_readings
    most = [replace(r, witnesses=untold) for r in made[:10]] + made[10:]
    assert fit(most).witness(name) is None  # half of them may be of one place
    assert fit(most).friction is None


def without_noise(made: ModalReading) -> ModalReading:
    """Return a reading that no noise level is known of, as of an older calibration."""
    return replace(made, witnesses={k: v for k, v in made.witnesses.items() if k is not WitnessName.NOISE_LEVEL})


@pytest.mark.parametrize("friction", [0.6, 1.4])
def test_friction_no_longer_looks_like_preload(friction: float) -> None:
    rng = np.random.default_rng(4)
    calibration = calibrated(rng, spread=0.15)
    made = [without_noise(reading(0.4, 300.0, rng, friction=friction)) for _ in range(20)]
    corrected = [judged(calibration, r) for r in made]
    plain = [
        judged(calibration, replace(r, witnesses={k: v for k, v in r.witnesses.items() if "friction" not in k}))
        for r in made
    ]
    error, without = (
        np.mean([abs(a.preload - 300.0) for a in answers if isinstance(a, PreloadEstimate)])
        for answers in (corrected, plain)
    )
    assert error < 0.5 * without
    assert all(isinstance(a, PreloadEstimate) and a.interval.covers(300.0) for a in corrected)
    assert all(isinstance(a, PreloadEstimate) and a.shares.friction > 0.1 for a in corrected)


def test_noise_that_grows_with_the_friction_torque_narrows_and_noise_that_does_not_widens() -> None:
    rng = np.random.default_rng(12)
    calibration = calibrated(rng, spread=0.15)
    variance = {}
    for name, friction, unexplained in (("everywhere", 1.4, 1.0), ("in the guides", 1.2, 1.6)):
        made = [reading(0.4, 300.0, rng, friction=friction, unexplained=unexplained) for _ in range(20)]
        for kind, readings in (("both", made), ("torque alone", [without_noise(r) for r in made])):
            answers = [judged(calibration, r) for r in readings]
            variance[name, kind] = np.mean(
                [
                    a.shares.friction * a.feature.standard_uncertainty**2
                    for a in answers
                    if isinstance(a, PreloadEstimate)
                ]
            )
    assert variance["everywhere", "both"] < 0.8 * variance["everywhere", "torque alone"]
    assert variance["in the guides", "both"] > 4.0 * variance["in the guides", "torque alone"]


def test_friction_of_the_guides_alone_is_covered_and_named() -> None:
    # It stiffens three times as much for its torque as the friction that a calibration has seen.
    rng = np.random.default_rng(13)
    calibration = calibrated(rng, spread=0.15)
    covered, said = [], []
    for _ in range(40):
        made = reading(0.4, 300.0, rng, friction=1.2, unexplained=2.2 / 1.2)
        stiffer = made.frequency**-2.0 + 2.0 * FRICTION * 0.2 * usual_friction(300.0)
        answer = judged(calibration, replace(made, frequency=stiffer**-0.5))
        assert isinstance(answer, PreloadEstimate)
        covered.append(answer.interval.covers(300.0))
        said.append(DoubtReason.NOISE_CHANGED in [doubt.reason for doubt in answer.doubts])
    assert np.mean(covered) > 0.9
    assert np.mean(said) > 0.6


def test_preload_above_all_that_were_set_is_in_doubt_unless_it_was_set() -> None:
    rng = np.random.default_rng(14)
    calibration = calibrated(rng)
    risen, set_so = reading(0.4, 620.0, rng), reading(0.4, 620.0, rng)
    answer = judged(calibration, risen)
    assert isinstance(answer, PreloadEstimate)
    (doubt,) = [doubt for doubt in answer.doubts if doubt.reason is DoubtReason.PRELOAD_RISEN]
    assert "above the 400 N" in doubt.detail
    stated = estimate_preload(set_so.estimate, set_so.conditions, calibration, witnesses=set_so.witnesses)
    assert isinstance(stated, PreloadEstimate)
    assert DoubtReason.PRELOAD_RISEN not in [doubt.reason for doubt in stated.doubts]


def test_place_far_off_the_calibrated_travel_is_refused_whatever_the_windows_hold() -> None:
    # a tag in another unit: what noise and friction are usual there is beyond any number
    rng = np.random.default_rng(1)
    calibration, made = calibrated(rng), reading(0.4, 300.0, rng)
    answers = {x: judged(calibration, made, position=x) for x in (1.7, 2.0, 50.0, 550.0, 1e5, -0.8, -1.0, -550.0)}
    refused = {x for x, answer in answers.items() if isinstance(answer, Rejection)}
    assert refused == set(answers) - {1.7, -0.8}
    assert "150 to 750 mm from the fixed bearing; got 550000 mm" in str(answers[550.0])


def test_highest_calibrated_preload_is_hardly_ever_a_rise() -> None:
    rng = np.random.default_rng(15)
    risen = [
        DoubtReason.PRELOAD_RISEN in [doubt.reason for doubt in answer.doubts]
        for _ in range(10)
        for calibration in (calibrated(rng),)
        for answer in (judged(calibration, reading(0.4, 400.0, rng)) for _ in range(40))
        if isinstance(answer, PreloadEstimate)
    ]
    assert len(risen) > 350
    assert np.mean(risen) < 0.01


def test_healthy_readings_are_doubted_no_more_often_than_is_stated() -> None:
    # anywhere within what was calibrated, by few readings each time
    rng = np.random.default_rng(5)
    doubted = [
        not isinstance(answer, PreloadEstimate) or bool(answer.doubts)
        for _ in range(20)
        for calibration in (calibrated(rng, line=True),)
        for _ in range(40)
        for answer in (
            judged(
                calibration,
                reading(rng.uniform(0.15, 0.75), 300.0, rng, payload=rng.uniform(0.0, 10.0), line=True),
            ),
        )
    ]
    assert np.mean(doubted) < FALSE_DOUBTS


Made = Callable[[np.random.Generator], ModalReading]


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda rng: reading(0.4, 300.0, rng, heavier=0.5), DoubtReason.MASS_OR_MOUNTING_CHANGED),
        (lambda rng: reading(0.4, 300.0, rng, heavier=3.0), RejectionReason.MOVED_MASS_MISMATCH),
        (lambda rng: reading(0.4, 300.0, rng, damping=0.0135), DoubtReason.DAMPING_CHANGED),
        (lambda rng: reading(0.4, 300.0, rng, damping=0.024), RejectionReason.DAMPING_MISMATCH),
        (lambda rng: reading(0.4, 300.0, rng, damping=0.004), RejectionReason.DAMPING_MISMATCH),
        (lambda rng: reading(0.4, 300.0, rng, friction=1.9), DoubtReason.FRICTION_CHANGED),
    ],
    ids=["0.5 kg", "3 kg", "damping + 12 %", "damping doubled", "damping a third", "friction × 1.9"],
)
def test_what_has_changed_is_said(made: Made, said: DoubtReason | RejectionReason) -> None:
    rng = np.random.default_rng(6)
    answer = judged(calibrated(rng), made(rng))
    if isinstance(answer, Rejection):
        assert answer.reason is said
    else:
        assert said in [doubt.reason for doubt in answer.doubts]


@pytest.mark.parametrize(
    ("changed", "reason", "words"),
    [
        ({"heavier": 1.0}, DoubtReason.MOVED_MASS_CHANGED, "it is the moved mass: more than is stated"),
        (
            {"mounted": 1.05},
            DoubtReason.MASS_OR_MOUNTING_CHANGED,
            "it looks like the mounting, or what hides in the mode, not like the moved mass",
        ),
        ({"gain": 1.03}, DoubtReason.GAIN_CHANGED, "it looks like the gain of "),
    ],
    ids=["heavier", "mounting", "gain"],
)
def test_rigid_line_tells_what_has_moved_the_residue(
    changed: dict[str, float], reason: DoubtReason, words: str
) -> None:
    rng = np.random.default_rng(16)
    calibration = calibrated(rng, line=True)
    answers = [judged(calibration, reading(0.4, 300.0, rng, line=True, **changed)) for _ in range(20)]
    doubts = [doubt for a in answers if isinstance(a, PreloadEstimate) for doubt in a.doubts if doubt.reason is reason]
    assert sum(words in doubt.detail for doubt in doubts) >= 18


@pytest.mark.parametrize("payloads", [True, False])
def test_gain_of_the_torque_is_doubted_where_another_mass_is_refused(payloads: bool) -> None:
    # twelve percent less torque: every response by so much more, level and friction by so much less
    rng = np.random.default_rng(21)
    readings = [reading(x, p, rng, line=True) for x in POSITIONS for p in PRELOADS]
    readings += [reading(x, 300.0, rng, payload=m, line=True) for x in POSITIONS[::2] for m in (6.0, 10.0) if payloads]
    calibration = calibrate(
        readings, weighting="none", excitation_source=None, excitation_quantity=ExcitationQuantity.TORQUE
    )
    made = reading(0.4, 300.0, rng, line=True)
    factor = {
        WitnessName.RESIDUE: 1.0 / 0.88, WitnessName.RIGID_LINE: 1.0 / 0.88,
        WitnessName.EXCITATION_LEVEL: 0.88, WitnessName.FRICTION_TORQUE: 0.88,
    }  # fmt: skip
    weak = {name: value * factor.get(name, 1.0) for name, value in made.witnesses.items()}
    answer = judged(calibration, replace(made, witnesses=weak))
    assert isinstance(answer, PreloadEstimate)
    (doubt,) = answer.doubts
    assert doubt.reason is DoubtReason.GAIN_CHANGED
    assert "looks like the gain of the torque" in doubt.detail
    weaker = {**weak, WitnessName.RESIDUE: 1e3 * made.witnesses[WitnessName.RESIDUE]}
    weaker[WitnessName.RIGID_LINE] = 1e3 * made.witnesses[WitnessName.RIGID_LINE]
    in_millimetres = judged(calibration, replace(made, witnesses=weaker))
    assert isinstance(in_millimetres, PreloadEstimate)
    assert "looks like a factor of 1000, as of mm for m" in in_millimetres.doubts[0].detail
    heavier = judged(calibration, reading(0.4, 300.0, rng, heavier=3.0, line=True))
    assert isinstance(heavier, Rejection)
    assert heavier.reason is RejectionReason.MOVED_MASS_MISMATCH


def test_rigid_line_alone_doubts_nothing() -> None:
    # friction at another speed moves it and leaves the residue
    rng = np.random.default_rng(17)
    calibration = calibrated(rng, line=True)
    made = reading(0.4, 300.0, rng, line=True)
    moved = {**made.witnesses, WitnessName.RIGID_LINE: 1.02 * made.witnesses[WitnessName.RIGID_LINE]}
    answers = [judged(calibration, replace(made, witnesses=moved)) for _ in range(5)]
    assert all(isinstance(a, PreloadEstimate) and not a.doubts for a in answers)
    estimates = [a.deviations for a in answers if isinstance(a, PreloadEstimate)]
    assert of_whole_session(estimates, calibration) == ()
    assert estimates[0][WitnessName.RIGID_LINE].score > 3.3


def test_without_payloads_in_the_calibration_nothing_is_told_apart() -> None:
    rng = np.random.default_rng(18)
    readings = [reading(x, p, rng, line=True) for x in POSITIONS for p in PRELOADS]
    calibration = calibrate(readings, weighting="none", excitation_source=None)
    answer = judged(calibration, reading(0.4, 300.0, rng, line=True, mounted=1.05))
    assert isinstance(answer, PreloadEstimate)
    assert causes_of_residue(answer.deviations, calibration) is None
    assert DoubtReason.MASS_OR_MOUNTING_CHANGED in [doubt.reason for doubt in answer.doubts]


def test_payload_that_nobody_states_widens_by_what_the_residue_shows() -> None:
    rng = np.random.default_rng(7)
    calibration = calibrated(rng)
    for heavier in (0.0, 1.0):
        answer = judged(calibration, reading(0.4, 300.0, rng, heavier=heavier), payload_mass=None)
        assert isinstance(answer, PreloadEstimate)
        assert answer.interval.covers(300.0)
        assert answer.shares.payload > 0.5
        assert any("payload not stated" in assumption for assumption in answer.assumptions)


def test_small_differences_of_a_whole_session_are_seen_together() -> None:
    rng = np.random.default_rng(8)
    calibration = calibrated(rng)
    slightly = [judged(calibration, reading(x, 300.0, rng, heavier=0.2)) for x in POSITIONS for _ in range(3)]
    estimates = [a for a in slightly if isinstance(a, PreloadEstimate)]
    assert np.mean([bool(a.doubts) for a in estimates]) < 0.5
    together = of_whole_session([a.deviations for a in estimates], calibration)
    assert [doubt.reason for doubt in together] == [DoubtReason.MASS_OR_MOUNTING_CHANGED]
    assert "over 15 measurements" in together[0].detail


def test_places_disagree_as_often_as_is_stated_in_healthy_sessions() -> None:
    rng = np.random.default_rng(9)
    n = sum(
        places_disagree([PlaceReading(x, math.log(300.0) + 0.01 * rng.standard_normal(), 0.01) for x in POSITIONS])
        is not None
        for _ in range(5000)
    )
    assert stats.binom.cdf(n, 5000, TEST_LEVEL) > 1e-4
    assert stats.binom.sf(n - 1, 5000, TEST_LEVEL) > 1e-4


def test_places_that_contradict_each_other_are_said_and_one_place_says_nothing() -> None:
    off = [PlaceReading(x, math.log(300.0) + 0.2 * (x - 0.4), 0.01) for x in POSITIONS]
    doubt = places_disagree(off)
    assert doubt is not None
    assert doubt.reason is DoubtReason.PLACES_DISAGREE
    assert "285 to 322 N" in doubt.detail
    assert places_disagree(off[:1]) is None
    assert places_disagree([replace(reading, position=0.4) for reading in off]) is None


def test_declared_parts_widen_and_are_listed() -> None:
    rng = np.random.default_rng(10)
    one_session, many = calibrated(rng), calibrated(np.random.default_rng(10), between_sessions=0.0)
    made = reading(0.4, 300.0, rng)
    wide, narrow = judged(one_session, made), judged(many, made)
    assert isinstance(wide, PreloadEstimate)
    assert isinstance(narrow, PreloadEstimate)
    assert narrow.shares.between_session == narrow.shares.position == 0.0
    assert wide.shares.between_session + wide.shares.position > 0.2
    assert wide.interval.upper - wide.interval.lower > 1.3 * (narrow.interval.upper - narrow.interval.lower)
    assert sum(asdict(wide.shares).values()) == pytest.approx(1.0)


def test_payload_between_the_calibrated_ones_is_covered_where_the_mode_bends_with_the_mass() -> None:
    # 1/f² grows by 6 % less per kilogram at 10 kg than at none, as of two machines of finite elements
    def bent(made: ModalReading) -> ModalReading:
        mass = made.conditions.payload_mass or 0.0
        straight, grown = 1.0 + mass / MASS, 1.0 + mass / MASS * (1.0 - 0.006 * mass)
        return replace(made, frequency=made.frequency * math.sqrt(straight / grown))

    rng = np.random.default_rng(22)
    readings = [bent(reading(x, p, rng)) for x in POSITIONS for p in PRELOADS]
    readings += [bent(reading(x, 300.0, rng, payload=m)) for x in POSITIONS[::2] for m in (6.0, 10.0)]
    calibration = calibrate(readings, weighting="none", excitation_source=None)
    answers = [judged(calibration, bent(reading(0.4, 300.0, rng, payload=m))) for m in np.linspace(1.0, 9.0, 33)]
    assert np.mean([isinstance(a, PreloadEstimate) and a.interval.covers(300.0) for a in answers]) > 0.9


def test_errors_of_temperature_grow_as_those_of_the_frequency_do_where_friction_follows_the_preload() -> None:
    rng = np.random.default_rng(11)
    calibration = calibrate(
        [replace(r, conditions=replace(r.conditions, temperature=20.0)) for r in
         (reading(x, p, rng) for x in POSITIONS for p in PRELOADS)],
        weighting="none", excitation_source=None, temperature_coefficient=Estimate(1e-8, 0.0), between_sessions=3e-4,
    )  # fmt: skip
    made = reading(0.4, 300.0, rng)

    def feature(frequency: float) -> float:
        answer = estimate_preload(
            Estimate(frequency, 0.005), Conditions(0.4, 0.0, 20.0), calibration, witnesses=made.witnesses
        )
        assert isinstance(answer, PreloadEstimate)
        return answer.feature.value

    step = 1e-3
    grown = (feature(made.frequency - step) - feature(made.frequency + step)) / (
        (made.frequency - step) ** -2.0 - (made.frequency + step) ** -2.0
    )
    assert grown > 1.05
    answer = judged(calibration, made, temperature=20.0)
    assert isinstance(answer, PreloadEstimate)
    of_temperature = math.sqrt(answer.shares.temperature) * answer.feature.standard_uncertainty
    assert of_temperature == pytest.approx(grown * 1e-8 * THERMOMETER, rel=0.01)


def test_structure_that_lags_behind_its_thermometer_widens() -> None:
    rng = np.random.default_rng(11)
    readings = [
        replace(r, conditions=replace(r.conditions, temperature=20.0 + 10.0 * rng.uniform()))
        for r in (reading(x, p, rng) for x in POSITIONS for p in PRELOADS)
    ]
    calibration = calibrate(
        readings,
        weighting="none",
        excitation_source=None,
        temperature_coefficient=Estimate(1e-8, 1e-9),
        between_sessions=3e-4,
    )
    coefficient = calibration.parameter("temperature_coefficient")
    assert coefficient is not None
    made = reading(0.4, 300.0, rng)
    near, far = (judged(calibration, made, temperature=t) for t in (25.0, 35.0))
    assert isinstance(near, PreloadEstimate)
    assert isinstance(far, PreloadEstimate)
    grown = far.shares.temperature * far.feature.standard_uncertainty**2
    excess = 35.0 - (calibration.reference_temperature or 0.0)
    assert grown >= 0.9 * (TEMPERATURE_LAG * coefficient.value * excess) ** 2
    assert far.shares.temperature > near.shares.temperature


def test_every_witness_has_a_tolerance() -> None:
    assert set(TOLERANCES) == set(WitnessName)


def test_every_influence_that_is_not_stated_widens_and_says_what_stating_it_would_bring() -> None:
    rng = np.random.default_rng(19)
    readings = [reading(x, p, rng) for x in POSITIONS for p in PRELOADS]
    readings += [reading(x, 300.0, rng, payload=m) for x in POSITIONS[::2] for m in (6.0, 10.0)]
    at = [replace(r, conditions=replace(r.conditions, temperature=20.0 + 4.0 * rng.uniform())) for r in readings]
    calibration = calibrate(
        at, weighting="none", excitation_source=None, between_sessions=3e-4, temperature_coefficient=Estimate(1e-8, 0.0)
    )
    made = reading(0.4, 300.0, rng)
    no_friction = replace(made, witnesses={k: v for k, v in made.witnesses.items() if "friction" not in k})
    silent = []
    for name, answer in {
        "temperature": judged(calibration, made),
        "payload": judged(calibration, made, temperature=22.0, payload_mass=None),
        "lubrication": judged(calibration, no_friction, temperature=22.0),
    }.items():
        stated = judged(calibration, made, temperature=22.0)
        assert isinstance(answer, PreloadEstimate)
        assert isinstance(stated, PreloadEstimate)
        if not answer.interval.lower < stated.interval.lower < stated.interval.upper < answer.interval.upper:
            silent.append(name)
        if name == "lubrication":  # a window shows it, and nobody states it
            continue
        (better,) = answer.if_stated
        assert better.quantities == (name,)
        assert answer.interval.lower < better.interval.lower < better.interval.upper < answer.interval.upper
    assert silent == []
    both = judged(calibration, made, payload_mass=None)
    assert isinstance(both, PreloadEstimate)
    assert [better.quantities for better in both.if_stated] == [
        ("temperature",), ("payload",), ("temperature", "payload")
    ]  # fmt: skip


def test_temperature_that_nobody_states_is_covered_as_often_as_is_said() -> None:
    # a hall whose temperature is anywhere between 13 and 31 °C, and an axis that follows it by 1e-8 s² a kelvin
    rng = np.random.default_rng(20)
    k_t = 1e-8
    readings = [
        replace(r, conditions=replace(r.conditions, temperature=22.0))
        for r in (reading(x, p, rng, noise=0.0) for x in POSITIONS for p in PRELOADS)
    ]
    calibration = calibrate(
        readings, weighting="none", excitation_source=None, temperature_coefficient=Estimate(k_t, 1e-10),
        between_sessions=3e-4,
    )  # fmt: skip
    covered = []
    for excess in rng.uniform(-9.0, 9.0, 400):
        made = reading(0.4, 300.0, rng, noise=0.0)
        frequency = (made.frequency**-2.0 + k_t * excess) ** -0.5
        answer = judged(calibration, replace(made, frequency=frequency))
        assert isinstance(answer, PreloadEstimate)
        covered.append(answer.interval.covers(300.0))
    assert np.mean(covered) >= 0.95
