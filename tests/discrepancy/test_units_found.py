"""A channel in another unit is said to be that, and one that is a little off is not."""

import math

import pytest

from monitor_core.discrepancy.explanation import Outcome
from tests.discrepancy.test_explain import EFFECTS, explained, few, keys, with_hidden

WITH_UNIT = [*few(), EFFECTS["unit"]]


@pytest.mark.release
def test_a_response_in_g_is_named_with_its_unit() -> None:
    answer = explained(with_hidden({"unit": {"ln_factor": -math.log(9.80665)}}), candidates=WITH_UNIT)
    assert answer.outcome is Outcome.NAMED
    assert keys(answer) == ["unit"]
    (found,) = answer.effects
    assert found.parameters["ln_factor"].estimate.value == pytest.approx(-math.log(9.80665), abs=0.02)
    assert found.recorded_unit is not None
    assert "g" in found.recorded_unit.units


@pytest.mark.release
def test_a_response_that_is_ten_per_cent_off_is_in_no_other_unit() -> None:
    answer = explained(with_hidden({"unit": {"ln_factor": math.log(1.1)}}), candidates=WITH_UNIT)
    assert "unit" not in keys(answer)
    assert "unit" not in answer.added
