"""Calibration on a prior: laws of Gaussian inference, coverage of the newtons, contradiction, and the document."""

import csv
import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
import pytest
from scipy import stats

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload import (
    Calibration,
    CoefficientPrior,
    ModalReading,
    PreloadEstimate,
    PreloadFeatureCoefficients,
    ValidRange,
    axial_frequency,
    calibrate,
    calibration_from_prior,
    estimate_preload,
    minimum_detectable_loss,
    prior_from_calibration,
)
from monitor_core.recording import Conditions, ExcitationQuantity, ExcitationSource
from monitor_core.recordings.calibration_file import calibration_document, read_calibration, write_calibration
from monitor_core.uncertainty import Estimate, VectorEstimate
from tests.conftest import canary

TRUE = np.array([-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8])
#: As of joints known to some 5 %, the nut and the constant part correlated.
UNCERTAINTY = np.array([0.02, 0.02, 0.05, 0.04]) * np.abs(TRUE)
CORRELATION = np.eye(4) + np.array([[0, -0.5, 0, 0], [-0.5, 0, 0, 0], [0, 0, 0, -0.6], [0, 0, -0.6, 0]])
COVARIANCE = CORRELATION * np.outer(UNCERTAINTY, UNCERTAINTY)
PRIOR = CoefficientPrior(
    VectorEstimate(TRUE, COVARIANCE), 0.1, ValidRange(0.25, 0.75), ValidRange(50.0, 300.0), "model"
)
GRID = [(x, p) for x in (0.25, 0.5, 0.75) for p in (50.0, 150.0, 300.0)]
TWO = [(0.3, 300.0), (0.6, 80.0)]


def frequency(position: float, preload: float, k: np.ndarray = TRUE) -> float:
    return axial_frequency(position, preload, PreloadFeatureCoefficients(*k.tolist()))


def readings_at(
    settings: Sequence[tuple[float, float]],
    rng: np.random.Generator | None = None,
    *,
    scatter: float = 0.0,
    stated: float | None = None,
    k: np.ndarray = TRUE,
) -> list[ModalReading]:
    return [
        ModalReading(
            frequency(x, p, k) + (0.0 if rng is None else rng.normal(0.0, scatter)), Conditions(x, preload=p), stated
        )
        for x, p in settings
    ]


def fit(
    readings: Sequence[ModalReading], prior: CoefficientPrior | None = None, weighting: str = "none"
) -> Calibration:
    chosen = "std" if weighting == "std" else "none"
    return calibrate(readings, weighting=chosen, excitation_source=None, prior=prior)


def with_covariance(covariance: np.ndarray, dof: float = math.inf) -> CoefficientPrior:
    return replace(PRIOR, coefficients=VectorEstimate(TRUE, covariance, dof))


def assert_same_covariance(got: np.ndarray, expected: np.ndarray, within: float) -> None:
    """Compare in units of the standard uncertainties: covariances of k are about 1e-12 and would pass for zero."""
    scale = np.sqrt(np.diag(expected))
    scale = np.where(scale > 0.0, scale, scale[scale > 0.0].min())
    assert np.max(np.abs(got - expected) / np.outer(scale, scale)) < within


# --- laws ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", ["none", "std"])
def test_a_prior_that_knows_nothing_changes_nothing(weighting: str) -> None:
    """Uncertainties a million times wider than those of the fit, and a scatter with next to no degree of freedom."""
    readings = readings_at(GRID, np.random.default_rng(1), scatter=0.2, stated=0.05)
    alone = fit(readings, weighting=weighting)
    wide = np.diag((1e6 * alone.parameters.standard_uncertainties) ** 2)
    joined = fit(readings, replace(with_covariance(wide, 1e-6), reproducibility=0.3), weighting)
    assert joined.parameters.values == pytest.approx(alone.parameters.values, rel=1e-6, abs=0.0)
    assert_same_covariance(joined.parameters.covariance, alone.parameters.covariance, 1e-5)
    assert joined.parameters.degrees_of_freedom == pytest.approx(9 - 4, rel=1e-5)
    assert joined.reproducibility == pytest.approx(alone.reproducibility, rel=1e-5)


