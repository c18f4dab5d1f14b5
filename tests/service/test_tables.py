"""Every list is a table as well: the same records, in bounded memory, safe to open in a spreadsheet."""

import asyncio
import io
import json
import re
import sys
import time
import tracemalloc
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from fastapi import FastAPI, Query
from pydantic import BaseModel

from service.api.http.tables import export, writers
from service.api.http.tables.columns import Column, Kind
from service.api.http.tables.export import Tables
from service.api.http.tables.lists import ListRoute, list_routes
from service.api.http.tables.writers import CsvWriter
from service.clock import text_of
from service.store.database import Database
from service.store.tables import AlarmEventRow, AlarmRow
from tests.service.conftest import START, Api, assert_problem, simulated_measurement

SESSION = Path(__file__).resolve().parents[2] / "replay_data" / "bad-windows.session.h5"
#: Written out: a list that is not among them is one whose description does not say that it is a list.
LISTS = {
    "/v1/advice", "/v1/alarms", "/v1/audit", "/v1/axes", "/v1/axes/{axis}/calibration-plan",
    "/v1/axes/{axis}/calibrations", "/v1/axes/{axis}/history", "/v1/axes/{axis}/maintenance",
    "/v1/axes/{axis}/measurements/{measurement}/evidence", "/v1/axes/{axis}/pins", "/v1/axes/{axis}/projection",
    "/v1/axes/{axis}/recordings", "/v1/axes/{axis}/trend", "/v1/drive-model", "/v1/jobs", "/v1/machines",
    "/v1/receivers", "/v1/retention", "/v1/sessions",
}  # fmt: skip


EVIDENCE = {
    "sentence": 'a "quoted", -1.5', "at": "2026-03-08T06:00:00Z", "onset": "2026-03-07T06:00:00Z",
    "interval": [-9.0, 9.0], "preload_loss_n": 301.5, "baseline_preload_n": 300.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def filled(shared_api: Api) -> Api:
    """Fill a service with something of each kind."""
    shared_api.register("mill", axis_type="=1+1")
    shared_api.calibrate("mill")
    rng = np.random.default_rng(5)
    for number in range(7):
        windows = simulated_measurement(rng, f"@m{number}", started_at=START.replace(day=2 + number), n_windows=3)
        shared_api.accept("mill", windows, complete=True)
    with SESSION.open("rb") as file:
        shared_api.http.post("/v1/axes/mill/recordings", files={"file": file}).raise_for_status()
    while shared_api.http.get("/v1/jobs").json()["jobs"][0]["status"] != "done":
        time.sleep(0.05)
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


def routes(api: Api) -> dict[str, ListRoute]:
    return list_routes(api.http.get("/openapi.json").json())


def read_csv(content: bytes, columns: tuple[Column, ...]) -> list[dict[str, str | None]]:
    """Read a table by another library, which tells an empty cell from an empty text."""
    kinds = {column.name: pa.string() for column in columns}
    options = pyarrow.csv.ConvertOptions(
        column_types=kinds, strings_can_be_null=True, quoted_strings_can_be_null=False, null_values=[""]
    )
    parsing = pyarrow.csv.ParseOptions(newlines_in_values=True)
    return pyarrow.csv.read_csv(io.BytesIO(content), convert_options=options, parse_options=parsing).to_pylist()


def value_of(cell: Any, kind: Kind) -> Any:
    """Undo what was written, by the documented rules."""
    if isinstance(cell, datetime):
        return text_of(cell)
    if not isinstance(cell, str):
        return json.loads(cell) if kind is Kind.DOCUMENT and cell is not None else cell
    if kind in (Kind.TEXT, Kind.MOMENT):
        return cell
    return json.loads(cell)


def unmarked(cell: str | None) -> str | None:
    return cell[1:] if cell is not None and re.match(r"'+[=+\-@\t\r]", cell) else cell


#: Records that may be missing: then each of their columns is empty.
OPTIONAL: dict[str, dict[str, Any]] = {
    "preload_left": {"share": None, "interval_95": None},
    "stale": {"job": None, "calibration": None},
}


def flat(record: Any, prefix: str = "") -> dict[str, Any]:
    """Flatten a record of JSON by hand, as far as a table does: nested records and pairs."""
    if not isinstance(record, dict):
        return {prefix: record}
    found: dict[str, Any] = {}
    for name, value in record.items():
        path = f"{prefix}{name}"
        nested = OPTIONAL.get(name) if value is None else value
        if isinstance(nested, dict) and name in ("configuration", "job", *OPTIONAL):
            found |= flat(nested, f"{path}.")
        elif name in ("interval_95", "interval_95_n", "search_band_hz"):
            lower, upper = value or (None, None)
            found |= {f"{path}.lower": lower, f"{path}.upper": upper}
        else:
            found[path] = value
    return found


def whole(api: Api, path: str, name: str, most: int | None) -> list[Any]:
    """Return all records of a list, page by page."""
    records, cursor = [], None
    while True:
        query = ({} if most is None else {"limit": 2}) | ({} if cursor is None else {"cursor": cursor})
        answer = api.http.get(path, params=query).raise_for_status().json()
        records += answer[name]
        cursor = answer.get("next_cursor")
        if cursor is None:
            return records


def test_every_list_is_offered_in_both_formats(filled: Api) -> None:
    document = filled.http.get("/openapi.json").json()
    assert set(list_routes(document)) == LISTS
    for path, item in document["paths"].items():
        content = item.get("get", {}).get("responses", {}).get("200", {}).get("content", {})
        reference = content.get("application/json", {}).get("schema", {}).get("$ref", "").rpartition("/")[2]
        members = document["components"]["schemas"].get(reference, {}).get("properties", {})
        is_list = any(member.get("type") == "array" for member in members.values()) and not path.endswith("}")
        assert is_list == ({"text/csv", "application/vnd.apache.parquet"} <= set(content)), path
        assert is_list <= ("format" in {each["name"] for each in item.get("get", {}).get("parameters", ())})


@pytest.mark.parametrize("template", sorted(LISTS))
def test_a_table_holds_what_the_json_holds(filled: Api, template: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "ROWS_OF_PAGE", 2)  # several pages, and several groups of rows
    monkeypatch.setattr(writers, "ROWS_OF_GROUP", 3)
    path, route = template.replace("{axis}", "mill").replace("{measurement}", "1"), routes(filled)[template]
    for name, columns in route.lists.items():
        kinds = {column.name: column.kind for column in columns}
        answers = {
            kind: filled.http.get(path, params={"format": kind, "list": name}) for kind in ("csv", "parquet")
        }  # of the log, before anything else is asked for
        expected = [flat(record, "" if isinstance(record, dict) else name) for record in whole(
            filled, path, name, route.most)]  # fmt: skip
        assert answers["csv"].headers["content-type"] == "text/csv; charset=utf-8"
        assert answers["csv"].headers["content-disposition"].startswith("attachment; filename=")
        rows = read_csv(answers["csv"].content, columns)
        assert [{k: value_of(unmarked(v), kinds[k]) for k, v in row.items()} for row in rows] == expected
        table = pq.read_table(io.BytesIO(answers["parquet"].content))
        assert table.column_names == [column.name for column in columns]
        assert [{k: value_of(v, kinds[k]) for k, v in row.items()} for row in table.to_pylist()] == expected
    if template in ("/v1/axes/{axis}/trend", "/v1/alarms", "/v1/audit"):
        assert len(table) > 2


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


@pytest.mark.parametrize(
    ("query", "status", "name", "sentence"),
    [
        ({"format": "xml"}, 422, "invalid-request", "format must be csv or parquet; got 'xml'"),
        ({"format": "csv", "list": "no"}, 422, "invalid-request", "list must be calibrations or history; got 'no'"),
        ({"format": "csv"}, 404, "unknown-resource", "nobody"),
    ],
)
def test_a_refusal_is_one_sentence(filled: Api, query: dict[str, str], status: int, name: str, sentence: str) -> None:
    axis = "nobody" if status == 404 else "mill"
    answer = filled.http.get(f"/v1/axes/{axis}/calibrations", params=query)
    assert sentence in assert_problem(answer, status, name)["detail"]


def test_without_pyarrow_parquet_is_refused_and_csv_is_not(filled: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    answer = filled.http.get("/v1/axes", params={"format": "parquet"})
    assert "ask for format=csv" in assert_problem(answer, 406, "not-acceptable")["detail"]
    assert filled.http.get("/v1/axes", params={"format": "csv"}).status_code == 200


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        ("=1+1", "\"'=1+1\""), ("+1", "\"'+1\""), ("-1", "\"'-1\""), ("@x", "\"'@x\""), ("\tx", "\"'\tx\""),
        ("'=1", "\"''=1\""), ("'x", "\"'x\""), ('a "b", c', '"a ""b"", c"'), ("", '""'), (None, ""), (-1.5, "-1.5"),
        (True, "true"), (7, "7"), ([1, "a"], '"[1,""a""]"'),
    ],
)  # fmt: skip
def test_text_is_not_computed_by_a_spreadsheet_and_numbers_are_numbers(value: object, cell: str) -> None:
    column = Column("x", ("x",), Kind.TEXT)
    assert CsvWriter([column]).add([{"x": value}]).decode() == f"{cell}\r\n"


