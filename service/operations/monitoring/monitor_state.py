"""The state of an axis as it is kept between measurements: the core's records, as JSON."""

from datetime import datetime, timedelta

from pydantic import TypeAdapter

from monitor_core.pipeline import AxisState
from monitor_core.trend import DetectorDesign, TrendStatus, reset, state_at
from service.documents.stored import StoredRecord
from service.json_types import JsonObject

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


def begin_new_baseline(document: JsonObject | None) -> JsonObject | None:
    """Begin a new baseline after somebody inspected the axis; a person decides that, never the detector."""
    if document is None:
        return None
    return dump_state(AxisState(detector=reset(load_state(document).detector)))


def state_now(document: JsonObject | None, at: datetime, silent_after_hours: float) -> tuple[str, datetime | None]:
    """Tell how an axis stands now, and since when; silence is ``unknown``."""
    detector = load_state(document).detector
    silence = timedelta(hours=silent_after_hours)
    state = state_at(detector, at, silence)
    if state is not detector.status and detector.last_at is not None:
        return str(state), detector.last_at + silence
    return str(state), detector.since if state is not TrendStatus.UNKNOWN else detector.last_at
