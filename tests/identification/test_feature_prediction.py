"""k1…k4 predicted from joints: the closed form of the lumped model, propagated uncertainty, misfit, refusals."""

import csv
import math
import tomllib
from collections.abc import Mapping
from dataclasses import astuple, replace

import numpy as np
import pytest

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.identification.predicted_calibration import MonitoredMode, mode_frequencies, predict_coefficients
from monitor_core.models.ball_screw import nut_rigidity
from monitor_core.models.families import build_model
from monitor_core.models.published.lumped import LumpedModel, LumpedParameters, feature_coefficients
from monitor_core.models.published.receptance import ReceptanceModel
from monitor_core.preload import (
    CoefficientPrior,
    ModalReading,
    PreloadFeatureCoefficients,
    ValidRange,
    axial_frequency,
    calibrate,
)
from monitor_core.recording import Conditions
from monitor_core.uncertainty import Estimate, VectorEstimate
from tests.conftest import PROJECT_ROOT
from tests.identification import tian


def stated(family):
    text = (PROJECT_ROOT / "replay_data" / "models" / f"{family}.toml").read_text("utf-8")
    return tomllib.loads(text)["parameters"]


#: Nguyen's axis, Table 1 with ten times the printed bracket. The paper states no damping.
NGUYEN = LumpedParameters.from_file_names(
    {name: value for name, value in stated("lumped").items() if name != "loss_factor"}, "lumped"
)
MODE = MonitoredMode((120.0, 230.0), (0.25, 0.4, 0.5, 0.75), (50.0, 100.0, 200.0, 400.0))


def lumped_at(parameters, *free):
    """Model of the decimal logarithms of some of its parameters, and these coordinates."""

    def model(coordinates):
        return LumpedModel(replace(parameters, **{n: 10.0**x for n, x in zip(free, coordinates, strict=True)}))

    return model, np.log10([getattr(parameters, name) for name in free])


@pytest.mark.parametrize("payload", [0.0, 12.0])
def test_the_lumped_model_obeys_eq_8_so_its_closed_form_comes_out(payload):
    model, at = lumped_at(NGUYEN, "nut_stiffness")
    predicted = predict_coefficients(model, VectorEstimate(at, [[0.0]]), replace(MODE, payload_mass=payload))
    assert predicted.coefficients.values == pytest.approx(
        astuple(feature_coefficients(NGUYEN, payload)), rel=1e-9, abs=0.0
    )
    assert predicted.form_misfit_max < 1e-9  # [Hz]
    assert np.all(predicted.coefficients.covariance == 0.0)


def test_covariance_of_the_joints_is_carried_over_as_by_hand():
    """k3 is inverse to K; of k4 the bearing has the share 4π²Σm/k_bearing. Their errors are correlated by 0.6."""
    model, at = lumped_at(NGUYEN, "bearing_stiffness", "nut_stiffness")
    u_bearing, u_nut, rho = 0.02, 0.03, 0.6  # decades
    covariance = [[u_bearing**2, rho * u_bearing * u_nut], [rho * u_bearing * u_nut, u_nut**2]]
    predicted = predict_coefficients(model, VectorEstimate(at, covariance, 7.0), MODE).coefficients
    k = feature_coefficients(NGUYEN)
    u_k3 = math.log(10.0) * u_nut * k.k3
    u_k4 = math.log(10.0) * u_bearing * 4.0 * math.pi**2 * (20.54 + 2.024 + 1.3) / 100e6
    by_hand = np.zeros((4, 4))
    by_hand[2, 2], by_hand[3, 3], by_hand[2, 3], by_hand[3, 2] = u_k3**2, u_k4**2, rho * u_k3 * u_k4, rho * u_k3 * u_k4
    # a step of 0.003 decades leaves (0.003 ln 10)²/6 of the third derivative
    assert predicted.covariance == pytest.approx(by_hand, rel=1e-4, abs=1e-6 * u_k4**2)
    assert predicted.degrees_of_freedom == 7.0


def test_a_joint_that_is_hardly_known_is_carried_over_by_the_slope_where_it_stands():
    """Half a decade: a step of a tenth of that would read a slope 0.2 % too steep off 10^x."""
    model, at = lumped_at(NGUYEN, "nut_stiffness")
    predicted = predict_coefficients(model, VectorEstimate(at, [[0.5**2]]), MODE).coefficients
    by_hand = math.log(10.0) * 0.5 * feature_coefficients(NGUYEN).k3
    assert predicted.standard_uncertainties[2] == pytest.approx(by_hand, rel=2e-4)


