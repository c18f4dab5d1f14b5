"""The state of an axis as it is kept between measurements: the core's record, as JSON."""

from datetime import datetime, timedelta
from typing import Any

from pydantic import TypeAdapter

from monitor_core.pipeline import AxisState
from monitor_core.trend import reset, state_at

_STATE: TypeAdapter[AxisState] = TypeAdapter(AxisState)


def load_state(document: dict[str, Any] | None) -> AxisState:
    """Return the stored state, or that of an axis nothing is known about."""
    return AxisState() if document is None else _STATE.validate_python(document)


def dump_state(state: AxisState) -> dict[str, Any]:
    """Return the state as a JSON document."""
    document: dict[str, Any] = _STATE.dump_python(state, mode="json")
    return document


def begin_new_baseline(document: dict[str, Any] | None) -> dict[str, Any] | None:
    """Begin a new baseline after somebody inspected the axis; a person decides that, never the detector."""
    if document is None:
        return None
    return dump_state(AxisState(detector=reset(load_state(document).detector)))


def state_now(document: dict[str, Any] | None, at: datetime, silent_after_hours: float) -> tuple[str, datetime | None]:
    """Tell how an axis stands now, and when it last was measured; silence is ``unknown``."""
    detector = load_state(document).detector
    return str(state_at(detector, at, timedelta(hours=silent_after_hours))), detector.last_at
