"""Nguyen et al. (2018): Table 2 regressed, and each of the paper's errata (``docs/reference/errata.md``) shown."""

import csv
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from monitor_core.arrays import FloatArray
from monitor_core.models.published.lumped import LumpedParameters, feature_coefficients, shaft_torsional_stiffness
from monitor_core.preload import (
    Calibration,
    ModalReading,
    PositioningBolts,
    PreloadEstimate,
    PreloadFeatureCoefficients,
    axial_frequency,
    calibrate,
    estimate_preload,
    preload_feature,
    preload_sensitivity,
)
from monitor_core.recording import Conditions
from monitor_core.uncertainty import Estimate

PRINTED_REGRESSED = PreloadFeatureCoefficients(-4872e-8, 5561e-8, 2097e-8, 1228e-8)  # Table 3
PRINTED_CALCULATED = PreloadFeatureCoefficients(-4557e-8, 5173e-8, 2096e-8, 1287e-8)  # Table 3
SHEAR_MODULUS = 206e9 / 2.6  # [Pa] for Poisson's ratio 0.3, the paper gives none


@pytest.fixture(scope="module")
def table(published_data: Path) -> list[ModalReading]:
    with (published_data / "nguyen_table2.csv").open(newline="") as stream:
        rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(stream)]
    return [
        ModalReading(
            row["frequency_hz"],
            Conditions(row["position_mm"] * 1e-3, preload=row["preload_n"]),
            row["frequency_std_hz"],
            int(row["n_readings"]),
        )
        for row in rows
    ]


@pytest.fixture(scope="module")
def parameters(published_data: Path) -> dict[str, float]:
    with (published_data / "nguyen_table1.csv").open(newline="") as stream:
        return {row["symbol"]: float(row["value"]) for row in csv.DictReader(stream)}


@pytest.fixture(scope="module")
def unweighted(table: list[ModalReading]) -> Calibration:
    return calibrate(table, weighting="none", excitation_source=None)


def misfit(table: list[ModalReading], coefficients: PreloadFeatureCoefficients) -> FloatArray:
    """Measured minus predicted frequency [Hz]."""
    return np.array(
        [r.frequency - axial_frequency(r.conditions.position, r.conditions.preload or 0.0, coefficients) for r in table]
    )


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# --- what reproduces --------------------------------------------------------------------------------------------------


def test_unweighted_least_squares_meets_table_2(unweighted: Calibration) -> None:
    # independent regressions of the 18 printed frequencies agree on these to the last digit given
    assert unweighted.parameters.values * 1e8 == pytest.approx([-4848.6, 5741.6, 1915.2, 1154.6], abs=0.1)
    assert unweighted.residual_rms == pytest.approx(0.2215, abs=5e-5)  # [Hz]; the table's own scatter is 0.24 to 0.86
    assert unweighted.residual_max == pytest.approx(0.45, abs=5e-3)


def test_least_squares_weighted_by_the_printed_scatter(table: list[ModalReading]) -> None:
    weighted = calibrate(table, weighting="std", excitation_source=None)
    assert weighted.parameters.values * 1e8 == pytest.approx([-4867.5, 5754.2, 1893.7, 1156.0], abs=0.1)


def test_covariance_is_that_of_ordinary_least_squares(table: list[ModalReading], unweighted: Calibration) -> None:
    """In units of N^(−1/3), m and 1e-5 s², where the normal equations are harmless, by another route (polyfit-like)."""
    x = np.array([r.conditions.position for r in table])
    p = np.array([r.conditions.preload or 0.0 for r in table])
    y = np.array([r.frequency**-2.0 for r in table]) * 1e5
    design = np.column_stack([x**2, x, p ** (-1 / 3), np.ones(18)])
    normal = np.linalg.inv(design.T @ design)
    residual = y - design @ (normal @ (design.T @ y))
    expected = normal * (residual @ residual) / 14 * 1e-10
    assert unweighted.parameters.degrees_of_freedom == 14
    # the balanced table leaves k1 and k2 uncorrelated with k3: zero up to rounding of 1e-13
    assert np.allclose(unweighted.parameters.covariance, expected, rtol=1e-8, atol=1e-22)


