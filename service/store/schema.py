"""Make the tables of an empty database, and bring those of an older program to the version of this one."""

from collections.abc import Callable

from sqlalchemy import Connection, Table, column, insert, inspect, select, table, text, update
from sqlalchemy.schema import CreateIndex

from service.errors import DataFolderError
from service.store.tables import AlarmRow, AuditRow, Base, MeasurementRow, VersionRow, WindowRow
from service.store.trend import epochs, lost_motion, rollups, sessions  # noqa: F401 - their tables belong to the schema

#: When the last window of a measurement began, as far as an older program kept it: not what a wrong clock says.
_FILL_ENDS = """UPDATE measurements SET ended_at =
(SELECT COALESCE(MAX(windows.started_at), measurements.started_at) FROM windows
WHERE windows.measurement_id = measurements.id AND COALESCE(windows.refusal_reason, '') <> 'clock-ahead')"""


def _make_index(connection: Connection, of: Table, name: str) -> None:
    _state_conditions(connection.dialect.name)
    connection.execute(CreateIndex(next(index for index in of.indexes if index.name == name)))


def _repeat_names(connection: Connection) -> None:
    """Let an axis have several measurements of one name, which their starts tell apart."""
    measurements, windows, alarms, audit_log = (
        row.metadata.tables[row.__tablename__] for row in (MeasurementRow, WindowRow, AlarmRow, AuditRow)
    )
    _make_index(connection, alarms, "ix_alarms_measurement_id")  # else all alarms are passed for each measurement
    _make_index(connection, audit_log, "ix_audit_log_logins")
    new = [windows.c.ended_at, windows.c.position_mm, windows.c.set_preload_n, measurements.c.ended_at]
    for added in new:
        kind = added.type.compile(connection.dialect)
        connection.execute(text(f"ALTER TABLE {added.table.name} ADD COLUMN {added.name} {kind}"))
    connection.execute(text(_FILL_ENDS))
    connection.execute(text("DELETE FROM rejudged_measurements"))  # without an end; the job makes them again
    if connection.dialect.name == "postgresql":
        connection.execute(text("ALTER TABLE measurements ALTER COLUMN ended_at SET NOT NULL"))
        connection.execute(text("ALTER TABLE measurements DROP CONSTRAINT uq_measurements_axis_id_name"))
        _make_index(connection, measurements, "ix_measurements_axis_name")
        return
    _make_anew(connection, measurements)


def _make_anew(connection: Connection, of: Table) -> None:
    """Give a table of SQLite its present columns, with all its rows: a constraint is dropped with its table only."""
    # what refers to a row of it looks for that at the commit
    connection.execute(text("PRAGMA defer_foreign_keys = ON"))
    connection.execute(text(f"CREATE TEMPORARY TABLE copied AS SELECT * FROM {of.name}"))  # noqa: S608 - a table of ours
    connection.execute(text(f"DROP TABLE {of.name}"))
    _state_conditions(connection.dialect.name)
    of.create(connection)
    names = [each.name for each in of.c]
    copied = table("copied", *(column(name) for name in names))
    connection.execute(insert(of).from_select(names, select(copied)))
    connection.execute(text("DROP TABLE copied"))


def _keep_friction(connection: Connection) -> None:
    """Keep the friction of all moves; that of few travels, of the sessions before, tells nothing beside it."""
    connection.execute(text("ALTER TABLE trend_points ADD COLUMN friction_torque_nm FLOAT"))
    connection.execute(text("ALTER TABLE sessions ADD COLUMN friction_torque_nm FLOAT"))
    connection.execute(text("ALTER TABLE sessions DROP COLUMN drag_torque_nm"))


def _keep_shown_scatter(connection: Connection) -> None:
    """Keep what sessions show of a budget; those judged before have none, and their intervals are only widened."""
    connection.execute(text("ALTER TABLE trend_points ADD COLUMN shown_scatter_s2 FLOAT"))


def _keep_frequencies(connection: Connection) -> None:
    """Keep what charts without a calibration watch; measurements of before were refused without one, and stay so."""
    for name in ("frequency_uncertainty_hz", "expected_frequency_hz", "expected_frequency_uncertainty_hz"):
        connection.execute(text(f"ALTER TABLE trend_points ADD COLUMN {name} FLOAT"))


def _count_friction_positive(connection: Connection) -> None:
    """Turn the friction of axes whose torque counts against their position: it is kept as positive now."""
    connection.execute(text("UPDATE trend_points SET friction_torque_nm = ABS(friction_torque_nm)"))
    connection.execute(text("UPDATE trend_points SET drag_torque_nm = ABS(drag_torque_nm)"))
    connection.execute(text("UPDATE sessions SET friction_torque_nm = ABS(friction_torque_nm)"))


