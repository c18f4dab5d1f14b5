"""Trend, alarms and log are tables as well: the same records, in bounded memory, safe to open in a spreadsheet."""

import asyncio
import io
import json
import re
import sys
import tracemalloc
from collections.abc import Callable
from datetime import datetime
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from pydantic import BaseModel

from service.api.alarms import AlarmOut
from service.api.http import tables
from service.api.http.tables import Column, TableQuery, columns_of, table
from service.api.lost_motion import LostMotionPointOut
from service.api.system import AuditEntryOut
from service.api.trend_points import TrendPointOut
from service.clock import text_of
from service.store.database import Database
from service.store.tables import AlarmEventRow, AlarmRow
from tests.service.conftest import START, Api, assert_problem, simulated_measurement
from tests.service.test_lost_motion import reading
from tests.service.uploads import session_bytes, uploaded

#: With the name of the list in JSON and the class of its records; windows have a format of their own.
LISTS = {
    "/v1/axes/{axis}/trend": ("points", TrendPointOut),
    "/v1/axes/{axis}/lost-motion": ("points", LostMotionPointOut),
    "/v1/alarms": ("alarms", AlarmOut),
    "/v1/audit": ("entries", AuditEntryOut),
}


EVIDENCE = {
    "sentence": 'a "quoted", -1.5', "at": "2026-03-08T06:00:00Z", "onset": "2026-03-07T06:00:00Z",
    "interval": [-9.0, 9.0], "preload_loss_n": 301.5, "baseline_preload_n": 300.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def filled(shared_api: Api, tmp_path_factory: pytest.TempPathFactory) -> Api:
    """Fill a service with something of each kind."""
    shared_api.register("mill", axis_type="=1+1")
    shared_api.calibrate("mill")
    rng = np.random.default_rng(5)
    for number in range(7):
        windows = simulated_measurement(rng, f"@m{number}", started_at=START.replace(day=2 + number), n_windows=3)
        shared_api.accept("mill", windows, complete=True)
    lost = [reading(rng, number, measurement="=1") for number in range(7)]
    shared_api.http.post("/v1/axes/mill/lost-motion", json={"readings": lost}).raise_for_status()
    windows = simulated_measurement(rng, "recorded", started_at=START.replace(year=2025), n_windows=3)
    session = session_bytes(tmp_path_factory.mktemp("recorded"), windows)
    uploaded(shared_api, ("mill.session.h5", session), axis="mill")
    database = Database(f"sqlite:///{shared_api.data_dir / 'preload.db'}")
    with database.write() as session:
        measurement = shared_api.trend("mill")[0]["measurement_id"]
        for number in range(3):
            alarm = AlarmRow(
                axis_id="mill", measurement_id=measurement, kind="preload-loss", raised_at=START, status="active",
                epoch=0, measured_at=START,
                evidence=EVIDENCE | {"preload_n": -1.5 + number},
                explanation={"examined": False, "reason": "no-drive-model", "sentence": "none", "recent": None},
            )  # fmt: skip
            session.add(alarm)
            session.flush()
            session.add(AlarmEventRow(alarm_id=alarm.id, at=START, old_status=None, new_status="active", reason="=x"))
    database.close()
    return shared_api


def read_csv(content: bytes, columns: list[Column]) -> list[dict[str, str | None]]:
    """Read a table by another library, which tells an empty cell from an empty text."""
    kinds = {column.name: pa.string() for column in columns}
    options = pyarrow.csv.ConvertOptions(
        column_types=kinds, strings_can_be_null=True, quoted_strings_can_be_null=False, null_values=[""]
    )
    parsing = pyarrow.csv.ParseOptions(newlines_in_values=True)
    return pyarrow.csv.read_csv(io.BytesIO(content), convert_options=options, parse_options=parsing).to_pylist()


def value_of(cell: Any, kind: type) -> Any:
    """Undo what was written, by the documented rules."""
    if isinstance(cell, datetime):
        return text_of(cell)
    if not isinstance(cell, str):
        return json.loads(cell) if kind is dict and cell is not None else cell
    if kind in (str, datetime):
        return cell
    return json.loads(cell)


def unmarked(cell: str | None) -> str | None:
    return cell[1:] if cell is not None and re.match(r"'+[=+\-@\t\r]", cell) else cell


def flat(record: dict[str, Any]) -> dict[str, Any]:
    """Flatten a record of JSON by hand."""
    cells: dict[str, Any] = {}
    for name, value in record.items():
        if "interval_95" in name:
            lower, upper = value or (None, None)
            cells |= {f"{name}.lower": lower, f"{name}.upper": upper}
        else:
            cells[name] = value
    return cells


def whole(api: Api, path: str, name: str) -> list[Any]:
    """Return all records of a list, page by page."""
    records, cursor = [], None
    while True:
        query = {"limit": 2} | ({} if cursor is None else {"cursor": cursor})
        answer = api.http.get(path, params=query).raise_for_status().json()
        records += answer[name]
        cursor = answer["next_cursor"]
        if cursor is None:
            return records


def test_the_lists_that_are_tables_say_so(filled: Api) -> None:
    document = filled.http.get("/openapi.json").json()
    offered = {
        path
        for path, item in document["paths"].items()
        if "application/vnd.apache.parquet"
        in item.get("get", {}).get("responses", {}).get("200", {}).get("content", {})
    }
    assert offered == set(LISTS)
    for path in offered:
        get = document["paths"][path]["get"]
        assert "format" in {each["name"] for each in get["parameters"]}
        assert set(get["responses"]["200"]["content"]) >= {"application/json", "text/csv"}


@pytest.mark.parametrize("template", sorted(LISTS))
def test_a_table_holds_what_the_json_holds(filled: Api, template: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "ROWS_OF_PAGE", 2)  # several pages, and several groups of rows
    monkeypatch.setattr(tables, "ROWS_OF_GROUP", 3)
    path, (name, record) = template.replace("{axis}", "mill"), LISTS[template]
    columns = columns_of(record)
    kinds = {column.name: column.type for column in columns}
    answers = {kind: filled.http.get(path, params={"format": kind}) for kind in ("csv", "parquet")}
    expected = [flat(each) for each in whole(filled, path, name)]
    assert len(expected) > 2
    assert answers["csv"].headers["content-type"] == "text/csv; charset=utf-8"
    assert answers["csv"].headers["content-disposition"].startswith("attachment; filename=")
    rows = read_csv(answers["csv"].content, columns)
    assert [{k: value_of(unmarked(v), kinds[k]) for k, v in row.items()} for row in rows] == expected
    parquet = pq.read_table(io.BytesIO(answers["parquet"].content))
    assert parquet.column_names == [column.name for column in columns]
    assert [{k: value_of(v, kinds[k]) for k, v in row.items()} for row in parquet.to_pylist()] == expected


def test_a_trend_has_moments_numbers_and_units(filled: Api) -> None:
    answer = filled.http.get("/v1/axes/mill/trend", params={"format": "parquet"})
    schema = pq.read_schema(io.BytesIO(answer.content))
    assert schema.field("at").type == pa.timestamp("us", "UTC")
    assert schema.field("interval_95_n.lower").type == pa.float64()
    assert answer.headers["content-disposition"] == 'attachment; filename="mill-trend.parquet"'
    assert "content-encoding" not in answer.headers
    first = filled.http.get(
        "/v1/axes/mill/trend", params={"format": "csv", "from": "2026-01-01T00:00:00Z"}
    ).text.splitlines()
    assert first[0].startswith('"measurement_id","measurement","at","position_mm"')
    assert '"2026-03-02T06:00:00Z"' in first[1]


def test_what_a_page_is_asked_for_is_that_page(filled: Api) -> None:
    span = {"from": "2026-01-01T00:00:00Z"}
    page = filled.http.get("/v1/axes/mill/trend", params={"limit": 2, **span}).json()
    for query, rows in (({"limit": 2}, 2), ({"cursor": page["next_cursor"]}, 5), ({"order": "newest-first"}, 7)):
        text = filled.http.get("/v1/axes/mill/trend", params={**query, **span, "format": "csv"}).text
        assert text.count("\r\n") == 1 + rows


def test_a_table_is_no_page_of_json_that_is_known(filled: Api) -> None:
    tag = filled.http.get("/v1/axes/mill/trend").headers["etag"]
    answer = filled.http.get("/v1/axes/mill/trend", params={"format": "csv"}, headers={"if-none-match": tag})
    assert answer.status_code == 200
    assert "etag" not in answer.headers


def test_a_refusal_is_one_sentence(filled: Api) -> None:
    answer = filled.http.get("/v1/axes/mill/trend", params={"format": "xml"})
    assert "/query/format: Input should be 'csv' or 'parquet'; got 'xml'" in assert_problem(
        answer, 422, "invalid-request"
    )["detail"]  # fmt: skip
    answer = filled.http.get("/v1/axes/nobody/trend", params={"format": "csv"})
    assert "nobody" in assert_problem(answer, 404, "unknown-resource")["detail"]


def test_without_pyarrow_parquet_is_refused_and_csv_is_not(filled: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    answer = filled.http.get("/v1/alarms", params={"format": "parquet"})
    assert "ask for format=csv" in assert_problem(answer, 406, "not-acceptable")["detail"]
    assert filled.http.get("/v1/alarms", params={"format": "csv"}).status_code == 200


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=1+1", "\"'=1+1\""), ("+1", "\"'+1\""), ("-1", "\"'-1\""), ("@x", "\"'@x\""), ("\tx", "\"'\tx\""),
        ("'=1", "\"''=1\""), ("'x", "\"'x\""), ('a "b", c', '"a ""b"", c"'), ("", '""'), (None, ""), (-1.5, "-1.5"),
        (True, "true"), (7, "7"), ([1, "a"], '"[1,""a""]"'),
    ],
)  # fmt: skip
def test_text_is_not_computed_by_a_spreadsheet_and_numbers_are_numbers(value: object, cell: str) -> None:
    column = Column("x", "x", None, dict if isinstance(value, list) else str)
    assert tables._text(column.cell({"x": value})) == cell


