"""Report the state of the service: versions, lag of intake, and what was refused of all axes."""

import platform
from collections import Counter
from dataclasses import dataclass
from datetime import datetime

from service.observability import Metrics
from service.operations.monitoring.intake.ingest import Ingest
from service.settings import VERSION
from service.store import axes, measurements
from service.store.database import Database


@dataclass(frozen=True, slots=True)
class Versions:
    """What runs."""

    program: str
    schema: str  # of the database
    database: str  # its kind
    python: str


@dataclass(frozen=True, slots=True)
class Lag:
    """How far intake is behind."""

    n_waiting: int  # requests that wait for their turn in this process
    n_open: int  # measurements that wait for further windows
    received_at: datetime | None  # of the window that arrived last
    started_at: datetime | None  # when that window was measured
    judging_s: float | None  # mean time to judge a measurement, since this process began


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """How the service stands."""

    versions: Versions
    lag: Lag
    n_axes: int
    n_archived: int
    refused_windows: dict[str, int]  # of all axes, by reason, most frequent first
    uncharted: dict[str, int]  # accepted measurements that moved no chart


def system_status(database: Database, metrics: Metrics, ingest: Ingest) -> SystemStatus:
    """Return how the service stands at this moment."""
    refused, uncharted = Counter[str](), Counter[str]()
    with database.read() as session:
        rows = axes.counted(session)
        newest, n_open = measurements.newest_window(session), measurements.count_open(session)
    for row in rows:
        refused.update(row.refused_windows)
        uncharted.update(row.uncharted)
    lag = Lag(
        n_waiting=ingest.n_waiting,
        n_open=n_open,
        received_at=None if newest is None else newest.received_at,
        started_at=None if newest is None else newest.started_at,
        judging_s=metrics.mean_judging_s(),
    )
    versions = Versions(
        program=VERSION,
        schema=database.schema,
        database=database.engine.dialect.name,
        python=platform.python_version(),
    )
    return SystemStatus(
        versions, lag, len(rows), sum(row.archived_at is not None for row in rows),
        dict(refused.most_common()), dict(uncharted.most_common()),
    )  # fmt: skip