def _keep_lost_motion(connection: Connection) -> None:
    """Keep lost motion, whose alarms no measurement of windows raises."""
    for kept in (lost_motion.READINGS, lost_motion.CHARTS):
        kept.create(connection)
    if connection.dialect.name == "postgresql":
        connection.execute(text("ALTER TABLE alarms ALTER COLUMN measurement_id DROP NOT NULL"))
        return
    _make_anew(connection, AlarmRow.metadata.tables[AlarmRow.__tablename__])


def _keep_damping_and_residue(connection: Connection) -> None:
    """Keep what is watched together with the frequency; measurements of before have neither."""
    for name in ("damping_ratio", "residue"):
        connection.execute(text(f"ALTER TABLE trend_points ADD COLUMN {name} FLOAT"))


def _keep_quantities(connection: Connection) -> None:
    """Let others than lost motion have readings and a chart; tables that this program made have them."""
    for of in (lost_motion.READINGS, lost_motion.CHARTS):
        held = {column["name"] for column in inspect(connection).get_columns(of.name)}
        if "quantity" in held:
            continue
        for name, was in _READINGS_WERE.items():
            if was in held:
                connection.execute(text(f"ALTER TABLE {of.name} RENAME COLUMN {was} TO {name}"))
        for name, of_lost_motion in (("quantity", lost_motion.LOST_MOTION), ("unit", "µm")):
            if name in of.c:
                kind = of.c[name].type.compile(connection.dialect)
                added = f"ADD COLUMN {name} {kind} NOT NULL DEFAULT '{of_lost_motion}'"
                connection.execute(text(f"ALTER TABLE {of.name} {added}"))
        connection.execute(text(f"ALTER TABLE {of.name} ADD COLUMN speed_mm_per_s FLOAT"))
        if connection.dialect.name == "postgresql":
            keys = ", ".join(column.name for column in of.primary_key)
            key = f"CONSTRAINT pk_{of.name}"
            connection.execute(text(f"ALTER TABLE {of.name} DROP {key}, ADD {key} PRIMARY KEY ({keys})"))
        else:
            _make_anew(connection, of)


_READINGS_WERE = {
    "value": "reversal_value_um", "standard_uncertainty": "standard_uncertainty_um",
    "interval_lower": "interval_lower_um", "interval_upper": "interval_upper_um", "n_repeats": "n_reversals",
}  # fmt: skip
#: Oldest version that this program opens.
BASELINE = "0017"
#: What follows the baseline: the version that each step leads to, and what it changes, on SQLite and on PostgreSQL.
STEPS: tuple[tuple[str, Callable[[Connection], None]], ...] = (
    ("0018", lambda _: None),  # new documents of measurements are packed, which an older program would not read
    ("0019", _repeat_names),
    ("0020", _keep_friction),
    ("0021", _keep_shown_scatter),
    ("0022", _keep_frequencies),
    ("0026", _count_friction_positive),
    ("0028", _keep_lost_motion),
    ("0030", _keep_damping_and_residue),
    ("0031", rollups.leave_out_set_preloads),
    ("0032", _keep_quantities),
)
#: The version that this program writes.
VERSION = STEPS[-1][0]
#: What brings every older schema to the baseline. (The service of that commit would also fold charts again, without the
#: calibration of those of commit 5c78000.)
OPENS_OLDER = "run `preload user list` of commit 7bd100f"


def bring_up_to_date(connection: Connection) -> None:
    """Give a database the schema of this program, in the transaction that is open.

    Raises DataFolderError if the database is of a newer program, or of one older than the baseline.
    """
    if not inspect(connection).has_table(VersionRow.__tablename__):
        _state_conditions(connection.dialect.name)
        Base.metadata.create_all(connection, checkfirst=False)
        connection.execute(insert(VersionRow).values(version_num=VERSION))
        return
    stored = connection.scalar(select(VersionRow.version_num)) or "none"
    _require_reachable(stored)
    for version, change in STEPS:
        if version > stored:
            change(connection)
    if stored != VERSION:
        connection.execute(update(VersionRow).values(version_num=VERSION))


def _state_conditions(dialect: str) -> None:
    """Give partial indexes their condition in this dialect, too: tables that named it would load it at every start."""
    for index in (index for each in Base.metadata.tables.values() for index in each.indexes):
        index.dialect_options[dialect]["where"] = index.dialect_options["sqlite"]["where"]


def _require_reachable(stored: str) -> None:
    if stored in {BASELINE, *(version for version, _ in STEPS)}:
        return
    if stored < BASELINE:
        raise DataFolderError(
            f"the schema of the database is of version {stored}, and this program opens those from {BASELINE}: "
            f"{OPENS_OLDER} on it once, which brings it to {BASELINE}, then start this program"
        )
    raise DataFolderError(
        f"the schema of the database is of version {stored}, and this program knows those to {VERSION}: "
        "start the newer program that it was used with, or restore the backup from before the upgrade"
    )
