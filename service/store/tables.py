"""Define the tables. Every column that holds a quantity carries its unit in its name."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import (
    JSON,
    BigInteger,
    DateTime,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    PrimaryKeyConstraint,
    String,
    Text,
    UniqueConstraint,
    text,
)
from sqlalchemy.engine import Dialect
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.types import TypeDecorator

from service.json_types import JsonObject
from service.store.packed_documents import PackedDocument


class UtcDateTime(TypeDecorator[datetime]):
    """A moment in UTC: aware in Python, naive UTC in the database (SQLite keeps no zone)."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Refuse times without a zone; store UTC."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"a stored time must carry a zone; got {value.isoformat()}")
        return value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Give the zone back."""
        return None if value is None else value.replace(tzinfo=UTC)


class UtcMicroseconds(TypeDecorator[datetime]):
    """A moment in UTC as microseconds since 1970: a third of the room, where a table is as long as the history."""

    impl = BigInteger
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> int | None:
        """Count the microseconds."""
        return None if value is None else microseconds_of(value)

    def process_result_value(self, value: int | None, dialect: Dialect) -> datetime | None:
        """Return the moment."""
        return None if value is None else moment_of(value)


def microseconds_of(moment: datetime) -> int:
    """Return a moment as microseconds since 1970."""
    return (moment - _EPOCH) // timedelta(microseconds=1)


def moment_of(microseconds: int) -> datetime:
    """Return the moment so many microseconds after 1970."""
    return _EPOCH + timedelta(0, 0, microseconds)


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: Nothing is stored as NULL, not as the text "null".
NullableJson = JSON(none_as_null=True)
#: SQLite only counts up an INTEGER primary key.
Identity = BigInteger().with_variant(Integer, "sqlite")
#: Every version of the schema has it: older programs, whose migrations Alembic ran, read theirs from it, too.
VERSION_TABLE = "alembic_version"
#: How often something happened, by its named reason.
CountsByReason = dict[str, int]


def _partial_index(name: str, *columns: str, where: str) -> Index:
    """Index the rows that meet a condition, so that they are found without passing all that was ever measured."""
    return Index(name, *columns, sqlite_where=text(where))


class Base(DeclarativeBase):
    """Root of the tables."""

    # Constraints have names, so that a later step can change them on every database.
    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {datetime: UtcDateTime, JsonObject: NullableJson, CountsByReason: JSON, float: Float}  # noqa: RUF012 - SQLAlchemy's own hook


class VersionRow(Base):
    """The one row that says of which version the schema is."""

    __tablename__ = VERSION_TABLE
    __table_args__ = (PrimaryKeyConstraint("version_num", name=f"{VERSION_TABLE}_pkc"),)

    version_num: Mapped[str] = mapped_column(String(32))


class AxisRow(Base):
    """A monitored axis."""

    __tablename__ = "axes"
    __table_args__ = (Index("ix_axes_number", "number", unique=True),)

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    configuration: Mapped[JsonObject]
    created_at: Mapped[datetime]
    active_calibration_id: Mapped[int | None] = mapped_column(Identity)
    detector_design: Mapped[JsonObject]  # limits of the charts, as solved for the configuration
    number: Mapped[int]  # in the tables of the trend
    monitor_state: Mapped[JsonObject | None]  # of the charts now
    epoch: Mapped[int]  # of the charts: each begins with a new baseline
    epoch_after: Mapped[datetime | None]  # what was measured until then moves no chart any more
    epoch_from: Mapped[datetime | None]  # its first measurement
    epoch_begins_at: Mapped[datetime | None]  # what is older is charted in an epoch before it, if at all
    since_checkpoint: Mapped[int]  # measurements in the charts since the last row of chart_checkpoints
    # what every page shows, kept with each measurement: to count the history each time costs more each time
    state: Mapped[str] = mapped_column(String(16))  # of the charts; silence is not seen in it
    state_since: Mapped[datetime | None]
    last_charted_at: Mapped[datetime | None]
    last_measurement_id: Mapped[int | None] = mapped_column(BigInteger)  # the newest that was judged
    last_measured_at: Mapped[datetime | None] = mapped_column(UtcMicroseconds)  # as in the tables of the trend
    refused_windows: Mapped[CountsByReason]
    uncharted: Mapped[CountsByReason]  # measurements that moved no chart
    archived_at: Mapped[datetime | None]  # since when it takes no windows and is listed only where that is asked for
    revision: Mapped[int] = mapped_column()

    # A writer who read the row before another process changed it is refused: what it computed rests on what is no more.
    __mapper_args__ = {"version_id_col": revision}  # noqa: RUF012 - SQLAlchemy's own hook


class MaintenanceRow(Base):
    """What was done to an axis. An entry is never changed: another one corrects it."""

    __tablename__ = "maintenance"
    __table_args__ = (Index("ix_maintenance_axis_at", "axis_id", "at", "id"),)

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"))
    at: Mapped[datetime]  # when it was done
    entered_at: Mapped[datetime]
    who: Mapped[str] = mapped_column(String(120))
    kind: Mapped[str] = mapped_column(String(16))  # lubricated | nut-replaced | screw-replaced | mounting | other
    note: Mapped[str] = mapped_column(String(1000))
    set_preload_n: Mapped[float | None]
    corrects: Mapped[int | None] = mapped_column(
        BigInteger, ForeignKey("maintenance.id")
    )  # the entry that it takes the place of


class CalibrationRow(Base):
    """A calibration; its document is the file format of ``preload calibrate``."""

    __tablename__ = "calibrations"

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"), index=True)
    document: Mapped[JsonObject]
    comment: Mapped[str] = mapped_column(String(1000))
    created_at: Mapped[datetime]


class ActivationRow(Base):
    """The history of which calibration was in force since when."""

    __tablename__ = "calibration_activations"

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"), index=True)
    calibration_id: Mapped[int] = mapped_column(ForeignKey("calibrations.id"))
    activated_at: Mapped[datetime]
    reason: Mapped[str] = mapped_column(String(1000))


class MeasurementRow(Base):
    """Windows averaged together: of one name, one after the other, at one place; its name and its start tell it.

    What was said about it is apart: see below.
    """

    __tablename__ = "measurements"
    __table_args__ = (
        Index("ix_measurements_axis_name", "axis_id", "name", "ended_at"),
        Index("ix_measurements_axis_started", "axis_id", "started_at", "id"),
        _partial_index("ix_measurements_closing", "closes_at", where="status = 'open'"),
        _partial_index("ix_measurements_set_preload", "axis_id", "started_at", where="set_preload_n IS NOT NULL"),
        {"sqlite_autoincrement": True},  # the number of one that became a part of another is not given again
    )

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"))
    name: Mapped[str] = mapped_column(String(200))
    started_at: Mapped[datetime]  # of its first window
    ended_at: Mapped[datetime]  # of its last window
    position_mm: Mapped[float]
    set_preload_n: Mapped[float | None]  # only where it was set on purpose, as in a calibration
    status: Mapped[str] = mapped_column(String(16))  # open | judged | refused
    n_accepted: Mapped[int]  # windows that are averaged
    closes_at: Mapped[datetime | None]  # if no further window arrives before; None where it is not waited for any
    judged_at: Mapped[datetime | None]
    calibration_id: Mapped[int | None] = mapped_column(ForeignKey("calibrations.id"))
    revision: Mapped[int] = mapped_column()

    __mapper_args__ = {"version_id_col": revision}  # noqa: RUF012 - as for an axis


class MeasurementDocumentRow(Base):
    """The whole answer to a measurement: a thousand times as large as its point of the trend, and seldom asked for."""

    __tablename__ = "measurement_documents"

    measurement_id: Mapped[int] = mapped_column(Identity, ForeignKey("measurements.id"), primary_key=True)
    outcome: Mapped[JsonObject] = mapped_column(PackedDocument)  # as the API gives it, but for what may change later
    response: Mapped[JsonObject | None] = mapped_column(PackedDocument)  # FRF in the band, for "why this value"


class WindowRow(Base):
    """One window: where its waveform lies and whether it was accepted."""

    __tablename__ = "windows"
    __table_args__ = (
        UniqueConstraint("axis_id", "started_at"),
        _partial_index("ix_windows_file_path", "file_path", where="file_path <> ''"),
    )

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"))
    measurement_id: Mapped[int] = mapped_column(ForeignKey("measurements.id"), index=True)
    started_at: Mapped[datetime]
    received_at: Mapped[datetime]
    content_sha256: Mapped[str] = mapped_column(String(64))
    file_path: Mapped[str] = mapped_column(String(400))  # empty: its waveform was let go
    offset_in_file: Mapped[int] = mapped_column(BigInteger)  # of the frame [bytes]
    index_in_frame: Mapped[int]
    refusal_reason: Mapped[str | None] = mapped_column(String(40))
    refusal_detail: Mapped[str | None] = mapped_column(String(500))
    let_go_by: Mapped[int | None] = mapped_column(ForeignKey("purges.id"))  # None: its waveform is stored
    # what tells the measurement that it is of; None: an older program stored it, and it is as its measurement
    ended_at: Mapped[datetime | None]
    position_mm: Mapped[float | None]
    set_preload_n: Mapped[float | None]


#: Where the waveform of a window lies, in the order of a WaveformPlace.
PLACE = (WindowRow.file_path, WindowRow.offset_in_file, WindowRow.index_in_frame, WindowRow.content_sha256)


class PurgeRow(Base):
    """A purge: by which rule it lets waveforms go, and what came of it, counted in the transactions that do it."""

    __tablename__ = "purges"

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    begun_at: Mapped[datetime]
    ended_at: Mapped[datetime | None]  # None: at work, or broken off
    keep_raw_days: Mapped[int]
    lets_go_before: Mapped[datetime]  # the beginning of a day, UTC
    n_windows: Mapped[int]
    freed_bytes: Mapped[int] = mapped_column(BigInteger)
    audit_id: Mapped[int] = mapped_column(ForeignKey("audit_log.id"))


class PinRow(Base):
    """Waveforms that are kept because somebody wants them: of a measurement, or of a span of an axis."""

    __tablename__ = "pins"
    __table_args__ = (Index("ix_pins_axis", "axis_id", "id"),)

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"))
    measurement_id: Mapped[int | None] = mapped_column(ForeignKey("measurements.id"), unique=True)  # None: a span
    start_at: Mapped[datetime | None]  # inclusive; None of a measurement
    end_at: Mapped[datetime | None]  # exclusive
    reason: Mapped[str] = mapped_column(String(1000))
    who: Mapped[str] = mapped_column(String(120))
    at: Mapped[datetime]


class UnsettledFileRow(Base):
    """A waveform file that is being written or removed by a purge: it is removed unless a window names it."""

    __tablename__ = "unsettled_files"

    path: Mapped[str] = mapped_column(String(400), primary_key=True)


class AlarmRow(Base):
    """An alarm with the evidence it rests on."""

    __tablename__ = "alarms"
    __table_args__ = (
        Index("ix_alarms_axis_status", "axis_id", "status", "id"),
        Index("ix_alarms_status", "status", "axis_id"),
    )

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"))
    measurement_id: Mapped[int | None] = mapped_column(
        BigInteger, ForeignKey("measurements.id"), index=True
    )  # None: of lost motion
    kind: Mapped[str] = mapped_column(String(40))
    raised_at: Mapped[datetime]
    epoch: Mapped[int]  # of the charts that raised it
    measured_at: Mapped[datetime]  # when the measurement began
    status: Mapped[str] = mapped_column(String(16))  # active | acknowledged | cleared | withdrawn
    evidence: Mapped[JsonObject]
    explanation: Mapped[JsonObject]  # which change of the axis explains it, or why that was not examined
    shelved_until: Mapped[datetime | None]  # until then nobody is told of it; in the past: about to be brought back


class AlarmEventRow(Base):
    """Each change of an alarm: old → new, when, why."""

    __tablename__ = "alarm_events"

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    alarm_id: Mapped[int] = mapped_column(ForeignKey("alarms.id"), index=True)
    at: Mapped[datetime]
    old_status: Mapped[str | None] = mapped_column(String(16))
    new_status: Mapped[str] = mapped_column(String(16))
    reason: Mapped[str] = mapped_column(String(1000))
    who: Mapped[str | None] = mapped_column(String(120))  # None: the service itself, or from before it was kept
    kind: Mapped[str | None] = mapped_column(String(16))  # comment | shelved | back; None: what the statuses say


class RecordingRow(Base):
    """An uploaded recording: files in a folder of their own, and what was found in them before it was taken."""

    __tablename__ = "recordings"
    # the number of one that was removed is not given to another: jobs go on naming it
    __table_args__ = {"sqlite_autoincrement": True}  # noqa: RUF012 - SQLAlchemy's own hook

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    axis_id: Mapped[str] = mapped_column(ForeignKey("axes.id"), index=True)
    name: Mapped[str] = mapped_column(String(200))  # of its first file
    sha256: Mapped[str] = mapped_column(String(64))  # of the bytes of its files, one after the other
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    state: Mapped[str] = mapped_column(String(16))  # uploaded | checked | imported
    problems: Mapped[list[str]] = mapped_column(JSON)  # what does not keep it from being taken, a sentence each
    channel_map: Mapped[str | None] = mapped_column(Text)  # TOML as it was sent; None: it is a session
    contents: Mapped[JsonObject]  # files, channels, windows, what was left out
    folder: Mapped[str] = mapped_column(String(32))
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"))  # that looks into it, then that takes its windows
    created_at: Mapped[datetime]


class JobRow(Base):
    """Long work with its progress; it survives a restart."""

    __tablename__ = "jobs"
    __table_args__ = (_partial_index("ix_jobs_unfinished", "kind", "axis_id", where="status IN ('queued', 'running')"),)

    id: Mapped[str] = mapped_column(String(36), primary_key=True)
    kind: Mapped[str] = mapped_column(String(20))
    axis_id: Mapped[str | None] = mapped_column(ForeignKey("axes.id"), index=True)  # None: of all axes
    arguments: Mapped[JsonObject]
    status: Mapped[str] = mapped_column(String(16))  # queued | running | done | failed | cancelled
    done: Mapped[int]
    total: Mapped[int | None]
    result: Mapped[JsonObject | None]
    error: Mapped[str | None] = mapped_column(String(1000))
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    owner: Mapped[str | None] = mapped_column(String(100))  # who works on it, a new name each time it is taken up
    lease_until: Mapped[datetime | None]  # then another may take it up; the owner moves it on as long as it lives


class RejudgedRow(Base):
    """A measurement as another calibration judges it: kept aside until all of its axis are."""

    __tablename__ = "rejudged_measurements"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), primary_key=True)
    measurement_id: Mapped[int] = mapped_column(Identity, primary_key=True, autoincrement=False)
    seen_revision: Mapped[int]  # of the measurement: if it has another one now, it is to be judged once more
    measurement: Mapped[JsonObject | None]  # where and when it stands; None: its waveform is gone
    point: Mapped[JsonObject | None]  # of the trend
    outcome: Mapped[JsonObject | None]
    response: Mapped[JsonObject | None]
    refusals: Mapped[JsonObject | None]  # of windows that are refused otherwise now, by their start


class UserRow(Base):
    """A person who may log in."""

    __tablename__ = "users"

    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    role: Mapped[str] = mapped_column(String(16))
    password_hash: Mapped[str] = mapped_column(String(200))
    created_at: Mapped[datetime]
    disabled_at: Mapped[datetime | None]


class KeyRow(Base):
    """A key of a program. What the program sends is not kept, only its SHA-256."""

    __tablename__ = "api_keys"

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    name: Mapped[str] = mapped_column(String(64))
    secret_sha256: Mapped[str] = mapped_column(String(64), unique=True)
    scopes: Mapped[list[str]] = mapped_column(JSON)
    axes: Mapped[list[str] | None] = mapped_column(NullableJson)  # None: all
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]  # None: never
    revoked_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]  # to a minute or so


class BrowserSessionRow(Base):
    """Somebody who is logged in; of the cookie only the SHA-256 is kept."""

    __tablename__ = "browser_sessions"

    token_sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    user_name: Mapped[str] = mapped_column(ForeignKey("users.name"), index=True)
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime]


class AuditRow(Base):
    """One attempt to change something: written before it is tried, and with its answer after."""

    __tablename__ = "audit_log"
    __table_args__ = (
        Index("ix_audit_log_axis", "axis_id", "id"),
        _partial_index("ix_audit_log_logins", "who", "target", where="action = 'log in'"),
    )

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    at: Mapped[datetime]
    who: Mapped[str] = mapped_column(String(120))
    action: Mapped[str] = mapped_column(String(200))  # method and template of the route, or a command
    target: Mapped[str] = mapped_column(String(400))  # the path that was asked for, without its query
    axis_id: Mapped[str | None] = mapped_column(String(64))  # no foreign key: it may be refused because there is none
    status: Mapped[int | None]  # of the answer; None: the service ended before there was one
    request_id: Mapped[str | None] = mapped_column(String(64))  # under which the log of the service says more


class NoticeRow(Base):
    """Something that receivers outside are told: written with what it tells of, in one transaction."""

    __tablename__ = "notices"

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    at: Mapped[datetime]
    kind: Mapped[str] = mapped_column(String(60))
    subject: Mapped[str] = mapped_column(String(100))
    content: Mapped[JsonObject]


class ReceiverRow(Base):
    """How far a receiver has been told. Notices go to it one after the other, in their order."""

    __tablename__ = "receivers"

    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    told_until: Mapped[int] = mapped_column(BigInteger)  # number of the last notice that it has, or never gets
    n_tries: Mapped[int]  # of the next one, without success
    failing_since: Mapped[datetime | None]
    next_try_at: Mapped[datetime]
    last_error: Mapped[str | None] = mapped_column(String(500))
    last_told_at: Mapped[datetime | None]
    owner: Mapped[str | None] = mapped_column(String(100))  # which service tells it at this moment
    lease_until: Mapped[datetime | None]  # then another service may


class DeadLetterRow(Base):
    """A notice that a receiver never got, and why."""

    __tablename__ = "dead_letters"

    id: Mapped[int] = mapped_column(Identity, primary_key=True)
    receiver: Mapped[str] = mapped_column(ForeignKey("receivers.name"), index=True)
    notice_id: Mapped[int] = mapped_column(ForeignKey("notices.id"))
    at: Mapped[datetime]
    error: Mapped[str] = mapped_column(String(500))
