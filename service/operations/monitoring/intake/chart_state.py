"""The state of the charts of an axis as it is kept between measurements, and how an epoch of it begins.

What is believed of an axis are some three hundred numbers, and as many say since when a loss may have lasted. They
are stored as base64 of little-endian doubles: a fleet is read with every look at it, and lists of numbers take four
times as long to read.
"""

import base64
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from monitor_core.arrays import FloatArray
from monitor_core.axis_state import AxisState
from monitor_core.trend import (
    Bank,
    ClosedSession,
    DetectorDesign,
    DetectorState,
    JointState,
    Numbers,
    Said,
    TrendStatus,
    joint_reset,
    reset,
    state_at,
)
from service.documents.stored import StoredRecord
from service.json_types import Json, JsonObject
from service.store.intake import ChartsRecord
from service.store.tables import AxisRow
from service.store.trend.epochs import CALIBRATION, INSPECTION, UNKNOWN, EpochRecord
from service.store.trend.sessions import UNCALIBRATED, SessionRecord

#: Written where both beliefs are one.
_AS_LEARNT = "as learnt"
#: Members of the detector that hold such numbers, and what makes arrays of them.
_PACKED: dict[str, tuple[str, Callable[[FloatArray], Numbers]]] = {
    "learnt": ("bank", Bank.of), "known": ("bank", Bank.of), "beginnings": ("said", Said.of)
}  # fmt: skip
#: Members of the joint chart that hold such numbers.
_OF_JOINT = ("learnt", "before")
#: "or None", for pydantic takes no configuration for a dataclass alone.
_ADAPTER: TypeAdapter[AxisState] = TypeAdapter(
    AxisState | None,  # type: ignore[arg-type]
    config=ConfigDict(arbitrary_types_allowed=True),
)


def _text_of(numbers: Numbers) -> str:
    return _text(numbers.numbers())


def _text(numbers: FloatArray | list[float]) -> str:
    return base64.b64encode(np.asarray(numbers, dtype="<f8").tobytes()).decode()


def _packed(state: AxisState) -> JsonObject:
    detector = replace(state.detector, foreseen=None)
    as_learnt = detector.known is not None and detector.known == detector.learnt
    if as_learnt:
        detector = replace(detector, known=None)
    document = _ADAPTER.dump_python(replace(state, detector=detector), mode="json", fallback=_text_of)
    members = document["detector"]
    for name, (arrays, _) in _PACKED.items():
        if members[name] is not None:
            members[name]["numbers"] = members[name].pop(arrays)
    if as_learnt:
        members["known"] = _AS_LEARNT
    del members["foreseen"]
    if state.joint.uncompared_since is None:  # as in documents from before it was known
        del document["joint"]["uncompared_since"]
    for name in _OF_JOINT:
        member = document["joint"][name]
        if member is not None:
            member["numbers"] = _text(member["numbers"])
    return dict(document)


def _unpacked(document: JsonObject) -> AxisState:
    """Read a state with the numbers of its beliefs as arrays; what is no packed state is left to be refused."""
    stored = document.get("detector")
    if not isinstance(stored, dict):
        return _ADAPTER.validate_python(document)
    detector: dict[str, object] = stored | {"foreseen": None}
    for name, (arrays, of) in _PACKED.items():
        if name in stored:
            detector[name] = _with_numbers(stored[name], arrays, of)
    members: dict[str, object] = {**document, "detector": detector}
    joint = document.get("joint")
    if isinstance(joint, dict):
        numbers = {name: _with_numbers(joint.get(name), "numbers", np.ndarray.tolist) for name in _OF_JOINT}
        members["joint"] = joint | numbers
    as_learnt = detector.get("known") == _AS_LEARNT
    if as_learnt:
        detector["known"] = None
    state = _ADAPTER.validate_python(members)
    return replace(state, detector=replace(state.detector, known=state.detector.learnt)) if as_learnt else state


def _with_numbers(member: object, name: str, of: Callable[[FloatArray], object]) -> object:
    """Return a member with its packed numbers unpacked under a name; one that holds none is left as it is."""
    if isinstance(member, dict) and isinstance(member.get("numbers"), str):
        with suppress(ValueError):
            numbers = np.frombuffer(base64.b64decode(member["numbers"], validate=True), "<f8")
            return {key: value for key, value in member.items() if key != "numbers"} | {name: of(numbers)}
    return member


_STATE = StoredRecord(
    "state of the charts",
    _ADAPTER,
    version=10,  # combinations of several numbers are watched
    remedy="restore the backup, or activate another calibration, which begins a new baseline",
    added=frozenset({"drive", "as_loss"}),
    packed=_packed,
    unpacked=_unpacked,
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
    return AxisState() if document is None else _STATE.load(document)


def dump_state(state: AxisState) -> JsonObject:
    """Return the state as a JSON document."""
    return _STATE.dump(state)


def load_design(document: Json) -> DetectorDesign:
    """Return the stored limits of the charts."""
    return _DESIGN.load(document)


def dump_design(design: DetectorDesign) -> JsonObject:
    """Return the limits of the charts as a JSON document."""
    return _DESIGN.dump(design)


def is_outdated(charts: ChartsRecord | AxisRow) -> bool:
    """Tell whether state or limits of the charts were written by an older version, and so cannot be gone on with."""
    return is_outdated_state(charts.monitor_state) or _DESIGN.is_older(charts.detector_design)


def is_outdated_state(document: Json) -> bool:
    """Tell whether a state was written by an older version."""
    return _STATE.is_older(document)


def begun(epoch: EpochRecord, before: AxisState) -> AxisState:
    """Return the charts as they begin an epoch. A person decides that, never the detector.

    After an inspection the level is learnt anew. With another calibration or another nut nothing is known but what
    sisters lent: the charts watch another number now, or another axis.
    """
    if epoch.begun_by == INSPECTION:
        law = None if before.sums else before.law
        return AxisState(reset(before.detector), law=law, joint=joint_reset(before.joint))
    if epoch.begun_by == UNKNOWN:
        stored = load_state(epoch.state)
        return AxisState(stored.detector, joint=stored.joint)
    prior = load_state(epoch.state).detector.prior if epoch.begun_by == CALIBRATION else before.detector.prior
    detector = DetectorState(last_at=before.detector.last_at, prior=prior)
    return AxisState(detector, joint=JointState(last_at=before.joint.last_at))


def state_now(axis: AxisRow, at: datetime, silent_after_hours: float) -> tuple[str, datetime | None]:
    """Tell how an axis stands now, and since when; silence is ``unknown``."""
    status, silence = TrendStatus(axis.state), timedelta(hours=silent_after_hours)
    state = state_at(DetectorState(status=status, last_at=axis.last_charted_at), at, silence)
    if state is not status and axis.last_charted_at is not None:
        return str(state), axis.last_charted_at + silence
    return str(state), axis.state_since if state is not TrendStatus.UNKNOWN else axis.last_charted_at


def session_record(axis_number: int, calibration_id: int | None, epoch: int, over: ClosedSession) -> SessionRecord:
    """Return a session that is over as it is stored."""
    session = over.session
    return SessionRecord(
        axis_number=axis_number,
        calibration_id=calibration_id or UNCALIBRATED,
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
