"""Several services on one PostgreSQL, and everything that is said of an axis whichever of them is asked."""

import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import select, text

from monitor_core.recording import Window
from service.store.database import Database
from service.store.tables import AxisRow
from tests.service.arrivals import AXIS, WINDOWS_OF_MEASUREMENT, without
from tests.service.conftest import Api, running_service

#: What is sent away for so long is sent away for good.
PATIENCE_S = 30.0


class SentAwayForGoodError(AssertionError):
    """A window was answered with 503 until nobody would send it again."""


@contextmanager
def services(url: str, folder: Path, number: int, **settings: Any) -> Iterator[list[Api]]:
    """Run so many services on one database and one data folder, each in threads of its own."""
    with ExitStack() as stack:
        yield [stack.enter_context(running_service(folder, database_url=url, **settings)) for _ in range(number)]


def prepare(api: Api) -> None:
    """Register and calibrate an axis."""
    api.register(
        AXIS,
        windows_per_measurement=WINDOWS_OF_MEASUREMENT,
        minimum_averages=2,
        measurement_timeout_s=1e6,
        measurement_pause_s=600.0,
        baseline_size=5,
    )
    api.calibrate(AXIS)


def send(apis: Sequence[Api], windows: Sequence[Window], n_senders: int) -> list[int]:
    """Send windows one by one, from each sender to the next service with each; return every status that was answered.

    What is answered with 503 is sent again, as senders do. Raises SentAwayForGoodError if a window is still refused
    after ``PATIENCE_S``.
    """
    statuses: list[int] = []
    go = threading.Barrier(n_senders)

    def share(first: int) -> None:
        go.wait()
        for number, window in enumerate(windows[first::n_senders]):
            status, due = 503, time.monotonic() + PATIENCE_S
            while status == 503:
                if time.monotonic() > due:
                    raise SentAwayForGoodError(f"the window of {window.started_at} was sent away for {PATIENCE_S:g} s")
                status = apis[(first + number) % len(apis)].post(AXIS, [window]).status_code
                statuses.append(status)

    with ThreadPoolExecutor(n_senders) as pool:
        list(pool.map(share, range(n_senders)))
    apis[0].accept(AXIS, list(windows), complete=True)  # what has too few windows is judged with what it has
    return statuses


def said(api: Api, url: str) -> object:
    """Return everything that is said and known of the axis, but for what says who was first."""
    trend = api.trend(AXIS)
    found: dict[str, object] = {
        "axis": api.axis(AXIS),
        "trend": trend,
        "few": api.trend(AXIS, resolution=6),
        "measurements": [
            api.http.get(f"/v1/axes/{AXIS}/measurements/{point['measurement_id']}").json() for point in trend
        ],
        "alarms": api.http.get("/v1/alarms", params={"axis": AXIS}).json()["alarms"],
    }
    database = Database(url)
    charts = (AxisRow.monitor_state, AxisRow.epoch, AxisRow.last_charted_at, AxisRow.refused_windows, AxisRow.uncharted)
    with database.read() as session:
        found["charts"] = [str(value) for value in session.execute(select(*charts)).one()]
        for table, order in (("sessions", "started_at"), ("trend_rollups", "span_s, starts_at")):
            rows = session.execute(text(f"SELECT * FROM {table} ORDER BY {order}"))  # noqa: S608
            found[table] = [[str(value) for value in row] for row in rows]
        starts = session.execute(
            text("SELECT started_at, content_sha256, refusal_reason FROM windows ORDER BY started_at")
        )
        found["windows"] = [[str(value) for value in row] for row in starts]
    database.close()
    return without(found)
