"""``preload demo``: the main job on the bundled sessions, end to end over real HTTP."""

import sys
import tempfile
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from monitor_core.recordings.session_hdf5 import open_session
from service.api.alarms import AlarmOut, AlarmsOut
from service.api.axes import AxisOut
from service.api.jobs import JobsOut
from service.api.trend_points import TrendOut, TrendPointOut
from service.cli.inputs.data import counted_session
from service.cli.options import json_option
from service.cli.output import print_json, print_line, print_table
from service.cli.remote.client import Client
from service.cli.remote.server import embedded_service
from service.cli.replay import post_session
from service.documents.measurement import read_evidence
from service.json_types import Json, JsonObject
from service.operations.monitoring.replay import SUFFIX, WindowCounts
from service.settings import BUNDLED_SESSIONS, Settings

#: The calibration session comes first: the axes of all other sessions are of the machine it was taken on.
CALIBRATION = "calibration"
#: What each session holds, in the order in which it is replayed.
MONITORED = {
    "healthy-month": "healthy",
    "slow-wear": "preload wears off slowly",
    "sudden-loss": "preload drops at once",
    "payload-change": "a workpiece is put on the table",
    "temperature-drift": "the machine warms up",
    "bad-windows": "trouble with the sensors",
}
#: The machine of all bundled sessions.
DRIVE_MODEL = Path("models") / "replay-axis.toml"
#: The cause of an alarm is sought after the commit, by a job that takes some seconds.
LONGEST_WAIT_S = 120.0


@click.command()
@click.option("--stay/--end", default=None, help="Keep the dashboard up afterwards; by default only in a terminal.")
@json_option
def demo(stay: bool | None, as_json: bool) -> None:
    """Replay the bundled sessions through an embedded service; print the trend and the alarms."""
    stay = (sys.stdout.isatty() and not as_json) if stay is None else stay
    with tempfile.TemporaryDirectory(prefix="preload-demo-") as folder:
        settings = Settings(data_dir=Path(folder), port=0, host="127.0.0.1", database_url=None)
        with embedded_service(settings) as url, Client(url) as client:
            print_line(f"dashboard: {url}/", err=True)
            demonstration = run_demo(client, BUNDLED_SESSIONS)
            if as_json:
                print_json(_document(demonstration))
            else:
                _print(demonstration)
            if stay:
                _print_tour(url)
                _wait()
            elif not as_json:
                print_line("It ended by itself; in a terminal, or with --stay, its pages stay up to look at.")


@dataclass(frozen=True, slots=True)
class ReplayedAxis:
    """An axis after its session."""

    name: str
    state: str
    points: list[TrendPointOut]
    alarms: list[AlarmOut]  # oldest first

    @property
    def judged(self) -> list[TrendPointOut]:
        """The measurements that have a preload."""
        return [point for point in self.points if point.preload_n is not None]


@dataclass(frozen=True, slots=True)
class Demonstration:
    """What came of all sessions."""

    windows: WindowCounts
    axes: list[ReplayedAxis]
    calibration: Json


def run_demo(client: Client, sessions: Path) -> Demonstration:
    """Calibrate on the calibration session, replay the others as axes of the same machine, collect the results."""
    configuration = demonstration_axis(sessions)
    step = _Step()
    client.put(f"/v1/axes/{CALIBRATION}", {"name": "calibration of the machine", "configuration": configuration})
    counts = replay_bundled(client, sessions, CALIBRATION, "calibration of the machine")
    step.ended("replayed the calibration session")
    fitted = client.post(f"/v1/axes/{CALIBRATION}/calibrations", {"measurements": {}, "comment": "demo"})
    step.ended("calibrated the machine")
    axes = []
    for session, description in MONITORED.items():
        client.put(f"/v1/axes/{session}", {"name": f"{session}: {description}", "configuration": configuration})
        own = client.post(
            f"/v1/axes/{session}/calibrations", {"document": fitted["document"], "comment": "of the machine"}
        )
        client.post(f"/v1/axes/{session}/calibrations/{own['id']}/activate", {"reason": "demo"})
        counts += replay_bundled(client, sessions, session, description)
        step.ended(f"replayed {session}")
        if (ended := _wait_for_causes(client, session)) is not None:
            step.ended(ended)
        points = client.get(f"/v1/axes/{session}/trend", TrendOut, limit=10_000).points
        raised = client.get("/v1/alarms", AlarmsOut, axis=session, limit=200).alarms
        state = client.get(f"/v1/axes/{session}", AxisOut).state
        axes.append(ReplayedAxis(session, state, points, raised[::-1]))
    return Demonstration(counts, axes, fitted["document"])


def demonstration_axis(sessions: Path) -> JsonObject:
    """Return the settings of the demonstration axis, as an operator would state them."""
    return {
        "search_band_hz": [140.0, 230.0],
        "excitation_source": "sensor",
        "silent_after_hours": 1e6,
        "drive_model": (sessions / DRIVE_MODEL).read_text(encoding="utf-8"),
    }


