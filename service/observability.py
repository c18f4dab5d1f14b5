"""Collect metrics for Prometheus and write structured logs, one registry per application."""

import json
import logging
import sys
from datetime import UTC, datetime

from prometheus_client import CollectorRegistry, Counter, Histogram


class Metrics:
    """What the service counts."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.windows = Counter(
            "preload_windows_total", "Windows received, by outcome.", ["outcome"], registry=self.registry
        )
        self.measurements = Counter(
            "preload_measurements_total", "Measurements judged, by outcome.", ["outcome"], registry=self.registry
        )
        self.uncharted = Counter(
            "preload_uncharted_measurements_total", "Accepted measurements that moved no chart, by reason.", ["reason"],
            registry=self.registry,
        )  # fmt: skip
        self.alarms = Counter("preload_alarms_total", "Alarms raised, by kind.", ["kind"], registry=self.registry)
        self.notices = Counter(
            "preload_notices_total", "Notices to receivers, by what became of them.", ["receiver", "outcome"],
            registry=self.registry,
        )  # fmt: skip
        self.judging = Histogram("preload_judging_seconds", "Time to judge one measurement.", registry=self.registry)
        self.requests = Histogram(
            "preload_request_seconds", "Time to answer a request.", ["method", "route", "status"],
            registry=self.registry,
        )  # fmt: skip


class JsonFormatter(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as JSON; the exception, if any, as one member."""
        entry = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **getattr(record, "members", {}),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry)


def configure_logging(level: str) -> None:
    """Send structured logs to standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    logging.basicConfig(level=level, handlers=[handler], force=True)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("httpx").setLevel(logging.WARNING)