def test_a_rigidity_known_at_one_preload_follows_it_like_the_catalogues():
    """The same nut by the rigidity it has at 200 N; P0 known to 15 % makes k3 uncertain by 5 %, and nothing else."""
    rigidity = nut_rigidity(NGUYEN.nut_stiffness, 200.0, NGUYEN.dynamic_load_rating)
    model, at = lumped_at(replace(NGUYEN, nut_stiffness=rigidity, dynamic_load_rating=None), "nut_stiffness")
    predicted = predict_coefficients(model, VectorEstimate(at, [[0.0]]), MODE, Estimate(200.0, 30.0)).coefficients
    k = feature_coefficients(NGUYEN)
    assert predicted.values == pytest.approx(astuple(k), rel=1e-9, abs=0.0)
    assert predicted.standard_uncertainties == pytest.approx([0.0, 0.0, 0.05 * k.k3, 0.0], rel=1e-4, abs=1e-6 * k.k3)


@pytest.mark.release
def test_stated_covariance_is_the_scatter_of_predictions_of_drawn_joints():
    """Sun's axis with a distributed screw, joints known to 5 and 7 %, P0 to 10 %; 600 draws know a variance to 6 %."""
    values = stated("hybrid")
    names = ("bearing_stiffness_n_per_m", "nut_stiffness_n_per_m")
    at = np.log10([values[name] for name in names])
    covariance = np.array([[0.02**2, -0.3 * 0.02 * 0.03], [-0.3 * 0.02 * 0.03, 0.03**2]])
    mode = MonitoredMode((200.0, 400.0), (0.1, 0.3, 0.5, 0.7), (500.0, 1000.0, 2000.0))

    def model(coordinates):
        drawn: Mapping[str, float] = dict(zip(names, (10.0**coordinates).tolist(), strict=True))
        return build_model("hybrid", {**values, **drawn})

    predicted = predict_coefficients(model, VectorEstimate(at, covariance), mode, Estimate(1000.0, 100.0))
    rng = np.random.default_rng(1)
    x, preload = np.array(mode.settings).T
    fit = np.linalg.pinv(np.column_stack([x**2, x, np.cbrt(1.0 / preload), np.ones_like(x)]))
    drawn = np.array([
        fit @ mode_frequencies(model(c), mode, 1000.0 * math.exp(rng.normal(0.0, 0.1))) ** -2.0
        for c in rng.multivariate_normal(at, covariance, size=600)
    ])  # fmt: skip
    assert np.sqrt(np.diag(np.cov(drawn.T))) == pytest.approx(predicted.coefficients.standard_uncertainties, rel=0.13)
    assert np.all(np.abs(drawn.mean(axis=0) - predicted.coefficients.values) < 4.0 * drawn.std(axis=0) / 20.0)


def test_misfit_of_the_form_bounds_what_eq_8_misses_of_a_distributed_screw_elsewhere():
    """Tian's axis at positions and preloads within the range that were not in the fit."""
    joints = tian.free(tian.axis(), "nut_stiffness")
    at = joints.start
    mode = MonitoredMode((90.0, 160.0), (0.5, 0.8, 1.1, 1.4, 1.7, 2.0), (1000.0, 3000.0))

    def model(coordinates):
        return ReceptanceModel(joints.record(coordinates))

    predicted = predict_coefficients(model, VectorEstimate(at, [[0.0]]), mode, Estimate(2000.0, 0.0))
    k = PreloadFeatureCoefficients(*predicted.coefficients.values.tolist())

    def missed(settings):
        eq_8 = np.array([axial_frequency(x, force, k) for x, force in settings.settings])
        return mode_frequencies(model(at), settings, 2000.0) - eq_8

    assert 1e-3 < predicted.form_misfit < 1e-2  # [Hz]: on this axis Eq. (8) is an approximation, and a good one
    assert np.sum(missed(mode) ** 2) == pytest.approx((12 - 4) * predicted.form_misfit**2, rel=1e-9, abs=0.0)
    elsewhere = replace(mode, positions=(0.65, 0.95, 1.25, 1.55, 1.85), preloads=(1500.0, 2500.0))
    assert np.max(np.abs(missed(elsewhere))) < predicted.form_misfit_max
    assert predicted.frequencies[2, 1] == mode_frequencies(model(at), mode, 2000.0)[5]


