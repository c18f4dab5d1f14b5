"""The state of an axis as it is kept between measurements: the core's records, as JSON."""

from datetime import datetime, timedelta

from pydantic import TypeAdapter

from monitor_core.pipeline import AxisState
from monitor_core.trend import DetectorDesign, DetectorState, TrendStatus, reset, state_at
from service.documents.stored import StoredRecord
from service.json_types import JsonObject
from service.store.tables import AxisRow

_STATE = StoredRecord(
    "state of the charts",
    TypeAdapter(AxisState),
    version=1,
    remedy="restore the backup, or activate another calibration, which begins a new baseline",
)
_DESIGN = StoredRecord(
    "limits of the charts",
    TypeAdapter(DetectorDesign),
    version=1,
    remedy="restore the backup, or send the configuration of the axis again, which solves new ones",
)


def load_state(document: JsonObject | None) -> AxisState:
    """Return the stored state, or that of an axis nothing is known about.

    Raises DocumentDamagedError, here and below, if what is stored cannot be read.
    """
    return AxisState() if document is None else _STATE.load(document)


def dump_state(state: AxisState) -> JsonObject:
    """Return the state as a JSON document."""
    return _STATE.dump(state)


def load_design(document: JsonObject) -> DetectorDesign:
    """Return the stored limits of the charts."""
    return _DESIGN.load(document)


def dump_design(design: DetectorDesign) -> JsonObject:
    """Return the limits of the charts as a JSON document."""
    return _DESIGN.dump(design)


def begin_epoch(axis: AxisRow) -> None:
    """Begin a new baseline: the charts watch another number now, or somebody inspected the axis and found it in order.

    A person decides that, never the detector. What was measured until now moves no chart any more.
    """
    state = AxisState(reset(DetectorState(last_at=axis.last_charted_at)))
    axis.epoch += 1
    axis.epoch_after, axis.epoch_from = axis.last_charted_at, None
    axis.since_checkpoint = 0
    axis.monitor_state = dump_state(state)
    axis.state, axis.state_since = str(state.detector.status), None


def state_now(axis: AxisRow, at: datetime, silent_after_hours: float) -> tuple[str, datetime | None]:
    """Tell how an axis stands now, and since when; silence is ``unknown``."""
    status, silence = TrendStatus(axis.state), timedelta(hours=silent_after_hours)
    state = state_at(DetectorState(status=status, last_at=axis.last_charted_at), at, silence)
    if state is not status and axis.last_charted_at is not None:
        return str(state), axis.last_charted_at + silence
    return str(state), axis.state_since if state is not TrendStatus.UNKNOWN else axis.last_charted_at