def test_readings_that_say_nothing_give_the_prior_back() -> None:
    joined = fit(readings_at(TWO, stated=1e7), PRIOR, "std")
    assert joined.parameters.values == pytest.approx(TRUE, rel=1e-9, abs=0.0)
    assert_same_covariance(joined.parameters.covariance, COVARIANCE, 1e-9)


def test_half_of_the_data_and_then_the_other_half_are_all_data_at_once() -> None:
    """Known uncertainties, which the seeds keep from being exceeded, so that no scatter is estimated on the way."""
    positions, halves = (0.25, 0.5, 0.75), []
    for seed, preloads, stated in ((2, (50.0, 150.0, 300.0), 0.2), (3, (80.0, 250.0), 0.1)):
        settings = [(x, p) for x in positions for p in preloads]
        halves.append(readings_at(settings, np.random.default_rng(seed), scatter=0.05, stated=stated))
    first, second = halves
    half, both = fit(first, weighting="std"), fit([*first, *second], weighting="std")
    assert half.reproducibility == both.reproducibility == 0.0
    joined = fit(second, prior_from_calibration(half, "first half"), "std")
    assert joined.parameters.values == pytest.approx(both.parameters.values, rel=1e-9, abs=0.0)
    assert_same_covariance(joined.parameters.covariance, both.parameters.covariance, 1e-7)


def test_halves_of_nguyens_table_are_the_whole_table(published_data) -> None:
    """Preloads 50, 200 and 400 N, then the rest, unweighted; the whole table gives the k of the errata.

    The scatter is estimated from the first nine readings for all, and 1/f² is taken to scatter alike: each k agrees to
    a twentieth of its standard uncertainty.
    """
    with (published_data / "nguyen_table2.csv").open(newline="", encoding="utf-8") as stream:
        rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(stream)]
    table = [ModalReading(r["frequency_hz"], Conditions(r["position_mm"] * 1e-3, preload=r["preload_n"])) for r in rows]
    preloads = sorted({r["preload_n"] for r in rows})
    halves = [[reading for reading in table if reading.conditions.preload in preloads[start::2]] for start in (0, 1)]
    joined = fit(halves[1], prior_from_calibration(fit(halves[0]), "first half")).parameters
    whole = [-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8]
    assert np.abs(joined.values - whole) / joined.standard_uncertainties == pytest.approx([0.0] * 4, abs=0.05)
    assert 5.0 < joined.degrees_of_freedom <= 14.0  # 9 − 4 of the first half, 18 − 4 of the whole


@pytest.mark.parametrize("covariance", [COVARIANCE, np.diag([0.0, 0.0, UNCERTAINTY[2] ** 2, 0.0])], ids=["all", "k3"])
def test_one_reading_pulls_as_much_as_bayes_says(covariance: np.ndarray) -> None:
    """Update of a normal mean in the covariance form, which needs no inverse: also where k1, k2 and k4 are known."""
    (reading,) = readings_at([(0.4, 150.0)], k=TRUE * [1.0, 1.0, 1.08, 1.0], stated=0.05)
    row = np.array([0.4**2, 0.4, 150.0 ** (-1 / 3), 1.0])
    variance = (2.0 / reading.frequency**3) ** 2 * (0.05**2 + 0.1**2)
    gain = covariance @ row / (row @ covariance @ row + variance)
    calibration = fit([reading], with_covariance(covariance), "std")
    assert calibration.residual_sd == pytest.approx(math.hypot(0.05, 0.1), rel=1e-12)
    joined = calibration.parameters
    assert joined.values == pytest.approx(TRUE + gain * (reading.frequency**-2.0 - row @ TRUE), rel=1e-9, abs=0.0)
    left = covariance - np.outer(gain, row @ covariance)
    assert_same_covariance(joined.covariance, left, 1e-9)
    assert joined.degrees_of_freedom == math.inf