def test_a_prediction_becomes_a_prior():
    model, at = lumped_at(NGUYEN, "nut_stiffness")
    predicted = predict_coefficients(model, VectorEstimate(at, [[0.04**2]]), MODE)
    prior = CoefficientPrior(
        predicted.coefficients,
        math.hypot(predicted.form_misfit, 0.2),
        ValidRange(0.25, 0.75),
        ValidRange(50.0, 400.0),
        "model",
    )
    assert prior.spread @ prior.spread.T == pytest.approx(predicted.coefficients.covariance, rel=1e-6, abs=1e-20)


def test_nguyens_measurements_contradict_what_his_table_1_predicts(published_data):
    """The printed bracket is 60 Hz off. Ten times that meets the middle of the screw, but not both ends of it."""
    with (published_data / "nguyen_table2.csv").open(newline="", encoding="utf-8") as stream:
        rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(stream)]
    table = {
        (r["position_mm"], r["preload_n"]): ModalReading(
            r["frequency_hz"], Conditions(r["position_mm"] * 1e-3, preload=r["preload_n"])
        )
        for r in rows
    }

    def joined(bracket, share, *settings):
        free = ("bearing_stiffness", "bracket_stiffness", "nut_stiffness", "coupling_stiffness")
        model, at = lumped_at(replace(NGUYEN, bracket_stiffness=bracket), *free)
        covariance = np.eye(4) * math.log10(1.0 + share) ** 2
        predicted = predict_coefficients(model, VectorEstimate(at, covariance), replace(MODE, band=(60.0, 260.0)))
        prior = CoefficientPrior(
            predicted.coefficients, 0.5, ValidRange(0.25, 0.75), ValidRange(50.0, 400.0), "Table 1"
        )
        return calibrate(
            [table[setting] for setting in settings], weighting="none", excitation_source=None, prior=prior
        )

    middle, ends = (500.0, 200.0), ((250.0, 100.0), (750.0, 300.0))
    with pytest.raises(NotIdentifiableError, match="contradict the prior"):
        joined(2.1e7, 0.1, middle)
    assert joined(2.1e8, 0.2, middle).residual_max < 1.0  # [Hz]
    with pytest.raises(NotIdentifiableError, match="contradict the prior"):
        joined(2.1e8, 0.2, *ends)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"band": (10.0, 20.0)}, "got 0 within 10 and 20 Hz at 250 mm and 50 N"),
        ({"band": (150.0, 1e5)}, "got 2 within 150 and 100000 Hz at 250 mm"),
    ],
)
def test_a_band_without_exactly_one_mode_is_refused(change, sentence):
    model, at = lumped_at(NGUYEN, "nut_stiffness")
    with pytest.raises(OutsideValidityError, match=sentence):
        predict_coefficients(model, VectorEstimate(at, [[0.01]]), replace(MODE, **change))


def test_the_nut_must_follow_the_preload_in_one_way():
    model, at = lumped_at(NGUYEN, "nut_stiffness")
    unrated, _ = lumped_at(replace(NGUYEN, dynamic_load_rating=None), "nut_stiffness")
    with pytest.raises(OutsideValidityError, match="got both"):
        predict_coefficients(model, VectorEstimate(at, [[0.01]]), MODE, Estimate(200.0, 20.0))
    with pytest.raises(OutsideValidityError, match="got neither"):
        predict_coefficients(unrated, VectorEstimate(at, [[0.01]]), MODE)


@pytest.mark.parametrize(
    ("change", "error", "sentence"),
    [
        ({"positions": (0.25, 0.5, 0.5)}, NotIdentifiableError, "got 2 and 4"),
        ({"preloads": (100.0,)}, NotIdentifiableError, "got 4 and 1"),
        ({"preloads": (100.0, -5.0)}, OutsideValidityError, "preloads must be positive; got -5 N"),
        ({"band": (200.0, 100.0)}, OutsideValidityError, "must rise from above 0 Hz; got 200 to 100 Hz"),
    ],
)
def test_settings_that_cannot_determine_eq_8_are_refused(change, error, sentence):
    with pytest.raises(error, match=sentence):
        replace(MODE, **change)
