"""Charts fold measurements in the order of their time; the trend is narrow, and summed up by hour and day."""

import json
from datetime import UTC, datetime, timedelta
from typing import Any

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

identity = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
#: Columns of a measurement that go over to its point of the trend, or its document.
MOVED = ("frequency_hz", "preload_n", "interval_lower_n", "interval_upper_n", "monitor_state", "refusal_reason")
AMOUNTS = (
    "set_preload_n", "payload_kg", "temperature_c", "frequency_hz", "preload_n", "interval_lower_n", "interval_upper_n",
    "drag_torque_nm", "feature_s2", "feature_uncertainty_s2", "baseline_preload_n",
)  # fmt: skip
AXIS_COLUMNS = (
    "number", "epoch", "epoch_after", "epoch_from", "since_checkpoint", "state", "state_since", "last_charted_at",
    "last_measurement_id", "last_measured_at", "refused_windows", "uncharted",
)  # fmt: skip
AT_ONCE = 1000
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def upgrade() -> None:
    """Go to this version: everything that was said about a measurement is kept."""
    _make_tables()
    connection = op.get_bind()
    axes = connection.execute(sa.text("SELECT id, active_calibration_id FROM axes ORDER BY id")).all()
    for number, (axis, active) in enumerate(axes, start=1):
        connection.execute(sa.text("UPDATE axes SET number = :number WHERE id = :id"), {"number": number, "id": axis})
        _move_trend(connection, axis, number, active)
        _count(connection, axis, number)
    connection.execute(
        sa.text(
            "UPDATE alarms SET measured_at = (SELECT started_at FROM measurements WHERE id = alarms.measurement_id)"
        )
    )
    for name in (*MOVED, "outcome", "response"):  # as it stands: rows of other tables name those of this one
        op.execute(sa.text(f"ALTER TABLE measurements DROP COLUMN {name}"))
    is_open = sa.text("status = 'open'")
    op.create_index(
        "ix_measurements_closing", "measurements", ["closes_at"], sqlite_where=is_open, postgresql_where=is_open
    )
    stated = sa.text("set_preload_n IS NOT NULL")
    op.create_index(
        "ix_measurements_set_preload", "measurements", ["axis_id", "started_at"],
        sqlite_where=stated, postgresql_where=stated,
    )  # fmt: skip
    op.create_index("ix_axes_number", "axes", ["number"], unique=True)
    op.drop_index("ix_alarms_axis_id", "alarms")
    op.create_index("ix_alarms_axis_status", "alarms", ["axis_id", "status", "id"])


def downgrade() -> None:
    """Go back; refused if there is an axis: an older program would not know its trend, nor what arrived late."""
    refuse_to_lose("the trend of every axis", "SELECT count(*) FROM axes")
    for table in ("chart_checkpoints", "trend_rollups", "trend_points", "measurement_documents"):
        op.drop_table(table)
    op.drop_index("ix_alarms_axis_status", "alarms")
    op.create_index("ix_alarms_axis_id", "alarms", ["axis_id"])
    op.drop_index("ix_axes_number", "axes")
    for index in ("ix_measurements_closing", "ix_measurements_set_preload"):
        op.drop_index(index, "measurements")
    old: list[sa.Column[Any]] = [sa.Column("monitor_state", sa.String(16)), sa.Column("refusal_reason", sa.String(40))]
    old += [sa.Column(name, sa.Float()) for name in MOVED[:4]]
    old += [sa.Column(name, sa.JSON()) for name in ("outcome", "response")]
    for column in old:
        op.add_column("measurements", column)
    new = {"axes": AXIS_COLUMNS, "measurements": ("closes_at",), "alarms": ("epoch", "measured_at")}
    for table, names in new.items():
        for name in names:
            op.execute(sa.text(f"ALTER TABLE {table} DROP COLUMN {name}"))


