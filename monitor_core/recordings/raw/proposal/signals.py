"""What drives the axis in a raw file, what answers, and what can be said of an axis by these two."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from monitor_core.recording import ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.recordings.elements.units import Quantity, quantity_of_unit
from monitor_core.recordings.raw.channel_kind import DRIVES, is_error, is_of_motor, is_planned
from monitor_core.recordings.raw.proposal.parts import Part, first_like

_WORDS_OF_SENSOR = ("sensor", "cell", "hammer", "transduc", "screw", "shaft", "load")
#: What a channel may be as a response, the best first; a position, or a velocity, is that of table or of motor.
_ANSWERS = (
    (Quantity.ACCELERATION, ResponseQuantity.ACCELERATION, ResponseQuantity.ACCELERATION),
    (Quantity.POSITION, ResponseQuantity.DISPLACEMENT, ResponseQuantity.MOTOR_ANGLE),
    (Quantity.VELOCITY, ResponseQuantity.VELOCITY, ResponseQuantity.MOTOR_SPEED),
    (Quantity.ANGLE, ResponseQuantity.MOTOR_ANGLE, ResponseQuantity.MOTOR_ANGLE),
    (Quantity.SPEED, ResponseQuantity.MOTOR_SPEED, ResponseQuantity.MOTOR_SPEED),
)
_MOTOR_OF = re.compile(r"mot|rotor|_m\b", re.IGNORECASE)
#: What a reference may be, the best first: a speed is often asked for by the controller of the position.
_REFERENCES: tuple[Quantity | None, ...] = (
    Quantity.ACCELERATION, Quantity.POSITION, Quantity.ANGLE, Quantity.VELOCITY, Quantity.SPEED,
)  # fmt: skip
_PREFERRED = tuple(ResponseQuantity)
_NAMED = {
    ResponseQuantity.VELOCITY: "the velocity",
    ResponseQuantity.DISPLACEMENT: "the scale",
    ResponseQuantity.MOTOR_ANGLE: "the angle of the motor",
    ResponseQuantity.MOTOR_SPEED: "the speed of the motor",
    ExcitationQuantity.TORQUE: "the torque",
    ExcitationQuantity.FORCE: "the force",
    ExcitationQuantity.CURRENT: "the current",
    ExcitationQuantity.ACCELERATION: "the commanded acceleration",
}


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """What may be excitation and response; ``None``: nothing says it."""

    excitation: Part | None
    excited: ExcitationQuantity | None
    source: ExcitationSource
    response: Part | None
    answers: ResponseQuantity
    motor: Part | None = None  # its angle, where the response is a scale
    reference: Part | None = None  # a set-point, where the drive's own torque or current excites

    @property
    def known(self) -> list[Part]:
        """The channels of both."""
        return [part for part in (self.excitation, self.response) if part is not None]


def signals_in(parts: Sequence[Part]) -> Signals:
    """Return what may be excitation and response: by what they look like, else in the order of the file.

    An accelerometer goes before a scale, a scale before the motor; what is planned is never a response.
    """
    excitation = first_like(parts, DRIVES)
    commanded = _commanded_acceleration(parts)
    if excitation is None or (is_planned(excitation.channel.name) and commanded is not None):
        excitation = commanded
    longest = max((part.size for part in parts), default=0)
    left = [part for part in parts if part.kind is None and part.size == longest and part.varies]
    if excitation is None and left:
        excitation = left.pop(0)
    found = dict(_responses(parts))
    answers = next((quantity for quantity in _PREFERRED if quantity in found), ResponseQuantity.ACCELERATION)
    response = found.get(answers) or (left.pop(0) if left else None)
    motor = found.get(ResponseQuantity.MOTOR_ANGLE) if answers is ResponseQuantity.DISPLACEMENT else None
    excited = _excited(excitation)
    source = _source(excitation, excited)
    reference = _reference(parts, longest) if source is ExcitationSource.DRIVE else None
    return Signals(excitation, excited, source, response, answers, motor, reference)


def _reference(parts: Sequence[Part], longest: int) -> Part | None:
    """Return what a control was told from outside of its loop: no torque that it asks for itself, and no error."""
    found = [p for p in parts if p.size == longest and p.varies and p.unit and is_planned(p.channel.name)]
    found = [part for part in found if part.kind in _REFERENCES and not is_error(part.channel.name)]
    return min(found, key=lambda part: _REFERENCES.index(part.kind), default=None)


def caution_of(reference: Part) -> str:
    """Say when a set-point is no reference: that of a speed is often made by the controller of the position."""
    of_speed = reference.kind in (Quantity.VELOCITY, Quantity.SPEED)
    return ", unless a position controller makes this speed" if of_speed else ""


def what_they_show(signals: Signals) -> str:
    """Say what a file without an acceleration can tell of the axis, and what it cannot; empty where it has one."""
    if signals.response is None or signals.answers is ResponseQuantity.ACCELERATION or signals.excitation is None:
        return ""
    response, excited = f"{_NAMED[signals.answers]} {signals.response.channel.name!r}", signals.excited
    excitation = f"{'the drive' if excited is None else _NAMED[excited]} {signals.excitation.channel.name!r}"
    loop = ""
    if signals.source is ExcitationSource.DRIVE and signals.reference is None:
        loop = "; what the control loop does to the frequency stays unknown without a set-point beside them"
    elif signals.reference is not None:
        loop = f"; {signals.reference.channel.name!r} as [reference] takes off what the control loop does to it"
        loop += caution_of(signals.reference)
    shown = f"no acceleration: natural frequency, damping and, with a calibration, preload from {response} and"
    if excited is ExcitationQuantity.CURRENT:
        lacking = "the torque constant is not stated"
    elif excited is ExcitationQuantity.ACCELERATION:
        lacking = "no torque and no force is known"
    elif signals.answers.is_of_motor:
        lacking = "the table itself is not measured"
    else:
        return f"{shown} {excitation}{loop}"
    return f"{shown} {excitation}; no modal mass and no friction torque, because {lacking}{loop}"


def _responses(parts: Sequence[Part]) -> Iterator[tuple[ResponseQuantity, Part]]:
    """Yield the first channel that was measured of each quantity that may be a response."""
    seen = set[ResponseQuantity]()
    for kind, of_table, of_motor in _ANSWERS:
        measured = [part for part in parts if part.kind is kind and not is_planned(part.channel.name)]
        if of_table is of_motor:  # what turns: the motor's before that of a screw or an encoder beside it
            measured.sort(key=lambda part: not _MOTOR_OF.search(part.channel.name))
        for part in measured:
            quantity = of_motor if is_of_motor(part.channel.name) else of_table
            if quantity not in seen:
                seen.add(quantity)
                yield quantity, part


def _commanded_acceleration(parts: Sequence[Part]) -> Part | None:
    accelerations = [part for part in parts if part.kind is Quantity.ACCELERATION]
    return next((part for part in accelerations if is_planned(part.channel.name)), None)


def _excited(part: Part | None) -> ExcitationQuantity | None:
    """Return what drives the axis as the unit says, else as the name says; None where neither does."""
    if part is None:
        return None
    quantity = quantity_of_unit(part.unit)
    for stated in (quantity, part.kind):
        if stated is not None and str(stated) in list(ExcitationQuantity):
            return ExcitationQuantity(str(stated))
    return None


def _source(part: Part | None, excited: ExcitationQuantity | None) -> ExcitationSource:
    name = "" if part is None else part.channel.name.lower()
    if excited is ExcitationQuantity.ACCELERATION or is_planned(name):
        return ExcitationSource.COMMANDED
    if excited is ExcitationQuantity.CURRENT:
        return ExcitationSource.DRIVE
    by_sensor = excited is not ExcitationQuantity.TORQUE or any(word in name for word in _WORDS_OF_SENSOR)
    return ExcitationSource.SENSOR if by_sensor else ExcitationSource.DRIVE


def quantity_of(excited: ExcitationQuantity | None) -> Quantity | None:
    """Return what the numbers of an excitation measure."""
    return None if excited is None else Quantity(str(excited))