def test_scatter_is_pooled_by_degrees_of_freedom() -> None:
    """Coefficients known as good as exactly: residuals against them are all degrees of freedom of the readings."""
    rng = np.random.default_rng(4)
    readings = readings_at(GRID, rng, scatter=0.15)
    joined = fit(readings, with_covariance(1e-12 * COVARIANCE, 6.0))
    f, expected = np.array([r.frequency for r in readings]), np.array([frequency(x, p) for x, p in GRID])
    own = np.sum((f**-2 - expected**-2) ** 2) / np.sum((2.0 / f**3) ** 2)
    assert joined.parameters.degrees_of_freedom == pytest.approx(6.0 + 9.0, rel=1e-6)
    assert joined.reproducibility**2 == pytest.approx((6.0 * 0.1**2 + 9.0 * own) / 15.0, rel=1e-6)


def test_covariance_of_the_prior_follows_the_pooled_scatter() -> None:
    """Conjugate update with C₀ known up to the common factor of all variances, here with inverses of matrices."""
    readings = readings_at(GRID, np.random.default_rng(11), scatter=0.4)
    joined = fit(readings, with_covariance(COVARIANCE, 6.0)).parameters
    x, p = np.array(GRID).T
    design, f = np.column_stack([x**2, x, p ** (-1 / 3), np.ones_like(x)]), np.array([r.frequency for r in readings])
    expected = np.mean((2.0 / f**3 * 0.1) ** 2)
    posterior = np.linalg.inv(np.linalg.inv(COVARIANCE) + design.T @ design / expected)
    k = posterior @ (np.linalg.solve(COVARIANCE, TRUE) + design.T @ f**-2 / expected)
    own = 9.0 - np.trace(design @ posterior @ design.T) / expected
    factor = (6.0 + np.sum((f**-2 - design @ k) ** 2) / expected) / (6.0 + own)
    assert factor > 1.5
    assert joined.values == pytest.approx(k, rel=1e-6, abs=0.0)
    assert_same_covariance(joined.covariance, factor * posterior, 1e-6)
    assert joined.degrees_of_freedom == pytest.approx(6.0 + own, rel=1e-6)


# --- coverage --------------------------------------------------------------------------------------------------------


def covered(calibration: Calibration, x: float, p: float, measured: float, own: float) -> bool:
    answer = estimate_preload(Estimate(measured, own), Conditions(x), calibration)
    return isinstance(answer, PreloadEstimate) and answer.interval.covers(p)


@pytest.mark.parametrize("n_readings", canary([0, 2]))
def test_newtons_are_covered_where_axes_are_as_the_prior_says(n_readings: int) -> None:
    """1000 axes drawn from the prior, two readings each or none, then one measurement at an unseen place.

    The one axis in a thousand that is called a contradiction counts as a miss.
    """
    rng, n, hits, uncertainties = np.random.default_rng(5), 1000, 0, []
    scatter = math.hypot(0.1, 0.05)
    for k in rng.multivariate_normal(TRUE, COVARIANCE, size=n):
        calibration = calibration_from_prior(PRIOR)
        if n_readings:
            try:
                calibration = fit(readings_at(TWO, rng, scatter=scatter, stated=0.05, k=k), PRIOR)
            except NotIdentifiableError:
                continue
        x, p = rng.uniform(0.25, 0.75), rng.uniform(60.0, 280.0)
        hits += covered(calibration, x, p, frequency(x, p, k) + rng.normal(0.0, scatter), 0.05)
        uncertainties.append(calibration.parameters.standard_uncertainties[3])
    low, high = stats.binom.interval(0.9999, n, 0.95)
    assert 0.92 * n < low
    assert high < 0.98 * n
    assert low <= hits <= high, hits / n
    if n_readings:  # two readings already pull
        assert np.mean(uncertainties) < 0.7 * UNCERTAINTY[3]


