"""Whatever form a trend is asked for in, it says the same."""

import math
from datetime import timedelta

import numpy as np
import pytest
from hypothesis import given, strategies as st

from service.api.trend_points import COLUMNS_TYPE, DIGITS, TrendOut, rounded
from service.documents.measurement import ends_of, interval_of
from service.store.trend.shown import ShownPoint, ToldColumns
from tests.service.conftest import START, Api, simulated_measurement

ALL = "/v1/axes/mill/trend"


@pytest.fixture(scope="module")
def measured(shared_api: Api) -> Api:
    """Serve an axis with judged and refused measurements, some at other places, one at a part of a second."""
    shared_api.register("mill", windows_per_measurement=2, minimum_averages=2)
    shared_api.register("empty")
    rng = np.random.default_rng(3)
    for number in range(9):
        if number == 1:
            shared_api.calibrate("mill")
        at = START + timedelta(days=number, microseconds=5 * (number % 2))
        windows = simulated_measurement(rng, f"m{number}", started_at=at, n_windows=2, position_mm=400.0 + number)
        shared_api.accept("mill", windows if number else windows[:1], complete=True)  # one window alone is refused
    return shared_api


def test_points_are_what_the_description_says(measured: Api) -> None:
    answer = measured.http.get(ALL).raise_for_status()
    assert TrendOut.model_validate_json(answer.text).model_dump_json() == answer.text
    points = answer.json()["points"]
    assert [point["status"] for point in points] == ["refused"] + ["judged"] * 8
    assert points[0]["interval_95_n"] is None
    assert points[1]["at"].endswith("05Z")
    assert points[2]["at"].endswith("00Z")


@pytest.mark.parametrize(
    "query", [{}, {"limit": 4}, {"order": "newest-first"}, {"resolution": 4}, {"only": "refused"}, {"max_points": 3}]
)
def test_columns_say_what_points_say(measured: Api, query: dict[str, str | int]) -> None:
    points = measured.http.get(ALL, params=query).raise_for_status().json()
    answer = measured.http.get(ALL, params=query | {"form": "columns"}).raise_for_status()
    assert answer.headers["content-type"] == COLUMNS_TYPE
    told = answer.json()
    columns = told.pop("columns")
    number = len(columns["measurement_id"])
    expanded = {name: values * number if len(values) == 1 else values for name, values in columns.items()}
    for interval in ("interval_95_n", "frequency_fall_interval_95_percent"):
        ends = zip(expanded.pop(f"{interval}.lower"), expanded.pop(f"{interval}.upper"), strict=True)
        expanded[interval] = [None if both == (None, None) else list(both) for both in ends]
    rows = [dict(zip(expanded, row, strict=True)) for row in zip(*expanded.values(), strict=True)]
    for row, point in zip(rows, points.pop("points"), strict=True):
        assert set(row) == set(point)
        for name, value in point.items():
            numeric = isinstance(value, float | list)
            assert row[name] == (pytest.approx(value, rel=0.5 * 10.0 ** (1 - DIGITS)) if numeric else value), name
    assert told == points


def test_an_axis_without_measurements_has_empty_columns(measured: Api) -> None:
    columns = measured.http.get("/v1/axes/empty/trend", params={"form": "columns"}).json()["columns"]
    assert set(columns) == set(measured.http.get(ALL, params={"form": "columns"}).json()["columns"])
    assert not any(columns.values())


def test_columns_have_a_tag_of_their_own(measured: Api) -> None:
    tags = {form: measured.http.get(ALL, params={"form": form}).headers["etag"] for form in ("points", "columns")}
    assert len(set(tags.values())) == 2
    for form, tag in tags.items():
        for asked in tags:
            answer = measured.http.get(ALL, params={"form": asked}, headers={"if-none-match": tag})
            assert answer.status_code == (304 if asked == form else 200)


@given(st.lists(st.none() | st.floats(allow_nan=False, allow_infinity=False), min_size=1))
def test_numbers_are_rounded_as_decimals_are_written(values: list[float | None]) -> None:
    for value, short in zip(values, rounded(values), strict=True):
        if value is None:
            assert math.isnan(short)
        else:
            assert short == pytest.approx(value, rel=0.51 * 10.0 ** (1 - DIGITS), abs=0.0)
            if 1e-12 < abs(value) < 1e8:
                assert float(f"{short:.{DIGITS}g}") == short


SCATTER = st.none() | st.floats(1e-9, 1e-7)


@given(
    st.lists(
        st.tuples(
            st.none() | st.floats(1.0, 1000.0), st.none() | st.floats(0.0, 400.0), st.none() | st.floats(400.0, 2e3),
            st.none() | st.floats(1e-6, 1e-5), SCATTER, SCATTER,
        ),
        min_size=1, max_size=8,
    )
)  # fmt: skip
def test_ends_of_many_are_those_of_each(drawn: list[tuple[float | None, ...]]) -> None:
    empty = ShownPoint(0, 1, "m", 0.0, *[None] * 13, "normal", *[None] * 9)  # type: ignore[arg-type]
    points = [
        empty._replace(
            preload_n=preload, interval_lower_n=lower, interval_upper_n=upper, feature_s2=feature,
            learnt_scatter_s2=learnt, shown_scatter_s2=budgeted,
        )
        for preload, lower, upper, feature, learnt, budgeted in drawn
    ]  # fmt: skip
    for ends, point in zip(zip(*ends_of(ToldColumns.of(points)), strict=True), points, strict=True):
        for end, alone in zip(ends, interval_of(point), strict=True):
            assert end is alone is None or end == pytest.approx(alone, rel=1e-12)
