"""The ladder is the estimate step by step: terms add up to the feature and lead to the preload of the estimator."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from monitor_core.errors import OutsideValidityError
from monitor_core.preload import preload_from_feature, preload_ladder
from monitor_core.recording import Conditions
from tests.preload.test_estimate import calibration_of, estimated, true_frequency

CALIBRATION = calibration_of(np.random.default_rng(3), influences=((0.0, 20.0), (2.0, 20.0), (0.0, 30.0), (2.0, 30.0)))
UNITS = {"rel": 1e-12}


@given(
    position=st.floats(0.26, 0.74), preload=st.floats(60.0, 290.0), payload=st.floats(0.0, 2.0),
    temperature=st.floats(20.0, 30.0),
)  # fmt: skip
def test_terms_add_up_to_the_feature_and_lead_to_the_preload_of_the_estimator(
    position: float, preload: float, payload: float, temperature: float
) -> None:
    frequency = true_frequency(position, preload, payload, temperature)
    conditions = Conditions(position, payload, temperature)
    estimate = estimated(frequency, conditions, CALIBRATION)
    ladder = preload_ladder(frequency, conditions, CALIBRATION, feature=estimate.feature.value)
    terms = (ladder.payload, ladder.temperature, ladder.quadratic, ladder.linear, ladder.constant, ladder.friction)
    assert ladder.inverse_square - sum(terms) == pytest.approx(ladder.feature, **UNITS)
    assert ladder.preload == pytest.approx(estimate.preload, **UNITS)
    assert ladder.friction == pytest.approx(0.0, abs=1e-12 * ladder.inverse_square)  # no friction was witnessed
    assert preload_ladder(frequency, conditions, CALIBRATION).preload == pytest.approx(estimate.preload, rel=1e-9)


def test_a_term_vanishes_at_the_conditions_of_the_calibration() -> None:
    stated = Conditions(0.5, CALIBRATION.reference_payload, CALIBRATION.reference_temperature)
    ladder = preload_ladder(true_frequency(0.5, 200.0), stated, CALIBRATION)
    assert (ladder.payload, ladder.temperature) == (0.0, 0.0)
    k = CALIBRATION.coefficients
    assert ladder.position == pytest.approx(k.k1 * 0.25 + k.k2 * 0.5 + k.k4)


def test_what_the_estimate_took_off_for_friction_is_a_term() -> None:
    frequency, conditions = true_frequency(0.5, 200.0), Conditions(0.5)
    feature = estimated(frequency, conditions, CALIBRATION).feature.value
    ladder = preload_ladder(frequency, conditions, CALIBRATION, feature=0.95 * feature)
    assert ladder.friction == pytest.approx(0.05 * feature)
    assert ladder.preload == preload_from_feature(0.95 * feature, CALIBRATION.coefficients)


def test_a_frequency_above_what_any_preload_gives_has_no_ladder() -> None:
    with pytest.raises(OutsideValidityError):
        preload_ladder(400.0, Conditions(0.5), CALIBRATION)