def test_newtons_are_covered_on_an_earlier_calibration_of_few_readings() -> None:
    """A scatter known with two degrees of freedom, joined with two readings of the same axis."""
    rng, n, hits = np.random.default_rng(6), 600, 0
    first = [(x, p) for x in (0.25, 0.5, 0.75) for p in (50.0, 300.0)]
    for _ in range(n):
        try:
            earlier = fit(readings_at(first, rng, scatter=0.1))
            calibration = fit(readings_at(TWO, rng, scatter=0.1), prior_from_calibration(earlier, "earlier"))
        except NotIdentifiableError:  # blind or a contradiction by chance: counts as a miss
            continue
        x, p = rng.uniform(0.25, 0.75), rng.uniform(60.0, 280.0)
        hits += covered(calibration, x, p, frequency(x, p) + rng.normal(0.0, 0.1), 0.0)
    low, high = stats.binom.interval(0.9999, n, 0.95)
    assert low <= hits <= high, hits / n


# --- contradiction and refusals --------------------------------------------------------------------------------------


def test_readings_contradict_beyond_the_point_of_one_in_a_thousand() -> None:
    """One reading, k1, k2 and k4 known: 3.29 standard deviations of what the prior says of it, from any table."""
    prior = with_covariance(np.diag([0.0, 0.0, UNCERTAINTY[2] ** 2, 0.0]))
    f, row = frequency(0.5, 100.0), 100.0 ** (-1 / 3)
    for deviations, refused in ((3.27, False), (-3.27, False), (3.31, True), (-3.31, True)):
        # the slope of 1/f² is that of the reading: its own frequency is found by a few rounds
        measured = f
        for _ in range(20):
            sd = math.hypot(row * UNCERTAINTY[2], 2.0 / measured**3 * 0.1)
            measured = (f**-2.0 + deviations * sd) ** -0.5
        reading = ModalReading(measured, Conditions(0.5, preload=100.0))
        if refused:
            with pytest.raises(NotIdentifiableError, match=r"contradict the prior \(model\).* at most 10\.8 for 1 "):
                fit([reading], prior)
        else:
            fit([reading], prior)


@pytest.mark.release
def test_true_priors_are_hardly_ever_contradicted() -> None:
    """Of 3000 axes three are; 99.99 % of such trials refuse at most 11."""
    rng, refused = np.random.default_rng(7), 0
    for k in rng.multivariate_normal(TRUE, COVARIANCE, size=3000):
        try:
            fit(readings_at(TWO, rng, scatter=0.1, k=k), PRIOR)
        except NotIdentifiableError:
            refused += 1
    assert refused <= stats.binom.ppf(0.9999, 3000, 1e-3)


@pytest.mark.parametrize(
    ("conditions", "change", "sentence"),
    [
        (Conditions(0.5, 3.0, None, 100.0), {}, "payload of 0 kg, which must be the lowest of the readings; got 3 kg"),
        (Conditions(0.5, None, 27.0, 100.0), {"temperature": 20.0}, "within 3 K of it on average, got 27.0 °C"),
        (
            Conditions(0.5, None, None, 100.0),
            {"excitation_source": ExcitationSource.DRIVE},
            "excitation 'drive'; got readings of 'sensor'",
        ),
        (Conditions(0.5, None, None, 100.0), {"reproducibility": 0.0}, "a prior without scatter"),
    ],
)
def test_readings_under_other_conditions_are_refused(conditions, change, sentence) -> None:
    reading = ModalReading(frequency(0.5, 100.0), conditions)
    with pytest.raises(OutsideValidityError, match=sentence):
        calibrate(
            [reading], weighting="none", excitation_source=ExcitationSource.SENSOR, prior=replace(PRIOR, **change)
        )


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"coefficients": VectorEstimate(TRUE[:3], COVARIANCE[:3, :3])}, "four coefficients, k1 to k4; got 3"),
        ({"coefficients": VectorEstimate(TRUE * [1, 1, -1, 1], COVARIANCE)}, "k3 must be positive"),
        ({"coefficients": VectorEstimate(TRUE, 0.0 * COVARIANCE)}, "one of them positive"),
        ({"coefficients": VectorEstimate(TRUE, np.diag([np.inf, 1.0, 1.0, 1.0]))}, "finite variances"),
        ({"coefficients": VectorEstimate(TRUE, 1.2e-13 - 2e-14 * np.eye(4))}, "no negative variance"),
        ({"reproducibility": -0.1}, "must not be negative; got -0.1 Hz"),
    ],
)  # fmt: skip
def test_what_is_no_prior_is_refused(change, sentence) -> None:
    with pytest.raises(OutsideValidityError, match=sentence):
        replace(PRIOR, **change)


