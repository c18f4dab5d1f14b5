"""Payload and temperature: the law f ∝ 1/√(M + m), its inverse and its derivatives."""

import pytest
from hypothesis import given, strategies as st

from monitor_core.errors import OutsideValidityError
from monitor_core.preload import InfluenceCoefficients
from monitor_core.preload.feature import correction_sensitivities, from_reference, payload_factor, to_reference

# Σm of Table 1 of Nguyen et al. (2018); temperature: 0.03 % of 1/f² per kelvin at 175 Hz
INFLUENCE = InfluenceCoefficients(inverse_moving_mass=1.0 / 23.864, temperature=1e-8)
AT_175_HZ = 175.0**-2


@given(payload=st.floats(-5.0, 50.0), temperature=st.floats(-30.0, 30.0))
def test_correction_undoes_the_influence(payload: float, temperature: float) -> None:
    measured = from_reference(AT_175_HZ, payload, temperature, INFLUENCE)
    assert to_reference(measured, payload, temperature, INFLUENCE) == pytest.approx(AT_175_HZ, rel=1e-13)


@given(payload=st.floats(0.0, 50.0))
def test_frequency_falls_with_the_root_of_the_mass(payload: float) -> None:
    frequency = float(from_reference(AT_175_HZ, payload, 0.0, INFLUENCE)) ** -0.5
    assert frequency * (23.864 + payload) ** 0.5 == pytest.approx(175.0 * 23.864**0.5, rel=1e-12)


@given(payload=st.floats(0.0, 20.0), temperature=st.floats(-20.0, 20.0))
def test_sensitivities_are_the_slopes_of_the_correction(payload: float, temperature: float) -> None:
    mu, k_t = INFLUENCE.inverse_moving_mass, INFLUENCE.temperature
    sensitivity = correction_sensitivities(AT_175_HZ, payload, temperature, INFLUENCE)

    def corrected(y: float = AT_175_HZ, mu: float = mu, k_t: float = k_t) -> float:
        return float(to_reference(y, payload, temperature, InfluenceCoefficients(mu, k_t)))

    h = 1e-4  # relative step: second-order error 1e-8, cancellation 1e-12
    assert sensitivity.inverse_square == pytest.approx(
        (corrected(y=AT_175_HZ * (1 + h)) - corrected(y=AT_175_HZ * (1 - h))) / (2 * h * AT_175_HZ), rel=1e-6
    )
    assert sensitivity.inverse_moving_mass == pytest.approx(
        (corrected(mu=mu * (1 + h)) - corrected(mu=mu * (1 - h))) / (2 * h * mu), rel=1e-6, abs=1e-12
    )
    assert sensitivity.temperature == pytest.approx(
        (corrected(k_t=k_t * (1 + h)) - corrected(k_t=k_t * (1 - h))) / (2 * h * k_t), rel=1e-6, abs=1e-6
    )


def test_a_payload_cannot_be_lighter_than_nothing() -> None:
    with pytest.raises(OutsideValidityError, match="moving mass"):
        payload_factor(-23.864, 1.0 / 23.864)
