"""What every way to a receiver has: a notice as a CloudEvent, the time it may take, and that it was not taken."""

from typing import Protocol

from service.clock import text_of
from service.json_types import JsonObject
from service.store.tables import NoticeRow

#: A receiver has so long to take a notice, in all, and may answer with so much: of what it says only the status counts.
TIMEOUT_S, MOST_BYTES = 20.0, 2**16
#: Of a CloudEvent in structured mode.
CLOUD_EVENT_TYPE = "application/cloudevents+json; charset=utf-8"


class NotTakenError(Exception):
    """A receiver did not take a notice."""

    def __init__(self, sentence: str, *, for_good: bool = False) -> None:
        super().__init__(sentence)
        self.for_good = for_good


class Sender(Protocol):
    """A way to one receiver."""

    name: str

    def send(self, notice: NoticeRow) -> None:
        """Hand over a notice; raises NotTakenError."""


def cloud_event(notice: NoticeRow, source: str) -> JsonObject:
    """Return a notice as a CloudEvent 1.0 in structured mode. Its id stays when it is sent again."""
    return {
        "specversion": "1.0",
        "id": str(notice.id),
        "source": source,
        "type": notice.kind,
        "subject": notice.subject,
        "time": text_of(notice.at),
        "datacontenttype": "application/json",
        "data": notice.content,
    }