def _make_tables() -> None:
    new: list[sa.Column[Any]] = [
        sa.Column("number", sa.Integer(), nullable=False, server_default="0"),
        sa.Column("epoch", sa.Integer(), nullable=False, server_default="0"),
        sa.Column("epoch_after", sa.DateTime()),
        sa.Column("epoch_from", sa.DateTime()),
        sa.Column("since_checkpoint", sa.Integer(), nullable=False, server_default="0"),
        sa.Column("state", sa.String(length=16), nullable=False, server_default="unknown"),
        sa.Column("state_since", sa.DateTime()),
        sa.Column("last_charted_at", sa.DateTime()),
        sa.Column("last_measurement_id", sa.BigInteger()),
        sa.Column("last_measured_at", sa.BigInteger()),
        sa.Column("refused_windows", sa.JSON(), nullable=False, server_default="{}"),
        sa.Column("uncharted", sa.JSON(), nullable=False, server_default="{}"),
    ]
    for column in new:
        op.add_column("axes", column)
    op.add_column("measurements", sa.Column("closes_at", sa.DateTime()))
    op.execute(sa.text("UPDATE measurements SET closes_at = started_at WHERE status = 'open'"))
    op.add_column("alarms", sa.Column("epoch", sa.Integer(), nullable=False, server_default="0"))
    op.add_column(
        "alarms", sa.Column("measured_at", sa.DateTime(), nullable=False, server_default="1970-01-01 00:00:00.000000")
    )
    op.create_table(
        "measurement_documents",
        sa.Column("measurement_id", identity, sa.ForeignKey("measurements.id"), primary_key=True),
        sa.Column("outcome", sa.JSON(), nullable=False),
        sa.Column("response", sa.JSON()),
    )
    op.create_table(
        "trend_points",
        sa.Column("axis_number", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("at", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("measurement_id", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("position_mm", sa.Float(), nullable=False),
        sa.Column("refusal_reason", sa.String(length=40)),
        sa.Column("calibration_id", sa.BigInteger()),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("uncharted", sa.String(length=20)),
        sa.Column("state", sa.String(length=16), nullable=False),
        *(sa.Column(name, sa.Float()) for name in AMOUNTS),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "trend_rollups",
        sa.Column("axis_number", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("span_s", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("starts_at", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("n_measurements", sa.Integer(), nullable=False),
        sa.Column("n_refused", sa.Integer(), nullable=False),
        sa.Column("first_at", sa.BigInteger(), nullable=False),
        sa.Column("lowest_n", sa.Float()),
        sa.Column("lowest_at", sa.BigInteger()),
        sa.Column("highest_n", sa.Float()),
        sa.Column("highest_at", sa.BigInteger()),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "chart_checkpoints",
        sa.Column("axis_number", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("epoch", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("at", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("state", sa.JSON(), nullable=False),
        sqlite_with_rowid=False,
    )


_MEASUREMENTS = sa.table(
    "measurements",
    *(sa.column(name) for name in ("id", "axis_id", "name", "position_mm", "set_preload_n", "calibration_id", "status",
                                   *MOVED)),
    sa.column("started_at", sa.DateTime()),
    sa.column("outcome", sa.JSON()),
    sa.column("response", sa.JSON(none_as_null=True)),
)  # fmt: skip


def _move_trend(connection: sa.Connection, axis: str, number: int, active: int | None) -> None:
    """Write the points of an axis, in parts, with their documents, and sum up hours and days."""
    documents, points, rollups = (
        sa.Table(name, sa.MetaData(), autoload_with=connection)
        for name in ("measurement_documents", "trend_points", "trend_rollups")
    )
    hours: dict[tuple[int, int], dict[str, object]] = {}
    last = 0
    while True:
        query = sa.select(_MEASUREMENTS).where(
            _MEASUREMENTS.c.axis_id == axis, _MEASUREMENTS.c.status != "open", _MEASUREMENTS.c.id > last
        )
        rows = connection.execute(query.order_by(_MEASUREMENTS.c.id).limit(AT_ONCE)).all()
        if not rows:
            break
        last = rows[-1].id
        found = [_point(row, number, active) for row in rows]
        connection.execute(sa.insert(points), found)
        connection.execute(
            sa.insert(documents),
            [{"measurement_id": row.id, "outcome": row.outcome, "response": row.response} for row in rows],
        )
        for point in found:
            for span in (3600, 86400):
                _sum_up(hours, point, span)
    if hours:
        connection.execute(sa.insert(rollups), list(hours.values()))


def _point(row: sa.Row, number: int, active: int | None) -> dict[str, object]:  # type: ignore[type-arg]
    said = row.outcome or {}
    feature = said.get("preload_feature_s2")
    return {
        "axis_number": number,
        "at": _micros(row.started_at),
        "measurement_id": row.id,
        "name": row.name,
        "position_mm": row.position_mm,
        "set_preload_n": row.set_preload_n,
        "payload_kg": said.get("payload_kg"),
        "temperature_c": said.get("temperature_c"),
        "refusal_reason": row.refusal_reason,
        "calibration_id": row.calibration_id,
        "frequency_hz": row.frequency_hz,
        "preload_n": row.preload_n,
        "interval_lower_n": row.interval_lower_n,
        "interval_upper_n": row.interval_upper_n,
        "drag_torque_nm": said.get("drag_torque_nm"),
        "feature_s2": feature,
        "feature_uncertainty_s2": None if feature is None else said.get("preload_feature_standard_uncertainty_s2"),
        "epoch": 0 if row.calibration_id == active else -1,  # those of other calibrations: to none of now
        "uncharted": "preload-set" if row.status == "judged" and row.set_preload_n is not None else None,
        "state": row.monitor_state or "unknown",
        "baseline_preload_n": said.get("baseline_preload_n"),
    }


def _sum_up(sums: dict[tuple[int, int], dict[str, object]], point: dict[str, object], span_s: int) -> None:
    at, preload = int(str(point["at"])), point["preload_n"]
    starts_at = at - at % (span_s * 10**6)
    held = sums.setdefault(
        (span_s, starts_at),
        {
            "axis_number": point["axis_number"], "span_s": span_s, "starts_at": starts_at, "n_measurements": 0,
            "n_refused": 0, "first_at": at, "lowest_n": None, "lowest_at": None, "highest_n": None, "highest_at": None,
        },
    )  # fmt: skip
    held["n_measurements"] = int(str(held["n_measurements"])) + 1
    held["n_refused"] = int(str(held["n_refused"])) + (point["refusal_reason"] is not None)
    held["first_at"] = min(int(str(held["first_at"])), at)
    if isinstance(preload, float):
        lowest, highest = held["lowest_n"], held["highest_n"]
        if not isinstance(lowest, float) or preload < lowest:
            held["lowest_n"], held["lowest_at"] = preload, at
        if not isinstance(highest, float) or preload > highest:
            held["highest_n"], held["highest_at"] = preload, at


def _count(connection: sa.Connection, axis: str, number: int) -> None:
    """Count what is shown of an axis; its charts go on from where they stand, and are not folded again before."""
    refused = connection.execute(
        sa.text(
            "SELECT refusal_reason AS reason, COUNT(*) AS n FROM windows "
            "WHERE axis_id = :axis AND refusal_reason IS NOT NULL GROUP BY refusal_reason"
        ),
        {"axis": axis},
    )
    uncharted = connection.execute(
        sa.text(
            "SELECT COUNT(*) FROM measurements WHERE axis_id = :axis AND status = 'judged' "
            "AND set_preload_n IS NOT NULL"
        ),
        {"axis": axis},
    ).scalar_one()
    newest = connection.execute(
        sa.select(_MEASUREMENTS.c.id, _MEASUREMENTS.c.started_at)
        .where(_MEASUREMENTS.c.axis_id == axis, _MEASUREMENTS.c.status != "open")
        .order_by(_MEASUREMENTS.c.started_at.desc(), _MEASUREMENTS.c.id.desc())
        .limit(1)
    ).first()
    first = connection.execute(
        sa.text("SELECT MIN(at) FROM trend_points WHERE axis_number = :number AND epoch = 0"), {"number": number}
    ).scalar_one()
    axes = sa.table(
        "axes",
        *(sa.column(name) for name in ("id", "state", "last_measurement_id", "last_measured_at")),
        *(sa.column(name, sa.JSON()) for name in ("monitor_state", "refused_windows", "uncharted")),
        *(sa.column(name, sa.DateTime()) for name in ("epoch_after", "epoch_from", "state_since", "last_charted_at")),
    )
    state = connection.execute(sa.select(axes.c.monitor_state).where(axes.c.id == axis)).scalar_one()
    detector = (json.loads(state) if isinstance(state, str) else state or {}).get("detector", {})
    charted = _naive(detector.get("last_at"))
    connection.execute(
        sa.update(axes).where(axes.c.id == axis),
        {
            "state": detector.get("status", "unknown"),
            "state_since": _naive(detector.get("since")),
            "last_charted_at": charted,
            "epoch_after": charted,
            "epoch_from": None if first is None else _naive_of(first),
            "last_measurement_id": None if newest is None else newest.id,
            "last_measured_at": None if newest is None else _micros(newest.started_at),
            "refused_windows": {row.reason: row.n for row in refused},
            "uncharted": {"preload-set": uncharted} if uncharted else {},
        },
    )


def _naive(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text).astimezone(UTC).replace(tzinfo=None)


def _naive_of(micros: int) -> datetime:
    return (EPOCH + timedelta(microseconds=micros)).replace(tzinfo=None)


def _micros(moment: datetime) -> int:
    return (moment.replace(tzinfo=UTC) - EPOCH) // timedelta(microseconds=1)
