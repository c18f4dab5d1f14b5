"""Metrics for Prometheus and structured logs. One registry per application, so two in one process do not clash."""

import json
import logging
import sys
import time
import uuid
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime

from fastapi import FastAPI, Request, Response
from prometheus_client import CollectorRegistry, Counter, Histogram

access_log = logging.getLogger("service.access")


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
        self.alarms = Counter("preload_alarms_total", "Alarms raised, by kind.", ["kind"], registry=self.registry)
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


def install_request_metrics(app: FastAPI, metrics: Metrics) -> None:
    """Time each request, name it with an id, and log it without its query (it could hold anything)."""

    @app.middleware("http")
    async def _observe(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
        request_id = request.headers.get("x-request-id", "")[:64] or uuid.uuid4().hex
        started = time.perf_counter()
        response = await call_next(request)
        elapsed = time.perf_counter() - started
        route = getattr(request.scope.get("route"), "path", "unknown")  # the template: bounded label values
        metrics.requests.labels(request.method, route, response.status_code).observe(elapsed)
        response.headers["X-Request-ID"] = request_id
        access_log.info(
            "%s %s %d", request.method, route, response.status_code,
            extra={"members": {"request_id": request_id, "seconds": round(elapsed, 6)}},
        )  # fmt: skip
        return response
