"""Define the tables of the trend: as long as the history, so they are narrow and lie in the order of reading."""

from datetime import datetime

from sqlalchemy import BigInteger, String
from sqlalchemy.orm import Mapped, mapped_column

from service.json_types import JsonObject
from service.store.tables import Base, UtcMicroseconds

_CLUSTERED = {"sqlite_with_rowid": False}


def _key() -> Mapped[int]:
    return mapped_column(primary_key=True, autoincrement=False)


class TrendPointRow(Base):
    """A measurement that was judged, as trend and charts need it."""

    __tablename__ = "trend_points"
    __table_args__ = _CLUSTERED

    axis_number: Mapped[int] = _key()
    at: Mapped[datetime] = mapped_column(UtcMicroseconds, primary_key=True)
    measurement_id: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    name: Mapped[str] = mapped_column(String(200))
    position_mm: Mapped[float]
    set_preload_n: Mapped[float | None]
    payload_kg: Mapped[float | None]
    temperature_c: Mapped[float | None]
    refusal_reason: Mapped[str | None] = mapped_column(String(40))
    calibration_id: Mapped[int | None] = mapped_column(BigInteger)
    frequency_hz: Mapped[float | None]
    preload_n: Mapped[float | None]
    interval_lower_n: Mapped[float | None]
    interval_upper_n: Mapped[float | None]
    drag_torque_nm: Mapped[float | None]
    feature_s2: Mapped[float | None]
    feature_uncertainty_s2: Mapped[float | None]  # of the frequency alone
    epoch: Mapped[int]  # of the charts, when it was judged
    uncharted: Mapped[str | None] = mapped_column(String(20))  # why it moved no chart
    state: Mapped[str] = mapped_column(String(16))  # of the axis, after this measurement
    baseline_preload_n: Mapped[float | None]
    doubt: Mapped[str | None] = mapped_column(String(40))  # what speaks against its preload
    feature_scatter_s2: Mapped[float | None]  # what its interval allows for, of what is new in each session
    learnt_scatter_s2: Mapped[float | None]  # from session to session, as the axis had shown before
    place_uncertainty: Mapped[float | None]  # of its preload against other places of its session, relative
    places_disagree: Mapped[str | None]  # how the places of its session contradict each other, in words


class TrendRollupRow(Base):
    """What an hour or a day of the trend holds, with its extremes."""

    __tablename__ = "trend_rollups"
    __table_args__ = _CLUSTERED

    axis_number: Mapped[int] = _key()
    span_s: Mapped[int] = _key()  # 3600 or 86400
    starts_at: Mapped[datetime] = mapped_column(UtcMicroseconds, primary_key=True)
    n_measurements: Mapped[int]
    n_refused: Mapped[int]
    first_at: Mapped[datetime] = mapped_column(UtcMicroseconds)
    lowest_n: Mapped[float | None]
    lowest_at: Mapped[datetime | None] = mapped_column(UtcMicroseconds)
    highest_n: Mapped[float | None]
    highest_at: Mapped[datetime | None] = mapped_column(UtcMicroseconds)


class SessionRow(Base):
    """A session that is over: its measurements summed up, and what the charts made of it."""

    __tablename__ = "sessions"
    __table_args__ = _CLUSTERED

    axis_number: Mapped[int] = _key()
    calibration_id: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    started_at: Mapped[datetime] = mapped_column(UtcMicroseconds, primary_key=True)
    epoch: Mapped[int]
    last_at: Mapped[datetime] = mapped_column(UtcMicroseconds)
    n_measurements: Mapped[int]
    feature_s2: Mapped[float]  # mean
    temperature_c: Mapped[float | None]
    drag_torque_nm: Mapped[float | None]
    residual: Mapped[float | None]  # in standard deviations; none while the baseline was learnt
    reference: Mapped[float | None]  # of the CUSUM
    alarmed: Mapped[bool]


class ChartCheckpointRow(Base):
    """The charts of an axis as they stood after a measurement: what arrives late is put in from there."""

    __tablename__ = "chart_checkpoints"
    __table_args__ = _CLUSTERED

    axis_number: Mapped[int] = _key()
    epoch: Mapped[int] = _key()
    at: Mapped[datetime] = mapped_column(UtcMicroseconds, primary_key=True)
    state: Mapped[JsonObject]


class ChartEpochRow(Base):
    """Where the charts of an axis begin anew, or learn the level again, in the time of its measurements."""

    __tablename__ = "chart_epochs"
    __table_args__ = _CLUSTERED

    axis_number: Mapped[int] = _key()
    begins_at: Mapped[datetime] = mapped_column(UtcMicroseconds, primary_key=True)
    begun_by: Mapped[str] = mapped_column(String(16), primary_key=True)  # see service.store.trend.epochs
    epoch: Mapped[int | None]  # counted in order of time; None: the charts have not come here yet
    calibration_id: Mapped[int | None] = mapped_column(BigInteger)  # that it is charted under
    state: Mapped[JsonObject | None]  # of the charts when it begins
