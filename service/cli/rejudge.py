"""``preload rejudge --url URL --axis ID --calibration N``: have a service judge a history anew, or only compare."""

import time
from collections.abc import Mapping

import click
from pydantic import BaseModel

from service.cli.options import json_option, url_option
from service.cli.output import print_json, print_line, print_table, progress_bar
from service.cli.remote.client import Client
from service.json_types import Json, JsonObject

#: How often the job is asked how far it is.
ASKED_EVERY_S = 0.5


class _Column(BaseModel):
    calibration: int | None
    state: str
    n_measurements: int
    n_refused: int
    states: dict[str, int]
    n_alarms: int
    first_alarm_at: str | None
    median_preload_n: float | None
    median_interval_95_n: tuple[float | None, float | None]


class _Comparison(BaseModel):
    same_alarms: bool
    waveforms_gone: int
    old: _Column
    new: _Column


class _Job(BaseModel):
    id: str
    status: str
    done: int
    total: int | None
    result: Mapping[str, Json] | None
    error: str | None


@click.command()
@url_option
@click.option("--axis", required=True, help="Axis whose history is judged anew.")
@click.option("--calibration", type=click.IntRange(min=1), required=True, help="Number of the calibration to judge by.")
@click.option("--from", "start", help="First moment that is judged anew (RFC 3339); all that is stored if not given.")
@click.option("--dry-run", is_flag=True, help="Only say, side by side, what it would change.")
@click.option("--reason", default="the history was judged anew", help="Why the calibration is put in force.")
@json_option
def rejudge(
    url: str, axis: str, calibration: int, start: str | None, dry_run: bool, reason: str, as_json: bool
) -> None:
    """Judge the history of an axis anew under another calibration, which is in force then, and compare both."""
    asked: JsonObject = {"calibration": calibration, "dry_run": dry_run, "reason": reason}
    asked |= {} if start is None else {"from": start}
    with Client(url) as client:
        job = _ended(client, _Job.model_validate(client.post(f"/v1/axes/{axis}/rejudgements", asked)))
    if job.status != "done" or job.result is None:
        raise click.ClickException(f"job {job.id} {job.status}: {job.error or 'nothing was changed'}")
    if as_json:
        print_json(job.result)
    else:
        _print(axis, _Comparison.model_validate(job.result))


def _ended(client: Client, job: _Job) -> _Job:
    with progress_bar() as bar:
        task = bar.add_task("measurements", total=job.total)
        while job.status in ("queued", "running"):
            time.sleep(ASKED_EVERY_S)
            job = client.get(f"/v1/jobs/{job.id}", _Job)
            bar.update(task, completed=job.done, total=job.total)
    return job


def _print(axis: str, comparison: _Comparison) -> None:
    old, new = (_cells(column) for column in (comparison.old, comparison.new))
    rows = [(name, old[name], new[name]) for name in old]
    columns = ("", f"calibration {comparison.old.calibration or '—'}", f"calibration {comparison.new.calibration}")
    print_table(f"history of axis '{axis}'", columns, rows)
    print_line("the same measurements raise alarms" if comparison.same_alarms else "other measurements raise alarms")
    if comparison.waveforms_gone:
        print_line(f"{comparison.waveforms_gone} measurements have no waveform any more and stand as they were judged")


def _cells(column: _Column) -> dict[str, str]:
    lower, upper = (("open" if end is None else f"{end:.0f}") for end in column.median_interval_95_n)
    preload = column.median_preload_n
    return {
        "alarms": str(column.n_alarms),
        "first alarm": column.first_alarm_at or "—",
        "state now": column.state,
        "states": ", ".join(f"{state} {count}" for state, count in column.states.items()),
        "measurements": f"{column.n_measurements}, refused {column.n_refused}",
        "median preload": "—" if preload is None else f"{preload:.0f} N",
        "median 95 % interval": "—" if preload is None else f"{lower} to {upper} N",
    }
