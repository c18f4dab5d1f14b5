"""Collect metrics for Prometheus and write structured logs, one registry per application."""

import json
import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

#: So many axes have values of their own in the metrics, the first by their names: six series each.
MOST_AXES = 2000


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

    def mean_judging_s(self) -> float | None:
        """Return the mean time to judge a measurement since this process began; None before the first."""
        found = {sample.name: sample.value for metric in self.judging.collect() for sample in metric.samples}
        count = found.get("preload_judging_seconds_count", 0.0)
        return found["preload_judging_seconds_sum"] / count if count else None


@dataclass(frozen=True, slots=True)
class AxisReading:
    """How an axis stands, for the metrics; None where its last measurement says nothing."""

    axis: str
    state: str
    open_alarms: int
    measured_at: datetime | None
    preload_n: float | None
    interval_95_n: tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class ReceiverReading:
    """How a receiver of notices stands, for the metrics."""

    receiver: str
    is_failing: bool
    n_waiting: int


class FleetGauges(Collector):
    """How the axes, the jobs and the receivers stand at this moment; read anew for each scrape."""

    def __init__(
        self,
        states: Sequence[str],
        axes: Sequence[AxisReading],
        damaged: int,
        jobs: Mapping[tuple[str, str], int],
        receivers: Sequence[ReceiverReading],
    ) -> None:
        self._states, self._axes, self._damaged, self._jobs = states, axes, damaged, jobs
        self._receivers = receivers

    def collect(self) -> Iterator[Metric]:
        """Yield the gauges."""
        by_state = GaugeMetricFamily("preload_axes", "Axes, by state.", labels=["state"])
        for state in self._states:
            by_state.add_metric([state], sum(axis.state == state for axis in self._axes))
        by_state.add_metric(["damaged"], self._damaged)
        yield by_state
        jobs = GaugeMetricFamily("preload_jobs", "Jobs that are not done.", labels=["kind", "status"])
        for (kind, status), number in self._jobs.items():
            jobs.add_metric([kind, status], number)
        yield jobs
        failing = {each.receiver: float(each.is_failing) for each in self._receivers}
        yield _by("receiver", "preload_receiver_failing", "1 for a receiver that takes no notices.", failing)
        waiting = {each.receiver: float(each.n_waiting) for each in self._receivers}
        yield _by("receiver", "preload_receiver_waiting", "Notices that wait for a receiver.", waiting)
        shown = sorted(self._axes, key=lambda axis: axis.axis)[:MOST_AXES]
        states = GaugeMetricFamily("preload_axis_state", "1 for the state of an axis.", labels=["axis", "state"])
        for axis in shown:
            states.add_metric([axis.axis, axis.state], 1)
        yield states
        yield _of_axes(
            "preload_axis_open_alarms", "Open alarms.", {axis.axis: float(axis.open_alarms) for axis in shown}
        )
        measured = {axis.axis: axis.measured_at.timestamp() for axis in shown if axis.measured_at is not None}
        yield _of_axes("preload_axis_measured_timestamp_seconds", "When the last measurement began.", measured)
        judged = [axis for axis in shown if axis.preload_n is not None]
        preloads = {axis.axis: axis.preload_n for axis in judged}
        yield _of_axes("preload_axis_newtons", "Preload of the last measurement; missing if it was refused.", preloads)
        for i, end in enumerate(("lower", "upper")):
            ends = {axis.axis: axis.interval_95_n[i] for axis in judged}
            yield _of_axes(f"preload_axis_{end}_newtons", f"The {end} end of its 95 % interval; missing if open.", ends)


def _of_axes(name: str, says: str, values: Mapping[str, float | None]) -> Metric:
    return _by("axis", name, says, values)


def _by(label: str, name: str, says: str, values: Mapping[str, float | None]) -> Metric:
    gauge = GaugeMetricFamily(name, says, labels=[label])
    for labelled, value in values.items():
        if value is not None:
            gauge.add_metric([labelled], value)
    return gauge


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
    logging.getLogger("httpx").setLevel(logging.WARNING)
