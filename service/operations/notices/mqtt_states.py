"""Publish the state of each axis and of the service as retained MQTT messages."""

import json
import logging
import secrets
import threading
from contextlib import suppress
from datetime import datetime, timedelta

from monitor_core.trend import TrendStatus
from service.clock import now, text_of
from service.documents.lost_motion import LostMotionNow
from service.errors import DocumentDamagedError, ServiceError, UnknownResourceError
from service.json_types import JsonObject
from service.operations.monitoring.trend import AxisStatus, Trend
from service.operations.notices.mqtt import Connection, Message
from service.operations.notices.receivers import Broker
from service.operations.notices.senders import NotTakenError

log = logging.getLogger(__name__)

#: So often it is looked which axes have changed: one query for all of them.
POLL_S = 1.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
#: So many axes are told together.
_MOST_TOGETHER = 100
ONLINE, OFFLINE = b"online", b"offline"
#: A broker that went down together with the service, and came back alone, forgets by then that it was online.
ONLINE_FOR_S = 90


def valid_until(status: AxisStatus) -> datetime | None:
    """Return until when the state of the preload counts if nothing more is measured.

    None where it is unknown already, and in alarm, which silence does not end.
    """
    last = status.row.last_charted_at
    if last is None or status.state in (TrendStatus.UNKNOWN, TrendStatus.ALARM):
        return None
    return last + timedelta(hours=status.configuration.silent_after_hours)


def state_document(status: AxisStatus) -> JsonObject:
    """Return what is told of an axis: its state, its newest preload, and how old they are."""
    until, last = valid_until(status), status.last
    return {
        "axis": status.row.id,
        "name": status.row.name,
        "state": status.state,
        "state_since": None if status.since is None else text_of(status.since),
        "valid_until": None if until is None else text_of(until),
        "measured_at": None if last.started_at is None else text_of(last.started_at),
        "position_mm": last.position_mm,
        "preload_n": last.preload_n,
        "interval_95_n": last.interval_95_n,
        "interval_kind": last.interval_kind,
        "frequency_fall_percent": last.frequency_fall_percent,
        "frequency_fall_interval_95_percent": last.frequency_fall_interval_95_percent,
        "doubts": [doubt.model_dump() for doubt in last.doubts],
        "refused": last.reason,
        "lost_motion": None if status.lost_motion is None else _lost_motion(status.lost_motion),
    }


def _lost_motion(newest: LostMotionNow) -> JsonObject:
    return {
        "state": newest.state,
        "valid_until": None if newest.valid_until is None else text_of(newest.valid_until),
        "measured_at": text_of(newest.measured_at),
        "reversal_value_um": newest.reversal_value_um,
        "reversal_value_interval_95_um": newest.reversal_value_interval_95_um,
    }


class StatePublisher:
    """Compares what was published with what is stored, and publishes what differs.

    It begins anew with each connection, since a broker may have forgotten. Several services of one database may each
    do so: they tell the same, and the last of them is the one whose leave is seen.
    """

    def __init__(self, broker: Broker, trend: Trend) -> None:
        self._broker = broker
        self._trend = trend
        self._stopping = threading.Event()
        self._contradicted = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"states-{broker.name}", daemon=True)

    def start(self) -> None:
        """Start publishing."""
        self._thread.start()

    def stop(self) -> None:
        """Publish that the service is offline, and nothing more."""
        self._stopping.set()

    def close(self, within_s: float) -> None:
        """Stop; a broker that does not answer is left after so long."""
        self.stop()
        self._thread.join(within_s)

    def _serve(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._stopping.is_set():
            try:
                with self._connection() as connection:
                    pause_s = FIRST_PAUSE_S
                    self._keep_told(connection)
            except (NotTakenError, ServiceError) as error:
                log.warning("broker %s is not told of states: %s", self._broker.name, error)
            except Exception:  # the edge of this thread: it must go on, whatever a broker answers
                log.exception("broker %s is not told of states", self._broker.name)
            self._stopping.wait(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _connection(self) -> Connection:
        client_id = f"preload-{self._broker.name}-states-{secrets.token_hex(4)}"
        return Connection(self._broker, client_id, will=self._presence(OFFLINE))

    def _presence(self, payload: bytes) -> Message:
        expiry_s = None if payload == OFFLINE else ONLINE_FOR_S
        return Message(
            self._broker.status_topic, payload, retain=True, content_type="text/plain", expires_after_s=expiry_s
        )

    def _hear(self, payload: bytes) -> None:
        if payload == OFFLINE:
            self._contradicted.set()

    def _keep_told(self, connection: Connection) -> None:
        """Publish changes until the connection is lost or the service stops; online means that all of them are told."""
        due = dict[str, datetime]()
        try:
            published = self._tell_changes(connection, {}, due)
            online_again = self._say_online(connection)
            connection.listen(self._broker.status_topic, self._hear)
            while not self._stopping.wait(POLL_S) and not connection.is_lost:
                # another service of this name has gone and this one has not, or the broker will forget it soon
                if self._contradicted.is_set() or now() >= online_again:
                    online_again = self._say_online(connection)
                published = self._tell_changes(connection, published, due)
        finally:
            if not connection.is_lost:  # else the broker says it
                with suppress(NotTakenError):
                    connection.publish(self._presence(OFFLINE))

    def _say_online(self, connection: Connection) -> datetime:
        """Say that the service is online, and return when to say so again."""
        self._contradicted.clear()
        connection.publish(self._presence(ONLINE))
        return now() + timedelta(seconds=ONLINE_FOR_S / 3)

    def _tell_changes(
        self, connection: Connection, published: dict[str, int], due: dict[str, datetime]
    ) -> dict[str, int]:
        """Tell what differs from these revisions or has become silent, and return the revisions that are told now."""
        at, revisions = now(), self._trend.revisions()
        changed = [axis for axis, revision in revisions.items() if published.get(axis) != revision]
        silent = [axis for axis, until in due.items() if until <= at]
        gone = published.keys() - revisions.keys()
        self._tell(connection, [*dict.fromkeys((*changed, *silent, *gone))], due)
        return revisions

    def _tell(self, connection: Connection, axes: list[str], due: dict[str, datetime]) -> None:
        for begin in range(0, len(axes), _MOST_TOGETHER):
            connection.publish(*(self._state(axis, due) for axis in axes[begin : begin + _MOST_TOGETHER]))

    def _state(self, axis: str, due: dict[str, datetime]) -> Message:
        """Return the message of an axis; an empty one, which the broker forgets it by, if it is gone or archived."""
        due.pop(axis, None)
        topic = self._broker.axis_topic(axis, "state")
        forgotten = Message(topic, b"", retain=True)
        try:
            status = self._trend.status(axis)
        except UnknownResourceError:
            return forgotten
        except DocumentDamagedError as error:
            document: JsonObject = {"axis": axis, "state": str(TrendStatus.UNKNOWN), "detail": str(error)}
        else:
            if status.row.archived_at is not None:
                return forgotten
            document = state_document(status)
            lost = status.lost_motion
            if ends := [end for end in (valid_until(status), lost.valid_until if lost else None) if end]:
                due[axis] = min(ends)
        return Message(topic, json.dumps(document, ensure_ascii=False).encode(), retain=True)