class NumberOut(BaseModel):
    number: int
    name: str


class NumbersQuery(TableQuery):
    cursor: int = 0
    limit: int = 50


def peak_of(n_rows: int, kind: str, allocated: Callable[[], int]) -> tuple[int, int]:
    """Return how many bytes of one long list were sent, and the most that was allocated meanwhile."""

    def numbers(query: NumbersQuery) -> tuple[list[NumberOut], int | None]:
        end = min(query.cursor + query.limit, n_rows)
        records = [NumberOut(number=number, name=f"number {number}") for number in range(query.cursor, end)]
        return records, None if end == n_rows else end

    async def read() -> tuple[int, int]:
        sent = peak = 0
        async for part in table("numbers", NumberOut, NumbersQuery(format=kind), numbers).body_iterator:
            sent += len(part)
            peak = max(peak, allocated())
        return sent, peak

    return asyncio.run(read())


@pytest.mark.release
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_table_of_ten_times_the_rows_takes_the_same_memory(kind: str) -> None:
    peak_of(2_000, kind, lambda: 0)  # what is imported and remembered once
    peaks = {}
    for n_rows in (30_000, 300_000):
        tracemalloc.start()
        base = pa.total_allocated_bytes()
        sent, arrow = peak_of(n_rows, kind, lambda base=base: pa.total_allocated_bytes() - base)
        peaks[n_rows] = tracemalloc.get_traced_memory()[1] + arrow
        tracemalloc.stop()
        assert sent > 3 * n_rows
    assert peaks[300_000] < 1.2 * peaks[30_000] < 12e6, peaks
