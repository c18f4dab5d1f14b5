"""Regression of Eq. (8): recovery, covariance, influence quantities, and refusal of what cannot be determined."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload import (
    Calibration,
    InfluenceCoefficients,
    ModalReading,
    PreloadFeatureCoefficients,
    axial_frequency,
    calibrate,
    expected_band,
    minimum_detectable_loss,
    preload_sensitivity,
)
from monitor_core.preload.feature import from_reference
from monitor_core.recording import Conditions, ExcitationSource
from monitor_core.uncertainty import Estimate

K = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
INFLUENCE = InfluenceCoefficients(inverse_moving_mass=1.0 / 23.864, temperature=1e-8)
POSITIONS = (0.25, 0.4, 0.5, 0.6, 0.75)
PRELOADS = (50.0, 100.0, 200.0, 300.0)


def reading(
    conditions: Conditions, *, error: float = 0.0, std: float | None = None, reference_temperature: float = 20.0
) -> ModalReading:
    """Eq. (8) with payload and temperature, and an error of the frequency [Hz]."""
    assert conditions.preload is not None
    inverse_square = axial_frequency(conditions.position, conditions.preload, K) ** -2.0
    temperature = 0.0 if conditions.temperature is None else conditions.temperature - reference_temperature
    measured = from_reference(inverse_square, conditions.payload_mass or 0.0, temperature, INFLUENCE)
    return ModalReading(float(measured) ** -0.5 + error, conditions, std)


def grid(positions: Iterable[float] = POSITIONS, preloads: Sequence[float] = PRELOADS) -> list[Conditions]:
    return [Conditions(x, preload=p) for x in positions for p in preloads]


def fit(readings: Sequence[ModalReading], weighting: str = "none", **options: Estimate) -> Calibration:
    return calibrate(
        readings,
        weighting="std" if weighting == "std" else "none",
        excitation_source=ExcitationSource.SENSOR,
        **options,
    )


def test_exact_frequencies_give_the_coefficients_back() -> None:
    calibration = fit([reading(c) for c in grid()])
    assert calibration.parameters.values == pytest.approx([K.k1, K.k2, K.k3, K.k4], rel=1e-10)
    assert calibration.residual_max < 1e-9  # [Hz]


def test_payload_and_temperature_are_fitted_where_they_vary() -> None:
    varied = [
        replace(c, payload_mass=m, temperature=t)
        for c in grid()
        for m, t in ((0.0, 15.0), (0.0, 25.0), (6.0, 20.0), (12.0, 20.0))
    ]
    calibration = fit([reading(c) for c in varied])
    assert calibration.parameter_names == ("k1", "k2", "k3", "k4", "inverse_moving_mass", "temperature_coefficient")
    assert calibration.parameters.values[:4] == pytest.approx([K.k1, K.k2, K.k3, K.k4], rel=1e-9)
    mass, k_t = calibration.moving_mass, calibration.parameter("temperature_coefficient")
    assert mass is not None
    assert k_t is not None
    assert mass.value == pytest.approx(23.864, rel=1e-9)
    assert k_t.value == pytest.approx(1e-8, rel=1e-7)


def test_moving_mass_does_not_depend_on_the_payload_called_reference() -> None:
    lifted = [replace(c, payload_mass=m) for c in grid() for m in (4.0, 12.0)]
    mass = fit([reading(c) for c in lifted]).moving_mass
    assert mass is not None
    assert mass.value == pytest.approx(23.864, rel=1e-9)


def test_declared_influences_stand_beside_the_fitted_coefficients() -> None:
    rng = np.random.default_rng(1)
    calibration = fit([reading(c, error=rng.normal(0.0, 0.2)) for c in grid()], moving_mass=Estimate(23.9, 0.5))
    assert calibration.declared == ("inverse_moving_mass",)
    assert np.all(calibration.parameters.covariance[4, :4] == 0.0)
    mass = calibration.moving_mass
    assert mass is not None
    assert (mass.value, mass.standard_uncertainty) == pytest.approx((23.9, 0.5))


def test_a_small_span_of_temperature_is_not_fitted_but_taken_as_unknown() -> None:
    readings = [reading(replace(c, temperature=20.0 + 0.1 * i)) for i, c in enumerate(grid())]
    calibration = fit(readings)
    k_t = calibration.parameter("temperature_coefficient")
    assert calibration.declared == ("temperature_coefficient",)
    assert k_t is not None
    assert k_t.value == 0.0
    # 3e-4 per kelvin of 1/f², the modulus of steel: half of it on the frequency
    assert k_t.standard_uncertainty * 180.0**2 == pytest.approx(3e-4, rel=0.15)


@pytest.mark.release
@pytest.mark.parametrize("weighting", ["none", "std"])
def test_stated_uncertainties_of_the_coefficients_are_their_scatter(weighting: str) -> None:
    """500 calibrations: each standard deviation is known to 3.2 %, so 13 % is four of them."""
    rng = np.random.default_rng(2)
    own = 0.05 * 4.0 ** rng.uniform(-1.0, 1.0, size=(500, len(grid())))  # stated, 0.0125 to 0.2 Hz
    fits = [
        fit(
            [reading(c, error=rng.normal(0.0, np.hypot(s, 0.1)), std=s) for c, s in zip(grid(), row, strict=True)],
            weighting,
        ).parameters
        for row in own
    ]
    values = np.array([f.values for f in fits])
    stated = np.sqrt(np.mean([f.standard_uncertainties**2 for f in fits], axis=0))
    assert stated == pytest.approx(values.std(axis=0), rel=0.13)
    assert values.mean(axis=0) == pytest.approx([K.k1, K.k2, K.k3, K.k4], abs=float(np.max(4.0 * stated / 500**0.5)))


def test_reproducibility_is_the_scatter_beyond_the_stated_uncertainty() -> None:
    rng = np.random.default_rng(3)
    variances = [
        fit([reading(c, error=rng.normal(0.0, np.hypot(0.05, 0.2)), std=0.05) for c in grid()], "std").reproducibility
        ** 2
        for _ in range(300)
    ]
    # 16 degrees of freedom, 300 calibrations: the mean variance is known to √(2/16/300) = 2 %
    assert np.mean(variances) == pytest.approx(0.2**2, rel=0.08)


def test_reproducibility_is_zero_where_the_stated_uncertainty_explains_all() -> None:
    rng = np.random.default_rng(4)
    assert fit([reading(c, error=rng.normal(0.0, 0.01), std=0.2) for c in grid()], "std").reproducibility == 0.0


def test_a_common_factor_in_the_stated_uncertainties_does_not_move_the_coefficients() -> None:
    rng = np.random.default_rng(5)
    readings = [reading(c, error=rng.normal(0.0, 0.1), std=rng.uniform(0.05, 0.5)) for c in grid()]
    scaled = [replace(r, frequency_std=7.0 * (r.frequency_std or 0.0)) for r in readings]
    assert fit(scaled, "std").parameters.values == pytest.approx(fit(readings, "std").parameters.values, rel=1e-10)


def test_positions_left_out_are_predicted_as_the_hat_matrix_says() -> None:
    """Law of least squares: leaving a group g out, its residual becomes (I − H_gg)⁻¹ times the residual of the fit."""
    rng = np.random.default_rng(6)
    readings = [reading(c, error=rng.normal(0.0, 0.1)) for c in grid()]
    x, p = (np.repeat(POSITIONS, len(PRELOADS)), np.tile(PRELOADS, len(POSITIONS)))
    f = np.array([r.frequency for r in readings])
    design = np.column_stack([x**2, x, p ** (-1 / 3), np.ones_like(x)])
    hat = design @ np.linalg.pinv(design)
    residual = f**-2 - hat @ f**-2
    errors = fit(readings).leave_one_position_out
    assert [e.position for e in errors] == pytest.approx(POSITIONS)
    for error in errors:
        g = x == error.position
        out = np.linalg.solve(np.eye(g.sum()) - hat[np.ix_(g, g)], residual[g]) * f[g] ** 3 / 2.0
        assert error.frequency_error_rms == pytest.approx(np.sqrt(np.mean(out**2)), rel=1e-8)
    # at an inner position the left-out error stays of the order of the scatter: 0.1 Hz is some 10 N at 300 N
    inner = errors[2]
    assert inner.preload_error_rms is not None
    assert 1.0 < inner.preload_error_rms < 40.0


def test_three_positions_leave_none_to_spare() -> None:
    assert fit([reading(c) for c in grid(POSITIONS[:3])]).leave_one_position_out == ()


@pytest.mark.parametrize(
    ("conditions", "missing"),
    [
        (grid((0.25, 0.75)), "three positions"),
        (grid((0.25, 0.2503, 0.75)), "three positions"),
        (grid(POSITIONS, (200.0,)), "two preloads"),
        (grid((0.5,), (200.0,)), "three positions .* and two preloads"),
        ([Conditions(0.25, preload=50.0), Conditions(0.5, preload=300.0), Conditions(0.75, preload=50.0)], "readings"),
    ],
)
def test_what_cannot_be_determined_is_refused_by_name(conditions: list[Conditions], missing: str) -> None:
    with pytest.raises(NotIdentifiableError, match=missing):
        fit([reading(c) for c in conditions])


def test_preloads_too_close_for_the_scatter_are_refused() -> None:
    rng = np.random.default_rng(7)
    with pytest.raises(NotIdentifiableError, match="does not rise measurably with the preload"):
        fit([reading(c, error=rng.normal(0.0, 0.3)) for c in grid(POSITIONS, (200.0, 202.0))])


def test_a_payload_that_raises_the_frequency_is_refused() -> None:
    empty = [reading(replace(c, payload_mass=0.0)) for c in grid()]
    loaded = [
        replace(r, frequency=r.frequency + 2.0, conditions=replace(r.conditions, payload_mass=5.0)) for r in empty
    ]
    with pytest.raises(NotIdentifiableError, match="payload must lower the frequency"):
        fit([*empty, *loaded])


def test_temperature_that_went_with_the_preload_is_refused() -> None:
    # each preload at its own temperature, in proportion to preload^(−1/3): no data can tell the two apart
    confounded = [replace(c, temperature=15.0 + 40.0 * (c.preload or 1.0) ** (-1 / 3)) for c in grid()]
    with pytest.raises(NotIdentifiableError, match="cannot separate"):
        fit([reading(c) for c in confounded])


@pytest.mark.parametrize(
    ("change", "weighting", "message"),
    [
        ({"preload": None}, "none", "preload must be stated for all readings"),
        ({"payload_mass": 3.0}, "none", "payload_mass must be stated for all readings"),
        ({"temperature": 20.0}, "none", "temperature must be stated for all readings"),
        ({}, "std", "frequency_std for every reading"),
    ],
)
def test_what_is_stated_for_some_readings_only_is_refused(
    change: dict[str, float | None], weighting: str, message: str
) -> None:
    readings = [reading(c, std=0.1) for c in grid()]
    first = replace(readings[0], conditions=replace(readings[0].conditions, **change), frequency_std=None)
    with pytest.raises(OutsideValidityError, match=message):
        fit([first, *readings[1:]], weighting)


def test_the_mode_is_expected_where_every_calibrated_reading_was() -> None:
    rng = np.random.default_rng(8)
    readings = [reading(c, error=rng.normal(0.0, 0.2)) for c in grid()]
    calibration = fit(readings)
    for r in readings:
        low, high = expected_band(calibration, r.conditions)
        assert low < r.frequency < high
        # nearly lost, an axis is softer than at any calibrated preload; no band may hide that
        assert low < axial_frequency(r.conditions.position, 5.0, K)


def test_the_band_moves_with_the_payload() -> None:
    calibration = fit([reading(c) for c in grid()], moving_mass=Estimate(23.864, 0.1))
    empty = np.array(expected_band(calibration, Conditions(0.5)))
    loaded = np.array(expected_band(calibration, Conditions(0.5, payload_mass=23.864)))
    assert loaded == pytest.approx(empty / 2**0.5, rel=1e-6)


def test_detectable_loss_is_the_frequency_scatter_times_the_sensitivity() -> None:
    rng = np.random.default_rng(9)
    calibration = fit([reading(c, error=rng.normal(0.0, 0.02)) for c in grid()])
    # 16 degrees of freedom: t.95 = 1.746, t.90 = 1.337 (any table); small, so that the tangent holds to a few per cent
    f = axial_frequency(0.5, 300.0, calibration.coefficients)
    tangent = (1.746 + 1.337) * calibration.residual_sd * preload_sensitivity(f, 300.0, calibration.coefficients)
    assert minimum_detectable_loss(calibration, 300.0, 0.5) == pytest.approx(tangent, rel=0.05)
    assert minimum_detectable_loss(calibration, 300.0, 0.5, n_measurements=16) == pytest.approx(tangent / 4, rel=0.05)
    assert minimum_detectable_loss(calibration) >= minimum_detectable_loss(calibration, 300.0, 0.5)


def test_detectable_loss_is_detected_nine_times_in_ten() -> None:
    """The definition, played out: 20 000 single readings after the loss against the 95 % bound of the healthy axis."""
    rng = np.random.default_rng(10)
    readings = [reading(c, error=rng.normal(0.0, 0.1)) for c in grid() * 20]  # many: scatter known to 4 %
    calibration = fit(readings)
    lost = 300.0 - minimum_detectable_loss(calibration, 300.0, 0.5)
    bound = axial_frequency(0.5, 300.0, K) - 1.645 * 0.1
    measured = axial_frequency(0.5, lost, K) + rng.normal(0.0, 0.1, size=20_000)
    assert np.mean(measured < bound) == pytest.approx(0.90, abs=0.03)  # 4 % of 2.9 σ moves the power by 0.02