def replay_bundled(client: Client, sessions: Path, session: str, description: str) -> WindowCounts:
    """Post one bundled session to the axis of its name, which is registered."""
    print_line(f"replaying {session} ({description})", err=True)
    with open_session(sessions / f"{session}{SUFFIX}") as reader, counted_session(reader, session) as counted:
        return post_session(counted, client, session).windows


class _Step:
    """Says how long each step took."""

    def __init__(self) -> None:
        self._began = time.monotonic()

    def ended(self, what: str) -> None:
        """Say so, and begin the next step."""
        at = time.monotonic()
        print_line(f"  {what}: {at - self._began:.1f} s", err=True)
        self._began = at


def _wait_for_causes(client: Client, axis: str) -> str | None:
    """Wait until the causes of the alarms of an axis are found; say what came of it. None where none is sought."""
    until = time.monotonic() + LONGEST_WAIT_S
    while True:
        jobs = client.get("/v1/jobs", JobsOut, axis=axis).jobs
        if not jobs:
            return None
        if all(job.status not in ("queued", "running") for job in jobs):
            found = jobs[0].status == "done"  # the newest knows most
            return "found the cause of its alarm" if found else "did not find the cause of its alarm"
        if time.monotonic() >= until:
            return "still looks for the cause of its alarm, which is not waited for any longer"
        time.sleep(0.2)


def _document(demonstration: Demonstration) -> JsonObject:
    return {
        **asdict(demonstration.windows),
        "axes": [_summary(axis) for axis in demonstration.axes],
        "estimates": [{"axis": axis.name, **_point(point)} for axis in demonstration.axes for point in axis.judged],
        "alarms": [
            {
                "axis": axis.name,
                "kind": alarm.kind,
                **alarm.evidence,
                "explanation": alarm.explanation.model_dump(mode="json"),
            }
            for axis in demonstration.axes
            for alarm in axis.alarms
        ],
        "calibration": demonstration.calibration,
    }


def _summary(axis: ReplayedAxis) -> JsonObject:
    judged = axis.judged
    return {
        "axis": axis.name,
        "state": axis.state,
        "judged": len(judged),
        "refused": len(axis.points) - len(judged),
        "first": _point(judged[0]) if judged else None,
        "last": _point(judged[-1]) if judged else None,
        "alarms": len(axis.alarms),
    }


def _point(point: TrendPointOut) -> JsonObject:
    return point.model_dump(mode="json")


def _print(demonstration: Demonstration) -> None:
    print_table(
        "Trend",
        ("axis", "measurements", "refused", "preload at first", "preload at last", "95 % interval", "state"),
        [_trend_row(axis) for axis in demonstration.axes],
    )
    alarms = [(axis.name, alarm, read_evidence(alarm.evidence)) for axis in demonstration.axes for alarm in axis.alarms]
    print_table(
        "Alarms",
        ("axis", "at", "kind", "preload", "95 % interval", "loss since baseline"),
        [
            (
                name, f"{evidence.at:%Y-%m-%d %H:%M}", alarm.kind, _newtons(evidence.preload_n),
                _interval(evidence.interval), _newtons(evidence.preload_loss_n),
            )
            for name, alarm, evidence in alarms
        ],
    )  # fmt: skip
    for name, alarm, _ in alarms:
        print_line(f"{name}: {alarm.explanation.sentence}")
    silent = [axis.name for axis in demonstration.axes if not axis.alarms]
    print_line(
        f"{demonstration.windows.windows_posted} windows posted, {demonstration.windows.windows_refused} refused; "
        f"no alarm on: {', '.join(silent) or 'none'}"
    )


def _trend_row(axis: ReplayedAxis) -> tuple[str, ...]:
    judged = axis.judged
    n_judged, n_refused = str(len(judged)), str(len(axis.points) - len(judged))
    if not judged:
        return (axis.name, n_judged, n_refused, "—", "—", "—", axis.state)
    first, last = judged[0], judged[-1]
    ends = (_newtons(first.preload_n), _newtons(last.preload_n), _interval(last.interval_95_n))
    return (axis.name, n_judged, n_refused, *ends, axis.state)


def _newtons(value: float | None) -> str:
    return "—" if value is None else f"{value:.0f} N"


def _interval(bounds: tuple[float | None, float | None] | None) -> str:
    return "—" if bounds is None else " to ".join("∞" if bound is None else f"{bound:.0f}" for bound in bounds) + " N"


def _print_tour(url: str) -> None:
    """Say which address to open, and what to see there."""
    for address, sight in (
        ("/", "open this in a browser: the fleet, worst first"),
        (
            "/axes/slow-wear",
            "an alarm: what was lost since when, its cause, what to do next; press \u201cI have seen it\u201d",
        ),
        ("/axes/slow-wear/long-run", "where the preload goes, the mode over time"),
        ("/axes/payload-change", "a workpiece of 9 kg, stated: wider intervals, no alarm"),
        ("/axes/bad-windows", "sensors in trouble: refused with a reason, not judged"),
        ("/wall", "the same in large type, for the shop"),
    ):
        print_line(f"{url}{address}  {sight}")
    print_line("The pages stay up until you press Ctrl-C.")


def _wait() -> None:
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        print_line("stopped")
