"""Find the measurements that new windows are of, and decide which of these are complete.

Which windows make a measurement is the core's to say (:func:`~monitor_core.recording.measurements_of`), of all windows
of a name together: so what is stored does not depend on the order in which they came. A window that came late may join
two measurements, or part one.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Protocol

from monitor_core.recording import Placed, Rejection, RejectionReason, Visit, Window, measurements_of
from monitor_core.recordings.elements.units import to_millimetres
from service.clock import text_of
from service.operations.monitoring.axis_configuration import AxisConfiguration, visit_of
from service.store.intake import OPEN, MeasurementRecord, StoredMember

#: A window that says it began so long after it arrived comes from a clock that is wrong: put into the charts, it would
#: make everything that is measured until then too old for them.
MOST_AHEAD = timedelta(minutes=10)
#: Stored measurements that new windows may change in a row: each is read and judged again, while other axes wait.
MOST_CHANGED = 20


class StoredHistory(Protocol):
    """What is stored of the axis, as far as it is asked for."""

    def called(self, name: str, since: datetime, until: datetime) -> "list[Measured]":
        """Return the measurements of one name that lie between two moments, or reach there, in time order."""
        ...

    def members_of(self, row: MeasurementRecord) -> list[StoredMember]:
        """Return the windows that tell what a measurement is made of, in time order."""
        ...

    def closed(self, row: MeasurementRecord) -> str | None:
        """Say why a measurement that was judged takes no more windows, if so."""
        ...


@dataclass(slots=True, eq=False)
class Measured:
    """A measurement and the windows that tell what it is made of, as they stand with the new ones."""

    row: MeasurementRecord
    was: list[tuple[datetime, int]] = field(default_factory=list)  # starts and numbers of what was judged before
    members: "list[Member]" = field(default_factory=list)
    has_changed: bool = False  # its windows have
    is_due: bool = False  # windows of it were judged already


@dataclass(slots=True, eq=False)
class Member:
    """A window and its measurement, which names its windows in turn.

    Samples are kept elsewhere: in a circle they would stay in memory until the collector of Python comes by.
    """

    placed: Placed
    of: Measured | None  # None: it is new, and of none yet
    accepted: bool
    is_new: bool = False  # else it is stored already
    refusal: Rejection | None = None  # of a new one


@dataclass(slots=True)
class Admission:
    """Puts new windows into the measurements of an axis. Nothing is stored here."""

    axis_id: str
    configuration: AxisConfiguration
    received_at: datetime
    history: StoredHistory
    admitted: list[Member] = field(default_factory=list)  # new windows, in the order of their time
    measured: dict[datetime, Measured] = field(default_factory=dict)  # by the start of each window that was looked at
    moved: list[tuple[datetime, Measured, Measured]] = field(default_factory=list)  # stored windows: start, from, to
    joined: dict[Measured, Measured] = field(default_factory=dict)  # measurements that are a part of another now

    def admit(self, windows: Sequence[Window], gate: Callable[[Window], Rejection | None]) -> None:
        """Put new windows, in the order of their time, each with what the gate says of it, into their measurements."""
        by_name: dict[str, list[Member]] = {}
        for window in windows:
            ahead = window.started_at - self.received_at > MOST_AHEAD
            refusal = self._clock(window) if ahead else gate(window)
            member = Member(window.placed, None, accepted=refusal is None, is_new=True, refusal=refusal)
            self.admitted.append(member)
            by_name.setdefault(window.measurement, []).append(member)
        for members in by_name.values():
            ahead_of_time = [m for m in members if m.placed.started_at - self.received_at > MOST_AHEAD]
            in_time = members[: len(members) - len(ahead_of_time)]
            while in_time:
                groups, hollow, in_time = self._run(in_time)
                self._distribute(groups, hollow)
            if ahead_of_time:
                self._put_aside(ahead_of_time)

    def changed(self) -> list[Measured]:
        """Return the measurements that have other windows now, each once."""
        return [measurement for measurement in dict.fromkeys(self.measured.values()) if measurement.has_changed]

    def complete(self, said: Collection[Measured]) -> list[Measured]:
        """Return what is to be judged, in time order.

        That is what is said to be complete, what has enough windows, and what was judged and has other ones now: a
        value rests on all the windows of its measurement, in whatever order they came.
        """
        enough = self.configuration.windows_per_measurement
        changed = self.changed()
        complete = [measurement for measurement in said if measurement.row.status == OPEN]
        complete += [
            measurement for measurement in changed if measurement.is_due or measurement.row.n_accepted >= enough
        ]
        return sorted(dict.fromkeys(complete), key=lambda measurement: measurement.row.started_at)

    def _run(self, new: Sequence[Member]) -> tuple[list[list[Member]], list[Measured], list[Member]]:
        """Return windows of one name by measurement, from the first new one to the first stored one that stays.

        Stored measurements and new windows are taken in one after the other, in the order of their time, from the
        stored one which the first new window may be of: what lies between two new windows that are far apart is not
        looked at. Stored measurements on the way that hold no window yet, and the new windows that were not reached,
        are returned besides.
        """
        members, ahead = [new[0]], list(new[1:])
        visit, hollow = visit_of(self.configuration), list[Measured]()
        name, first = new[0].placed.name, new[0].placed.started_at
        looked_until, waiting, seen, taken = first, list[Measured](), set[Measured](), list[Measured]()
        while members:
            until = max(member.placed.ended_at for member in members) + visit.pause
            if until > looked_until:
                looked_until = until
                for member in ahead:  # those that follow without a pause are looked for together
                    if member.placed.started_at > looked_until:
                        break
                    looked_until = max(looked_until, member.placed.ended_at + visit.pause)
                around = self.history.called(name, first - visit.pause, looked_until)
                begun = [m for m in around if m.row.started_at <= first and self.load(m)]
                newest = max(begun, key=lambda measurement: measurement.row.started_at, default=None)
                passed = seen.union(measurement for measurement in begun if measurement is not newest)
                waiting = [measurement for measurement in around if measurement not in passed]
            stored = self.load(waiting[0]) if waiting else []
            before = stored[0].placed.started_at if stored else until
            if ahead and (stored or not waiting) and ahead[0].placed.started_at <= before:
                members.append(ahead.pop(0))
                continue
            groups = _by_measurement(members, visit)
            if not waiting:
                return groups, hollow, ahead
            following = waiting.pop(0)
            seen.add(following)
            if not stored:
                hollow += [following] if following.row.status == OPEN else []
            elif self._stays(stored, members, groups[-1], visit):
                return groups, hollow, ahead
            elif (why := self.history.closed(following.row)) is not None:
                while ahead and ahead[0].placed.started_at <= following.row.ended_at + visit.pause:
                    members.append(ahead.pop(0))
                members = self._kept_out(members, following, why, visit)
            else:
                members += stored
                taken.append(following)
                if len(taken) > MOST_CHANGED:
                    why = f"late windows may change {MOST_CHANGED} stored measurements in a row; these change more"
                    self._refuse([member for member in members if member.is_new], taken[0], why)
                    return [], hollow, ahead
        return [], hollow, ahead

    @staticmethod
    def _stays(stored: Sequence[Member], members: Sequence[Member], last: Sequence[Member], visit: Visit) -> bool:
        """Tell whether a stored measurement begins after all other windows, and is none with the last of them."""
        if any(member.placed.started_at > stored[0].placed.started_at for member in members):
            return False
        return len(_by_measurement([*last, stored[0]], visit)) > 1

    def load(self, measurement: Measured) -> list[Member]:
        """Return the windows of a measurement, as they stand with the new ones."""
        if not measurement.members and measurement.row.id is not None:
            measurement.members = [
                Member(stored.placed, measurement, stored.accepted)
                for stored in self.history.members_of(measurement.row)
            ]
        return measurement.members

    def _kept_out(self, members: Sequence[Member], closed: Measured, why: str, visit: Visit) -> list[Member]:
        """Refuse the new windows that are of a measurement that takes no more; return the other windows."""
        new = [member for member in members if member.is_new]
        refused = [
            member
            for group in _by_measurement([*closed.members, *new], visit)
            if any(member.of is closed for member in group)
            for member in group
            if member.is_new
        ]
        self._refuse(refused, closed, why)
        return [member for member in members if member not in refused]

    def _refuse(self, new: Sequence[Member], of: Measured, why: str) -> None:
        for member in new:
            member.refusal, member.accepted, member.of = Rejection(RejectionReason.TOO_LATE, why), False, of
            self.measured[member.placed.started_at] = of

    def _distribute(self, groups: Sequence[list[Member]], hollow: list[Measured]) -> None:
        """Let the windows of each group be one measurement: that which the first of them is of, or a new one."""
        taken, left = set[Measured](), dict[Measured, Measured]()
        for group in groups:
            of = list(dict.fromkeys(member.of for member in group if member.of is not None))
            measurement = next((measurement for measurement in of if measurement not in taken), None)
            if measurement is None:
                measurement = hollow.pop() if hollow else Measured(self._new(group[0].placed))
            taken.add(measurement)
            measurement.has_changed = measurement.has_changed or group != measurement.members
            measurement.is_due = measurement.is_due or any(other.was for other in of)
            measurement.members = group
            for member in group:
                self.measured[member.placed.started_at] = measurement
                if member.of is not None and member.of is not measurement:
                    self.moved.append((member.placed.started_at, member.of, measurement))
                    left.setdefault(member.of, measurement)
                member.of = measurement
            if measurement.has_changed:
                self._describe(measurement)
        for other, measurement in left.items():
            if other not in taken:
                measurement.was += other.was
                self.joined[other] = measurement

    def _describe(self, measurement: Measured) -> None:
        """Let the row of a measurement say what its windows do."""
        row, first = measurement.row, measurement.members[0].placed
        row.started_at, row.ended_at = first.started_at, measurement.members[-1].placed.ended_at
        row.position_mm, row.set_preload_n = to_millimetres(first.position), first.preload
        row.n_accepted = sum(member.accepted for member in measurement.members)
        if row.status == OPEN:
            row.closes_at = self.received_at + timedelta(seconds=self.configuration.measurement_timeout_s)

    def _put_aside(self, members: Sequence[Member]) -> None:
        """Let windows whose time is wrong be of the measurement of their name that is under way, or of one of now."""
        placed = members[0].placed
        under_way = [
            *(measurement for measurement in self.measured.values() if measurement.row.name == placed.name),
            *self.history.called(placed.name, self.received_at - visit_of(self.configuration).pause, self.received_at),
        ]
        measurement = next((measurement for measurement in under_way if measurement.row.status == OPEN), None)
        if measurement is None:
            measurement = Measured(self._new(replace(placed, started_at=self.received_at, ended_at=self.received_at)))
        measurement.has_changed = True
        for member in members:
            member.of = self.measured[member.placed.started_at] = measurement
        measurement.row.closes_at = self.received_at + timedelta(seconds=self.configuration.measurement_timeout_s)

    def _new(self, placed: Placed) -> MeasurementRecord:
        return MeasurementRecord(
            axis_id=self.axis_id,
            name=placed.name,
            started_at=placed.started_at,
            ended_at=placed.ended_at,
            position_mm=to_millimetres(placed.position),
            set_preload_n=placed.preload,
            closes_at=None,
        )

    def _clock(self, window: Window) -> Rejection:
        return Rejection(
            RejectionReason.CLOCK_AHEAD,
            f"a window may begin {MOST_AHEAD} after it arrives at most; got {text_of(window.started_at)} at "
            f"{text_of(self.received_at)}: set the clock of the sender",
        )


def _by_measurement(members: Sequence[Member], visit: Visit) -> list[list[Member]]:
    own = {id(member.placed): member for member in members}
    return [[own[id(placed)] for placed in group] for group in measurements_of((m.placed for m in members), visit)]
