"""The state of the charts of an axis as it is kept between measurements, and how an epoch of it begins.

What is believed of an axis are some three hundred numbers, and as many say since when a loss may have lasted. They
are stored as base64 of little-endian doubles: a fleet is read with every look at it, and lists of numbers take four
times as long to read.
"""

import base64
from contextlib import suppress
from datetime import datetime, timedelta

import numpy as np
from pydantic import TypeAdapter

from monitor_core.pipeline import AxisState
from monitor_core.trend import (
    ClosedSession,
    DetectorDesign,
    DetectorState,
    TrendStatus,
    reset,
    state_at,
)
from service.documents.stored import StoredRecord
from service.json_types import Json, JsonObject
from service.store.intake import ChartsRecord
from service.store.tables import AxisRow
from service.store.trend.epochs import CALIBRATION, INSPECTION, UNKNOWN, EpochRecord
from service.store.trend.sessions import SessionRecord

#: Written where both beliefs are one.
_AS_LEARNT = "as learnt"
_PACKED = ("learnt", "known", "beginnings")  # members of the detector that hold such numbers
_STATE = StoredRecord(
    "state of the charts",
    TypeAdapter(AxisState),
    version=6,  # friction is that of all moves, known in nearly every measurement
    remedy="restore the backup, or activate another calibration, which begins a new baseline",
)
_DESIGN = StoredRecord(
    "limits of the charts",
    TypeAdapter(DetectorDesign),
    version=4,  # the sessions a year that they are for
    remedy="restore the backup, or send the configuration of the axis again, which solves new ones",
)


def load_state(document: Json) -> AxisState:
    """Return the stored state, or that of an axis nothing is known about.

    Raises DocumentDamagedError, here and below, if what is stored cannot be read.
    """
    return AxisState() if document is None else _STATE.load(_unpacked(document))


def dump_state(state: AxisState) -> JsonObject:
    """Return the state as a JSON document."""
    document = _STATE.dump(state)
    detector = document["detector"]
    if isinstance(detector, dict):
        if detector["known"] == detector["learnt"]:
            detector["known"] = _AS_LEARNT
        for member in [detector[name] for name in _PACKED if isinstance(detector[name], dict)]:
            member["numbers"] = base64.b64encode(np.array(member["numbers"], "<f8").tobytes()).decode()
    return document


def _unpacked(document: Json) -> Json:
    """Return a state with the numbers of its beliefs as lists; what is no packed state is left to be refused."""
    detector = document.get("detector") if isinstance(document, dict) else None
    if not isinstance(document, dict) or not isinstance(detector, dict):
        return document
    members = {name: _unpacked_member(detector.get(name)) for name in _PACKED}
    if members["known"] == _AS_LEARNT:
        members["known"] = members["learnt"]
    present = {name: member for name, member in members.items() if name in detector}
    return document | {"detector": detector | present}


def _unpacked_member(member: Json) -> Json:
    packed = member.get("numbers") if isinstance(member, dict) else None
    if not isinstance(member, dict) or not isinstance(packed, str):
        return member
    with suppress(ValueError):
        return member | {"numbers": np.frombuffer(base64.b64decode(packed, validate=True), "<f8").tolist()}
    return member


def load_design(document: Json) -> DetectorDesign:
    """Return the stored limits of the charts."""
    return _DESIGN.load(document)


def dump_design(design: DetectorDesign) -> JsonObject:
    """Return the limits of the charts as a JSON document."""
    return _DESIGN.dump(design)


def is_outdated(charts: ChartsRecord | AxisRow) -> bool:
    """Tell whether state or limits of the charts were written by an older version, and so cannot be gone on with."""
    return _STATE.is_older(charts.monitor_state) or _DESIGN.is_older(charts.detector_design)


def begun(epoch: EpochRecord, before: DetectorState) -> DetectorState:
    """Return the detector as it begins an epoch. A person decides that, never the detector.

    After an inspection the level is learnt anew. With another calibration or another nut nothing is known but what
    sisters lent: the charts watch another number now, or another axis.
    """
    if epoch.begun_by == INSPECTION:
        return reset(before)
    if epoch.begun_by == UNKNOWN:
        return load_state(epoch.state).detector
    prior = load_state(epoch.state).detector.prior if epoch.begun_by == CALIBRATION else before.prior
    return DetectorState(last_at=before.last_at, prior=prior)


def state_now(axis: AxisRow, at: datetime, silent_after_hours: float) -> tuple[str, datetime | None]:
    """Tell how an axis stands now, and since when; silence is ``unknown``."""
    status, silence = TrendStatus(axis.state), timedelta(hours=silent_after_hours)
    state = state_at(DetectorState(status=status, last_at=axis.last_charted_at), at, silence)
    if state is not status and axis.last_charted_at is not None:
        return str(state), axis.last_charted_at + silence
    return str(state), axis.state_since if state is not TrendStatus.UNKNOWN else axis.last_charted_at


def session_record(axis_number: int, calibration_id: int, epoch: int, over: ClosedSession) -> SessionRecord:
    """Return a session that is over as it is stored."""
    session = over.session
    return SessionRecord(
        axis_number=axis_number,
        calibration_id=calibration_id,
        started_at=session.started_at,
        epoch=epoch,
        last_at=session.last_at,
        n_measurements=session.count,
        feature_s2=session.value,
        temperature_c=session.temperature,
        friction_torque_nm=session.friction_torque,
        residual=over.residual,
        reference=over.reference,
        alarmed=over.alarmed,
    )
