"""Name what the service answers, as it answers it: moments are RFC 3339 in UTC, units are in the names."""

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias, TypedDict

Document: TypeAlias = Mapping[str, object]


class LostMotionNow(TypedDict):
    """The newest lost motion of an axis, and the state of its chart."""

    measured_at: str
    reversal_value_um: float
    reversal_value_interval_95_um: tuple[float, float]
    state: str
    valid_until: str | None


class Axis(TypedDict):
    """An axis and how it stands."""

    id: str
    name: str
    created_at: str
    configuration: Document
    active_calibration: int | None
    state: str
    state_since: str | None
    last_measurement: Document | None
    refused_windows: Mapping[str, int]
    uncharted: Mapping[str, int]
    open_alarms: int
    preload_left: Document | None
    lost_motion: LostMotionNow | None
    stale: Document | None
    archived_at: str | None


class TrendPoint(TypedDict):
    """One measurement: a preload with its interval, without a calibration the fall of its frequency, or a refusal."""

    measurement_id: int
    measurement: str
    at: str
    position_mm: float
    status: Literal["judged", "refused"]
    frequency_hz: float | None
    preload_n: float | None
    interval_95_n: tuple[float | None, float | None] | None
    friction_torque_nm: float | None
    drag_torque_nm: float | None
    state: str | None
    refusal_reason: str | None
    uncharted: str | None
    calibration: int | None
    doubt: str | None
    frequency_fall_percent: float | None
    frequency_fall_interval_95_percent: tuple[float | None, float | None] | None


class LostMotionPoint(TypedDict):
    """Lost motion at the reversals of one log, with the 95 % interval of that part of it that is play."""

    at: str
    measurement: str
    position_mm: float
    reversal_value_um: float
    reversal_value_standard_uncertainty_um: float
    reversal_value_interval_95_um: tuple[float, float]
    play_interval_95_um: tuple[float, float] | None
    n_reversals: int
    temperature_c: float | None
    state: str
    uncharted: str | None


class LostMotionReceipt(TypedDict):
    """How many readings were new, and how lost motion stands with them."""

    accepted: int
    already_there: int
    state: str
    sentence: str


class WindowStatus(TypedDict):
    """What became of one window."""

    started_at: str
    measurement: str
    status: Literal["accepted", "refused", "already-there"]
    reason: str | None
    detail: str | None


class Receipt(TypedDict):
    """What became of the windows of a request, and of the measurements that were judged with them."""

    accepted: int
    refused: int
    already_there: int
    windows: Sequence[WindowStatus]
    measurements: Sequence[Document]


class AlarmEvent(TypedDict):
    """One change of an alarm."""

    id: int
    at: str
    kind: Literal["comment", "shelved", "back"] | None
    old_status: str | None
    new_status: str
    reason: str
    who: str | None


class Alarm(TypedDict):
    """An alarm with its evidence, its cause as far as it was examined, and its history."""

    id: int
    axis: str
    measurement_id: int | None
    kind: str
    raised_at: str
    status: Literal["active", "acknowledged", "cleared", "withdrawn"]
    evidence: Document
    explanation: Document
    shelved_until: str | None
    events: Sequence[AlarmEvent]


class Measurement(TypedDict):
    """One measurement: its outcome, its windows, and what its value rests on."""

    measurement_id: int
    measurement: str
    at: str
    status: str
    outcome: Document | None
    windows: Sequence[Document]
    let_go: str | None
    response: Document | None
    gates: Sequence[Document]
    ladder: Document | None


class Calibration(TypedDict):
    """A stored calibration; ``document`` is the file of ``preload calibrate``."""

    id: int
    axis: str
    created_at: str
    comment: str
    active: bool
    document: Document


class Calibrations(TypedDict):
    """The calibrations of an axis, and which came into force when and why, newest first."""

    calibrations: Sequence[Calibration]
    history: Sequence[Document]


class MaintenanceEntry(TypedDict):
    """What was done to an axis; an entry that another one ``corrects`` does not hold any more."""

    id: int
    at: str
    entered_at: str
    who: str
    kind: str
    note: str
    set_preload_n: float | None
    corrects: int | None


class Job(TypedDict):
    """A job as it stands."""

    id: str
    kind: str
    axis: str
    arguments: Document
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    done: int
    total: int | None
    result: Document | None
    error: str | None
    created_at: str
    updated_at: str
