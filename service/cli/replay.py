"""``preload replay SESSION --url URL --axis ID``: post a recorded session to a running service."""

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from monitor_core.recording import RejectionReason
from monitor_core.recordings.session_hdf5 import SessionReader, open_session
from service.cli.inputs.formats import session_at
from service.cli.output import json_option, print_json, print_line, print_lines, progress_bar
from service.cli.remote.client import Client, MeasurementOutcome
from service.operations.monitoring.replay import Pace, WindowCounts


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@click.option("--url", required=True, help="Address of the service, e.g. http://127.0.0.1:8710.")
@click.option("--axis", required=True, help="Axis to post to; registered with defaults if it is new.")
@click.option(
    "--speed", type=click.FloatRange(min=0, min_open=True), help="Times real time; as fast as possible if not given."
)
@json_option
def replay(session: Path, url: str, axis: str, speed: float | None, as_json: bool) -> None:
    """Post a recorded session, one measurement a request; windows that are there already are passed over."""
    with open_session(session_at(session)) as reader, Client(url) as client:
        if client.register_if_new(axis):
            print_line(f"axis '{axis}' was not registered: registered with default settings", err=True)
        posted = post_session(reader, client, axis, speed)
    if as_json:
        refused = dict(posted.measurements_refused)
        print_json({**asdict(posted.windows), "measurements": posted.measurements, "measurements_refused": refused})
    else:
        print_lines(_sentence(posted))


@dataclass(frozen=True, slots=True)
class Posted:
    """Counts of the windows and measurements of a posted session."""

    windows: WindowCounts
    measurements: int  # judged now, or when they were first sent
    measurements_refused: Counter[str]  # of those, by reason


def post_session(reader: SessionReader, client: Client, axis: str, speed: float | None = None) -> Posted:
    """Post all measurements of an open session and count their outcomes."""
    pace = Pace(speed)
    counts, judged = WindowCounts(), list[MeasurementOutcome]()
    with progress_bar() as progress:
        task = progress.add_task(f"{axis}", total=len(reader.measurement_of))
        for name in reader.measurements:
            windows = reader.windows_of(name)
            pace.wait_for(windows[0].started_at)
            answer = client.post_measurement(axis, windows)
            counts += WindowCounts(answer.accepted + answer.refused, answer.refused, answer.already_there)
            judged += answer.measurements
            progress.advance(task, len(windows))
    return Posted(counts, len(judged), Counter(str(outcome.reason) for outcome in judged if outcome.refused))


def _sentence(posted: Posted) -> str:
    windows = ", ".join(f"{name.replace('_', ' ')}: {value}" for name, value in asdict(posted.windows).items())
    reasons = ", ".join(f"{number} {reason}" for reason, number in posted.measurements_refused.most_common())
    refused = posted.measurements_refused.total()
    sentence = f"{windows}; measurements: {posted.measurements}, refused: {refused}{reasons and f' ({reasons})'}"
    if posted.measurements_refused[RejectionReason.NOT_CALIBRATED]:
        sentence += "\nnot-calibrated ones stay so: activate a calibration, then replay under the name of another axis"
    return sentence