def test_sensitivity_is_27_newtons_per_hertz_at_100_and_about_100_at_300(unweighted: Calibration) -> None:
    def sensitivity(preload: float) -> FloatArray:
        frequency = [axial_frequency(x, preload, unweighted.coefficients) for x in (0.25, 0.5, 0.75)]
        return np.array([preload_sensitivity(f, preload, unweighted.coefficients) for f in frequency])

    assert sensitivity(100.0)[1] == pytest.approx(27.0, abs=1.0)
    assert sensitivity(300.0).min() == pytest.approx(82.0, abs=1.0)
    assert sensitivity(300.0).max() == pytest.approx(108.0, abs=1.0)


def test_every_row_is_read_within_its_interval(table: list[ModalReading], unweighted: Calibration) -> None:
    """18 rows at 95 %: one miss is expected, three or more happen once in 17 times."""
    answers = [(r.conditions.preload or 0.0, estimate_preload(r.estimate, r.conditions, unweighted)) for r in table]
    assert sum(not (isinstance(a, PreloadEstimate) and a.interval.covers(p)) for p, a in answers) <= 2


def test_reading_of_the_docstring(unweighted: Calibration) -> None:
    answer = estimate_preload(Estimate(178.724, 0.36 / 20**0.5, 19), Conditions(0.5), unweighted)
    assert isinstance(answer, PreloadEstimate)
    assert (answer.preload, answer.interval.lower, answer.interval.upper) == pytest.approx((220, 184, 266), abs=1)


def test_mean_of_20_readings_alone_gives_15_to_26_newtons_at_300(table: list[ModalReading]) -> None:
    """The paper's Eq. (10) in newtons; its Fig. 8 shows bands of this size."""
    half = [
        stats.t.ppf(0.975, 19)
        * r.estimate.standard_uncertainty
        * preload_sensitivity(
            r.frequency, 300.0, PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
        )
        for r in table
        if r.conditions.preload == 300.0
    ]
    assert (min(half), max(half)) == pytest.approx((15.0, 26.0), abs=1.0)


# --- errata -----------------------------------------------------------------------------------------------------------


def test_printed_regressed_coefficients_miss_table_2_by_one_and_a_half_hertz(table: list[ModalReading]) -> None:
    error = misfit(table, PRINTED_REGRESSED)
    assert rms(error) == pytest.approx(1.49, abs=0.005)
    assert np.abs(error).max() == pytest.approx(2.85, abs=0.005)


def lumped_parameters(parameters: dict[str, float], bracket_stiffness: float) -> LumpedParameters:
    """Table 1, with a bracket stiffness [N/m] and the shear modulus that the paper does not give."""
    return LumpedParameters(
        table_mass=parameters["m_table"],
        screw_mass=parameters["m_screw"],
        nut_mass=parameters["m_nut"],
        screw_inertia=parameters["J_s"],
        screw_length=parameters["L"],
        screw_minor_diameter=parameters["d_minor"],
        screw_lead=parameters["l"],
        youngs_modulus=parameters["E"],
        shear_modulus=SHEAR_MODULUS,
        bearing_stiffness=parameters["k_bearing"],
        bracket_stiffness=bracket_stiffness,
        nut_stiffness=parameters["K"],
        dynamic_load_rating=10.0 * parameters["0.1 C_d"],
        coupling_stiffness=parameters["k_coupling"],
    )


def lumped_coefficients(parameters: dict[str, float], bracket_stiffness: float) -> FloatArray:
    """k1…k4 from Table 1 through Eqs. (1)–(6), with Eq. (3) read as k_rot = π d⁴ G L / (32 x (L − x))."""
    return np.array(astuple(feature_coefficients(lumped_parameters(parameters, bracket_stiffness))))