def test_a_prior_that_is_blind_to_the_preload_is_refused() -> None:
    blind = with_covariance(np.diag([0.0, 0.0, (0.6 * TRUE[2]) ** 2, 0.0]))
    with pytest.raises(NotIdentifiableError, match="does not rise measurably with the preload"):
        calibration_from_prior(blind)


# --- what a calibration remembers ------------------------------------------------------------------------------------


def test_ranges_are_joined_and_the_prior_is_remembered() -> None:
    stated = replace(PRIOR, excitation_source=ExcitationSource.SENSOR, excitation_quantity=ExcitationQuantity.TORQUE)
    joined = fit(readings_at([(0.2, 400.0)]), stated)
    assert (joined.position, joined.preload) == (ValidRange(0.2, 0.75), ValidRange(50.0, 400.0))
    assert (joined.prior, joined.n_readings) == ("model", 1)
    assert (joined.excitation_source, joined.excitation_quantity) == ("sensor", "torque")
    assert fit(readings_at(GRID, np.random.default_rng(8), scatter=0.1)).prior is None


def test_temperature_and_payload_are_handled_as_in_any_calibration() -> None:
    prior = replace(PRIOR, temperature=20.0)
    assert calibration_from_prior(prior, moving_mass=Estimate(24.0, 1.0)).declared == (
        "inverse_moving_mass",
        "temperature_coefficient",
    )
    rng = np.random.default_rng(9)
    warm = [
        replace(r, conditions=replace(r.conditions, temperature=t))
        for r, t in zip(readings_at(GRID, rng, scatter=0.1), np.linspace(18.0, 24.0, 9), strict=True)
    ]
    fitted = fit(warm, prior)
    k_t = fitted.parameter("temperature_coefficient")
    assert fitted.declared == ()
    assert k_t is not None
    assert abs(k_t.value) < 4.0 * k_t.standard_uncertainty  # the truth is zero
    loaded = replace(
        readings_at([(0.5, 100.0)])[0], frequency=frequency(0.5, 100.0) * 2**-0.5,
        conditions=Conditions(0.5, 24.0, None, 100.0),
    )  # fmt: skip
    empty = [replace(r, conditions=replace(r.conditions, payload_mass=0.0)) for r in readings_at(TWO)]
    mass = fit([*empty, loaded], PRIOR).moving_mass
    assert mass is not None
    assert mass.value == pytest.approx(24.0, rel=1e-6)


@pytest.mark.parametrize("with_readings", [False, True])
def test_the_document_remembers_the_prior(with_readings: bool, tmp_path) -> None:
    rng = np.random.default_rng(10)
    calibration = fit(readings_at(TWO, rng, scatter=0.1), PRIOR) if with_readings else calibration_from_prior(PRIOR)
    document = calibration_document(calibration)
    assert document["prior"] == "model"
    assert document["degrees_of_freedom"] is None
    # z of 95 % and 90 %: 1.645 + 1.282 of 0.1 Hz, at some 100 N/Hz
    assert document["minimum_detectable_loss_n"] == minimum_detectable_loss(calibration) == pytest.approx(30.0, rel=0.3)
    path = tmp_path / "axis.json"
    write_calibration(path, calibration)
    back = read_calibration(path)
    assert np.array_equal(back.parameters.values, calibration.parameters.values)
    assert np.array_equal(back.parameters.covariance, calibration.parameters.covariance)
    assert back.parameters.degrees_of_freedom == math.inf
    for field in fields(Calibration):
        if field.name not in ("parameters", "position"):
            assert getattr(back, field.name) == getattr(calibration, field.name), field.name
