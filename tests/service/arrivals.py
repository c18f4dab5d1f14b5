"""The same windows in other orders, cut into other requests, from other numbers of senders."""

import hashlib
import json
import sqlite3
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np

from monitor_core.recording import Window
from tests.service.conftest import START, Api, running_service, simulated_measurement

AXIS = "axis"
WINDOWS_OF_MEASUREMENT = 3
#: What says who was first, or when something was written down: it differs, and may.
BY_ARRIVAL = frozenset({"measurement_id", "id", "raised_at", "events", "created_at", "received_at", "judged_at"})


def history(seed: int, n_measurements: int = 24) -> list[Window]:
    """Return the windows of an axis, two measurements a day, that loses a fifth of its preload half way, in order.

    One of them is dead, one stands elsewhere, the tag of one is wrong. Every fifth measurement has one more than it
    needs, and one too few. In the second quarter all have one name.
    """
    rng, windows = np.random.default_rng(seed), []
    for i in range(n_measurements):
        name = "again" if n_measurements // 4 <= i < n_measurements // 2 else f"m{i:03d}"
        measured = simulated_measurement(
            rng, name, preload=300.0 if i < n_measurements // 2 else 240.0,
            started_at=START + timedelta(days=i // 2, hours=8 * (i % 2)),
            n_windows=WINDOWS_OF_MEASUREMENT + (i % 5 == 0),
        )  # fmt: skip
        if i == 3:
            measured[0] = replace(measured[0], response=np.zeros_like(measured[0].response))
        if i == 5:
            measured[0] = replace(measured[0], conditions=replace(measured[0].conditions, position=0.6))
        if i == 7:  # of one session with the sixth: its tag is 60 mm wrong, and the two places contradict each other
            measured = [replace(w, conditions=replace(w.conditions, position=0.44)) for w in measured]
        windows += measured[: 1 if i == 9 else None]
    return windows


def outcome_of(windows: Sequence[Window], folder: Path, rng: np.random.Generator, n_senders: int) -> dict[str, object]:
    """Send windows in this order to a new service, cut into requests of 1 to 12, and return everything it says then."""
    with running_service(folder) as api:
        api.register(
            AXIS,
            windows_per_measurement=WINDOWS_OF_MEASUREMENT,
            minimum_averages=2,
            measurement_timeout_s=1e6,
            measurement_pause_s=600.0,
            baseline_size=5,
        )
        api.calibrate(AXIS)
        shares = [windows[first::n_senders] for first in range(n_senders)]
        requests = [_cut(share, rng) for share in shares]
        with ThreadPoolExecutor(n_senders) as pool:
            list(pool.map(lambda share: [api.accept(AXIS, request) for request in share], requests))
        # what has too few windows is judged with what it has
        api.accept(AXIS, sorted(windows, key=lambda window: window.started_at), complete=True)
        return said_of(api)


def said_of(api: Api) -> dict[str, object]:
    """Return everything that is said of the axis, but for what says who was first."""
    trend = api.trend(AXIS)
    found = {
        "axis": api.axis(AXIS),
        "trend": trend,
        "newest first": api.trend(AXIS, order="newest-first"),
        "few": api.trend(AXIS, resolution=6),
        "measurements": [
            api.http.get(f"/v1/axes/{AXIS}/measurements/{point['measurement_id']}").json() for point in trend
        ],
        "alarms": api.http.get("/v1/alarms", params={"axis": AXIS}).json()["alarms"],
    }
    with closing(sqlite3.connect(api.data_dir / "preload.db")) as database:
        charts = database.execute("SELECT monitor_state, epoch, last_charted_at, refused_windows, uncharted FROM axes")
        found["sessions"] = database.execute("SELECT * FROM sessions ORDER BY started_at").fetchall()
        found["charts"] = charts.fetchall()
        held = database.execute(
            "SELECT span_s, starts_at, n_measurements, n_refused, lowest_n, lowest_at, highest_n, highest_at "
            "FROM trend_rollups ORDER BY span_s, starts_at"
        )
        found["hours and days"] = held.fetchall()
    return without(found)


def hashed(document: object) -> str:
    """Return the SHA-256 of a document."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def without(document: object) -> object:
    """Return a document without what says who was first, at any depth."""
    if isinstance(document, dict):
        return {name: without(value) for name, value in document.items() if name not in BY_ARRIVAL}
    return [without(item) for item in document] if isinstance(document, list | tuple) else document


def _cut(windows: Sequence[Window], rng: np.random.Generator) -> list[list[Window]]:
    cuts = np.cumsum(rng.integers(1, 13, size=len(windows))).tolist()
    edges = [0, *(cut for cut in cuts if cut < len(windows)), len(windows)]
    return [list(windows[first:end]) for first, end in pairwise(edges) if first < end]