class NumberOut(BaseModel):
    number: int
    name: str


class NumbersOut(BaseModel):
    numbers: list[NumberOut]
    next_cursor: int | None


def counting(n_rows: int) -> FastAPI:
    """Return an application with one long list."""
    app = FastAPI()

    @app.get("/v1/numbers")
    def numbers(cursor: int = 0, limit: Annotated[int, Query(le=1000)] = 50) -> NumbersOut:
        end = min(cursor + limit, n_rows)
        found = [NumberOut(number=number, name=f"number {number}") for number in range(cursor, end)]
        return NumbersOut(numbers=found, next_cursor=None if end == n_rows else end)

    app.add_middleware(Tables)
    return app


def peak_of(n_rows: int, kind: str, allocated: Callable[[], int]) -> tuple[int, int]:
    """Return how many bytes were sent, and the most that was allocated meanwhile."""
    app, sent, peak = counting(n_rows), 0, 0

    async def read() -> None:
        nonlocal sent, peak
        scope = {"type": "http", "method": "GET", "path": "/v1/numbers", "query_string": f"format={kind}".encode(),
                 "headers": [], "http_version": "1.1", "scheme": "http", "server": ("x", 80), "root_path": "",
                 "asgi": {"version": "3.0", "spec_version": "2.4"}, "client": ("127.0.0.1", 1)}  # fmt: skip

        async def never() -> dict[str, str]:
            await asyncio.sleep(3600)
            return {"type": "http.disconnect"}

        async def send(message: Any) -> None:
            nonlocal sent, peak
            sent += len(message.get("body", b""))
            peak = max(peak, allocated())

        await app(scope, never, send)

    asyncio.run(read())
    return sent, peak


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
