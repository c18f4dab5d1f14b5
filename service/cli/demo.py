"""``preload demo``: the main job on the bundled sessions, end to end over real HTTP."""

import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from monitor_core.recordings.session_hdf5 import open_session
from service.cli.output import json_option, print_json, print_table
from service.cli.remote.client import Client
from service.cli.remote.embedded import embedded_service
from service.cli.replay import post_session
from service.operations.monitoring.replay import SUFFIX
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
            click.echo(f"dashboard: {url}/", err=True)
            document = run_demo(client, _bundled(settings))
            if as_json:
                print_json(document)
            else:
                _print(document)
            if stay:
                click.echo(f"The dashboard stays up at {url}/ until you press Ctrl-C.")
                _wait()


def _bundled(settings: Settings) -> Path:
    """Return the folder of the bundled sessions; an installed package is told where they are."""
    return BUNDLED_SESSIONS if BUNDLED_SESSIONS.is_dir() else settings.replay_dir


def run_demo(client: Client, sessions: Path) -> dict[str, Any]:
    """Calibrate on the calibration session, replay the others as axes of the same machine, collect the results."""
    configuration = demonstration_axis(sessions)
    client.put(f"/v1/axes/{CALIBRATION}", {"name": "calibration of the machine", "configuration": configuration})
    counts = replay_bundled(client, sessions, CALIBRATION, "calibration of the machine")
    calibration = client.post(f"/v1/axes/{CALIBRATION}/calibrations", {"measurements": {}, "comment": "demo"})
    estimates: list[dict[str, Any]] = []
    alarms: list[dict[str, Any]] = []
    axes: list[dict[str, Any]] = []
    for session, description in MONITORED.items():
        client.put(f"/v1/axes/{session}", {"name": f"{session}: {description}", "configuration": configuration})
        own = client.post(
            f"/v1/axes/{session}/calibrations", {"document": calibration["document"], "comment": "of the machine"}
        )
        client.post(f"/v1/axes/{session}/calibrations/{own['id']}/activate", {"reason": "demo"})
        replayed = replay_bundled(client, sessions, session, description)
        counts = {name: counts[name] + replayed[name] for name in counts}
        _wait_for_causes(client, session)
        points = client.get(f"/v1/axes/{session}/trend", limit=10_000)["points"]
        raised = client.get("/v1/alarms", axis=session, limit=200)["alarms"]
        estimates += [{"axis": session, **point} for point in points if point["preload_n"] is not None]
        alarms += [
            {"axis": session, "kind": alarm["kind"], **alarm["evidence"], "explanation": alarm["explanation"]}
            for alarm in reversed(raised)
        ]
        axes.append(_summary(client, session, points, raised))
    return {**counts, "axes": axes, "estimates": estimates, "alarms": alarms, "calibration": calibration["document"]}


def demonstration_axis(sessions: Path) -> dict[str, Any]:
    """Return the settings of the demonstration axis, as an operator would state them."""
    return {
        "search_band_hz": [140.0, 230.0],
        "excitation_source": "sensor",
        "silent_after_hours": 1e6,
        "drive_model": (sessions / DRIVE_MODEL).read_text(encoding="utf-8"),
    }


def replay_bundled(client: Client, sessions: Path, session: str, description: str) -> Mapping[str, int]:
    """Post one bundled session to the axis of its name, which is registered."""
    click.echo(f"replaying {session} ({description})", err=True)
    with open_session(sessions / f"{session}{SUFFIX}") as reader:
        return post_session(reader, client, session).windows


def _wait_for_causes(client: Client, axis: str) -> None:
    until = time.monotonic() + LONGEST_WAIT_S
    while time.monotonic() < until:
        jobs = client.get("/v1/jobs", axis=axis)["jobs"]
        if all(job["status"] not in ("queued", "running") for job in jobs):
            return
        time.sleep(0.2)


def _summary(client: Client, session: str, points: list[dict[str, Any]], raised: list[Any]) -> dict[str, Any]:
    judged = [point for point in points if point["preload_n"] is not None]
    return {
        "axis": session,
        "state": client.get(f"/v1/axes/{session}")["state"],
        "judged": len(judged),
        "refused": len(points) - len(judged),
        "first": judged[0] if judged else None,
        "last": judged[-1] if judged else None,
        "alarms": len(raised),
    }


def _print(document: dict[str, Any]) -> None:
    print_table(
        "Trend",
        ("axis", "measurements", "refused", "preload at first", "preload at last", "95 % interval", "state"),
        [
            (
                axis["axis"],
                str(axis["judged"]),
                str(axis["refused"]),
                _newtons(axis["first"]),
                _newtons(axis["last"]),
                "—" if axis["last"] is None else _interval(axis["last"]["interval_95_n"]),
                axis["state"],
            )
            for axis in document["axes"]
        ],
    )
    print_table(
        "Alarms",
        ("axis", "at", "kind", "preload", "95 % interval", "loss since baseline"),
        [
            (
                alarm["axis"], alarm["at"][:16].replace("T", " "), alarm["kind"], f"{alarm['preload_n']:.0f} N",
                _interval(alarm["interval"]), f"{alarm['preload_loss_n']:.0f} N",
            )
            for alarm in document["alarms"]
        ],
    )  # fmt: skip
    for alarm in document["alarms"]:
        click.echo(f"{alarm['axis']}: {alarm['explanation']['sentence']}")
    silent = [axis["axis"] for axis in document["axes"] if not axis["alarms"]]
    click.echo(
        f"{document['windows_posted']} windows posted, {document['windows_refused']} refused; "
        f"no alarm on: {', '.join(silent) or 'none'}"
    )


def _newtons(point: dict[str, Any] | None) -> str:
    return "—" if point is None else f"{point['preload_n']:.0f} N"


def _interval(bounds: list[float | None]) -> str:
    return " to ".join("∞" if bound is None else f"{bound:.0f}" for bound in bounds) + " N"


def _wait() -> None:
    try:
        input()
    except (KeyboardInterrupt, EOFError):
        click.echo("stopped")
