"""``preload replay SESSION --url URL --axis ID``: post a recorded session to a running service."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from monitor_core.session import RecordedMeasurements
from service.cli.inputs.data import DataKind, data_argument, data_of, map_option, opened_session
from service.cli.options import json_option, url_option
from service.cli.output import print_json, print_line
from service.cli.remote.client import Client
from service.operations.monitoring.replay import Pace, WindowCounts


@click.command()
@data_argument
@map_option
@url_option
@click.option("--axis", required=True, help="Axis to post to; registered with defaults if it is new.")
@click.option(
    "--speed", type=click.FloatRange(min=0, min_open=True), help="Times real time; as fast as possible if not given."
)
@json_option
def replay(
    paths: tuple[Path, ...], map_path: Path | None, url: str, axis: str, speed: float | None, as_json: bool
) -> None:
    """Post a recorded session, one measurement a request; windows that are there already are passed over."""
    data = data_of(paths, map_path, takes=(DataKind.SESSION,))
    with opened_session(data) as session, Client(url) as client:
        if client.register_if_new(axis):
            print_line(f"axis '{axis}' was not registered: registered with default settings", err=True)
        posted = post_session(session, client, axis, speed)
    if as_json:
        refused = dict(posted.measurements_refused)
        print_json({**asdict(posted.windows), "measurements": posted.measurements, "measurements_refused": refused})
    else:
        print_line(_sentence(posted))


@dataclass(frozen=True, slots=True)
class Posted:
    """Counts of the windows and measurements of a posted session."""

    windows: WindowCounts
    measurements: int  # judged now, or when they were first sent
    measurements_refused: Counter[str]  # of those, by reason


def post_session(session: RecordedMeasurements, client: Client, axis: str, speed: float | None = None) -> Posted:
    """Post all measurements of an open session and count their outcomes."""
    pace = Pace(speed)
    counts, judged = WindowCounts(), list[Mapping[str, object]]()
    for name in session.measurements:
        windows = session.windows_of(name)
        pace.wait_for(windows[0].started_at)
        answer = client.post_measurement(axis, windows)
        counts += WindowCounts(answer["accepted"] + answer["refused"], answer["refused"], answer["already_there"])
        judged += answer["measurements"]
    return Posted(counts, len(judged), Counter(str(each.get("reason")) for each in judged if each["refused"]))


def _sentence(posted: Posted) -> str:
    windows = ", ".join(f"{name.replace('_', ' ')}: {value}" for name, value in asdict(posted.windows).items())
    reasons = ", ".join(f"{number} {reason}" for reason, number in posted.measurements_refused.most_common())
    refused = posted.measurements_refused.total()
    return f"{windows}; measurements: {posted.measurements}, refused: {refused}{reasons and f' ({reasons})'}"
