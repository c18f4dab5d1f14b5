"""Give an axis a long history, row by row as the service would have written it, without measuring for years."""

import json
import sqlite3
from contextlib import closing
from datetime import datetime, timedelta
from itertools import islice
from pathlib import Path

from tests.service.conftest import START

HOUR_US, DAY_US = 3600 * 10**6, 86400 * 10**6
AT_ONCE = 20_000


def lengthen(data_dir: Path, axis: str, n_measurements: int, *, every: timedelta, windows_each: int = 1) -> datetime:
    """Write so many judged measurements before :data:`START`, with their windows; return when the first began.

    One in twenty is refused, one in fifty was made for a calibration. The service must not be running.
    """
    first = START - n_measurements * every
    with closing(sqlite3.connect(data_dir / "preload.db")) as database:
        number = database.execute("SELECT number FROM axes WHERE id = ?", [axis]).fetchone()[0]
        begin = database.execute("SELECT COALESCE(MAX(id), 0) FROM measurements").fetchone()[0] + 1
        template = database.execute("SELECT outcome, response FROM measurement_documents LIMIT 1").fetchone()
        outcome, response = template or (json.dumps({"refused": False}), None)
        rows = iter(range(n_measurements))
        while chunk := list(islice(rows, AT_ONCE)):
            _write(database, axis, number, [(begin + i, first + i * every, i) for i in chunk], (outcome, response))
            database.executemany(
                "INSERT INTO windows (axis_id, measurement_id, started_at, received_at, content_sha256, file_path, "
                "offset_in_file, index_in_frame) VALUES (?, ?, ?, ?, 'none', 'none', 0, 0)",
                (
                    (axis, begin + i, _text(at := first + i * every + k * timedelta(milliseconds=1)), _text(at))
                    for i in chunk
                    for k in range(windows_each)
                ),
            )
        _sum_up(database, number)
        database.execute(
            "UPDATE axes SET last_measured_at = ?, last_measurement_id = ?, revision = revision + 1 WHERE id = ?",
            [_micros(first + (n_measurements - 1) * every), begin + n_measurements - 1, axis],
        )
        database.commit()
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return first


def _write(
    database: sqlite3.Connection, axis: str, number: int, measured: list[tuple[int, datetime, int]], said: tuple
) -> None:  # fmt: skip
    database.executemany(
        "INSERT INTO measurements (id, axis_id, name, started_at, ended_at, position_mm, set_preload_n, status, "
        "n_accepted, judged_at, revision) VALUES (?, ?, ?, ?, ?, 500, ?, ?, 15, ?, 2)",
        (
            (key, axis, f"h{i}", *[_text(at)] * 2, 300.0 if i % 50 == 0 else None,
             "refused" if i % 20 == 7 else "judged", _text(at))
            for key, at, i in measured
        ),
    )  # fmt: skip
    database.executemany("INSERT INTO measurement_documents VALUES (?, ?, ?)", ((key, *said) for key, _, _ in measured))
    database.executemany(
        "INSERT INTO trend_points (axis_number, at, measurement_id, name, position_mm, set_preload_n, refusal_reason, "
        "preload_n, interval_lower_n, interval_upper_n, frequency_hz, epoch, uncharted, state) "
        "VALUES (?, ?, ?, ?, 500, ?, ?, ?, ?, ?, 180, 0, ?, 'normal')",
        (
            (number, _micros(at), key, f"h{i}", 300.0 if i % 50 == 0 else None, *_value(i),
             "preload-set" if i % 50 == 0 else None)
            for key, at, i in measured
        ),
    )  # fmt: skip


def _value(i: int) -> tuple[str | None, float | None, float | None, float | None]:
    if i % 20 == 7:
        return "low-coherence", None, None, None
    preload = 300.0 + (i * 7919 % 100) / 10.0
    return None, preload, preload - 5.0, preload + 5.0


def _sum_up(database: sqlite3.Connection, number: int) -> None:
    for span, seconds in ((HOUR_US, 3600), (DAY_US, 86400)):
        database.execute(
            "INSERT OR REPLACE INTO trend_rollups "
            "SELECT axis_number, ?2, at / ?1 * ?1, COUNT(*), COUNT(refusal_reason), MIN(at), "
            "MIN(worn), MIN(CASE WHEN worn IS NOT NULL THEN at END), "
            "MAX(worn), MAX(CASE WHEN worn IS NOT NULL THEN at END) "
            "FROM (SELECT *, CASE WHEN set_preload_n IS NULL THEN preload_n END AS worn FROM trend_points) "
            "WHERE axis_number = ?3 GROUP BY at / ?1",
            [span, seconds, number],
        )


def _micros(moment: datetime) -> int:
    return int((moment - START) / timedelta(microseconds=1)) + int(START.timestamp()) * 10**6


def _text(moment: datetime) -> str:
    return moment.strftime("%Y-%m-%d %H:%M:%S.%f")