def test_printed_calculated_coefficients_do_not_follow_from_table_1(parameters: dict[str, float]) -> None:
    k = lumped_coefficients(parameters, parameters["k_bracket"]) * 1e8
    assert k == pytest.approx([-130.0, 2094.0, 1846.0, 5530.0], abs=1.0)
    printed = np.array([getattr(PRINTED_CALCULATED, name) for name in ("k1", "k2", "k3", "k4")]) * 1e8
    assert np.all(np.abs(k / printed - 1.0) > 0.1)


def test_printed_bracket_stiffness_is_too_low_by_ten(table: list[ModalReading], parameters: dict[str, float]) -> None:
    printed, tenfold = (PreloadFeatureCoefficients(*lumped_coefficients(parameters, k)) for k in (2.1e7, 2.1e8))
    low = axial_frequency(np.array([0.75, 0.25]), np.array([50.0, 300.0]), printed)
    assert low == pytest.approx([115.0, 126.0], abs=1.0)  # measured: 173 to 197 Hz
    assert rms(misfit(table, printed)) == pytest.approx(63.3, abs=0.1)
    assert rms(misfit(table, tenfold)) == pytest.approx(9.6, abs=0.1)


def test_lumped_model_falls_with_position_where_the_axis_rises_again(
    table: list[ModalReading], parameters: dict[str, float]
) -> None:
    model = PreloadFeatureCoefficients(*lumped_coefficients(parameters, 2.1e8))
    assert np.all(np.diff(axial_frequency(np.linspace(0.1, 0.95, 50), 200.0, model)) < 0.0)
    at = {(r.conditions.position, r.conditions.preload): r.frequency for r in table}
    assert all(at[0.75, p] > at[0.5, p] for p in (50.0, 100.0, 150.0, 200.0, 250.0, 300.0))


def test_eq_10_needs_t_of_19_degrees_of_freedom() -> None:
    assert stats.t.ppf(0.975, 19) == pytest.approx(2.093, abs=5e-4)
    assert stats.t.ppf(0.975, 20) == pytest.approx(2.086, abs=5e-4)  # the printed one


def test_masses_under_eq_7_are_exchanged(parameters: dict[str, float]) -> None:
    """A steel bar of the screw's length weighs 1.77 kg at the minor, 2.39 kg at the outer diameter."""
    bars = [7850.0 * parameters["L"] * np.pi / 4.0 * parameters[d] ** 2 for d in ("d_minor", "d")]
    assert bars[0] < parameters["m_screw"] < bars[1]
    assert not bars[0] < parameters["m_nut"] < bars[1]


def test_eq_3_as_printed_has_no_dimension_of_stiffness(parameters: dict[str, float]) -> None:
    """The equals sign stands before d⁴G: left of it is 1/m. Moved, a shaft held at both ends: GJ/x + GJ/(L − x)."""
    x, length, d = 0.3, parameters["L"], parameters["d_minor"]
    polar = np.pi * d**4 / 32.0
    both_ends = SHEAR_MODULUS * polar * (1.0 / x + 1.0 / (length - x))
    model = lumped_parameters(parameters, parameters["k_bracket"])
    assert shaft_torsional_stiffness(model, x) == pytest.approx(both_ends, rel=1e-12)


def test_feature_is_not_proportional_to_preload(unweighted: Calibration) -> None:
    """P², the inverse of the feature, doubles only when the preload grows eightfold."""
    k = unweighted.coefficients
    p_squared = [1.0 / preload_feature(axial_frequency(0.5, p, k), 0.5, k) for p in (40.0, 320.0)]
    assert p_squared[1] / p_squared[0] == pytest.approx(2.0, rel=1e-9)


def test_bolt_torque_under_eq_9_is_ten_times_too_high() -> None:
    """T = λ F d with λ = 0.2, M4 and 50 N at each of two bolts is 4 N·cm, not 4 kgf·cm."""
    torque = PositioningBolts(0.004, 2, 0.2).torque(100.0)  # [N·m]
    assert torque == pytest.approx(0.2 * 50.0 * 0.004, rel=1e-12)
    kilogram_force_centimetre = 9.80665e-2  # [N·m]
    assert 4.0 * kilogram_force_centimetre / torque == pytest.approx(9.8, abs=0.05)
