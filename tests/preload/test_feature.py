"""Eq. (8) of Nguyen et al. (2018): independence of the position, and its three directions."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from monitor_core.errors import OutsideValidityError
from monitor_core.preload import (
    PreloadFeatureCoefficients,
    axial_frequency,
    preload_feature,
    preload_from_feature,
    preload_sensitivity,
)

K = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)
preloads, positions = st.floats(20.0, 400.0), st.floats(0.05, 0.95)


@given(preload=preloads, position=positions)
def test_feature_does_not_depend_on_position(preload: float, position: float) -> None:
    frequency = (K.k1 * position**2 + K.k2 * position + K.k3 * preload ** (-1 / 3) + K.k4) ** -0.5
    assert preload_feature(frequency, position, K) == pytest.approx(K.k3 * preload ** (-1 / 3), rel=1e-9)


@given(preload=preloads, position=positions)
def test_preload_comes_back_from_the_frequency_it_gives(preload: float, position: float) -> None:
    feature = preload_feature(axial_frequency(position, preload, K), position, K)
    # the third power and the difference of nearly equal 1/f² cost about four digits of sixteen
    assert preload_from_feature(feature, K) == pytest.approx(preload, rel=1e-11)


@given(preload=preloads, position=positions)
def test_sensitivity_is_the_slope_of_the_inverse(preload: float, position: float) -> None:
    step = 1e-3 * preload
    slope = 2.0 * step / (axial_frequency(position, preload + step, K) - axial_frequency(position, preload - step, K))
    frequency = axial_frequency(position, preload, K)
    # second-order error of the difference quotient: a few 1e-6 of the slope
    assert preload_sensitivity(frequency, preload, K) == pytest.approx(slope, rel=1e-5)


def test_feature_falls_as_preload_rises() -> None:
    feature = preload_feature(axial_frequency(0.5, np.linspace(20.0, 400.0, 50), K), 0.5, K)
    assert np.all(np.diff(feature) < 0.0)


def test_an_eighth_of_the_preload_doubles_the_feature() -> None:
    features = preload_feature(axial_frequency(0.5, np.array([320.0, 40.0]), K), 0.5, K)
    assert features[1] / features[0] == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("frequency", [0.0, -170.0, np.nan, np.inf])
def test_a_frequency_that_is_none_is_refused(frequency: float) -> None:
    with pytest.raises(OutsideValidityError, match="axial_frequency must be positive"):
        preload_feature(frequency, 0.5, K)


def test_no_preload_above_every_preload() -> None:
    with pytest.raises(OutsideValidityError, match="feature must be positive"):
        preload_from_feature(-1e-8, K)


def test_a_frequency_that_falls_with_preload_is_no_calibration() -> None:
    with pytest.raises(OutsideValidityError, match="k3 must be positive"):
        PreloadFeatureCoefficients(0.0, 0.0, -1e-5, 1e-5)
