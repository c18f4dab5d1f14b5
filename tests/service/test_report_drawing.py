"""Drawing and rounding of reports: peaks and gaps stay, axes hold the data, a value has the digits it warrants."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, strategies as st

from monitor_core.discrepancy.explanation import Outcome
from service.report.charts import POINTS
from service.report.rounding import quantity, with_uncertainty
from service.report.svg import Axis, axis_over, decimated
from tests.service.explanation_examples import EXAMPLES, number_in, page_of


def test_decimation_keeps_peaks_and_gaps() -> None:
    values = np.sin(np.linspace(0.0, 40.0, 20_000))
    values[7_001], values[12_345], values[15_000:16_000] = 9.0, -9.0, np.nan
    kept = decimated(values, POINTS)
    assert kept.size <= POINTS
    assert np.all(np.diff(kept) > 0)
    assert {7_001, 12_345} <= set(kept.tolist())
    assert np.isnan(values[kept]).any()


def test_no_line_has_more_points_than_are_worth_drawing() -> None:
    paths = [str(path["d"]) for path in page_of(EXAMPLES[Outcome.NAMED]).all("path")]
    assert max(len(re.findall("[ML]", path)) for path in paths) <= POINTS
    assert any(path.count("M") > 1 for path in paths)  # the gap in the data is not drawn over


def test_logarithmic_axis_puts_the_geometric_mean_in_the_middle() -> None:
    axis = Axis(0.01, 100.0, 200.0, 0.0, logarithmic=True)
    np.testing.assert_allclose(axis(np.array([0.01, 1.0, 100.0])), [200.0, 100.0, 0.0])
    assert np.isnan(axis(0.0))
    np.testing.assert_allclose(axis.ticks(5), [0.01, 0.1, 1.0, 10.0, 100.0])


@given(lower=st.floats(-1e9, 1e9), width=st.floats(1e-6, 1e9), logarithmic=st.booleans())
def test_axis_holds_the_data_and_has_ticks(lower, width, logarithmic) -> None:
    values = np.array([lower, lower + width, math.nan, math.inf])
    if logarithmic:
        values = np.abs(values) + 1e-9
    axis = axis_over(values, 0.0, 300.0, logarithmic=logarithmic)
    places = axis(values[:2])
    assert np.all((places >= 0.0) & (places <= 300.0))
    assert all(
        axis.lower <= tick * (1 + 1e-9) and tick <= axis.upper * (1 + 1e-9) for tick in axis.ticks(5) if tick > 0
    )
    assert len(axis.ticks(5)) <= 20


@pytest.mark.parametrize(
    ("value", "uncertainty", "shown"),
    [
        (3.8e7, 1.0e6, "(38.0 ± 1.0) × 10⁶"),
        (183.2741, 6.04, "183.3 ± 6.0"),
        (-13.6, 0.4, "−13.60 ± 0.40"),
        (4.3e-10, 2.2e-11, "(430 ± 22) × 10⁻¹²"),
        (1.0, math.inf, "1.00 (uncertainty not known)"),
    ],
)
def test_a_value_has_the_digits_that_its_uncertainty_warrants(value, uncertainty, shown) -> None:
    assert with_uncertainty(value, uncertainty) == shown


@given(value=st.floats(1e-12, 1e12), relative=st.floats(1e-4, 10.0), negative=st.booleans())
def test_rounding_stays_within_a_twentieth_of_the_uncertainty(value, relative, negative) -> None:
    value = -value if negative else value
    uncertainty = abs(value) * relative
    shown = with_uncertainty(value, uncertainty)
    assert number_in(shown) == pytest.approx(value, abs=0.0501 * uncertainty)


def test_units_are_shown_as_people_write_them() -> None:
    assert [quantity(1.5, unit) for unit in ("sigma", "%", "Hz", "-")] == ["1.50 σ", "1.50 %", "1.50 Hz", "1.50"]
