"""``preload rejudge --url URL --axis ID --calibration N``: have a service judge a history anew, or only compare."""

import click

from service.cli.options import json_option, url_option
from service.cli.output import print_json, print_line, print_table, progress_bar
from service.cli.remote.client import Client
from service.clock import text_of
from service.documents.history import COMPARISON, Comparison, HistoryColumn
from service.json_types import JsonObject


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
    with Client(url) as client, progress_bar() as bar:
        task = bar.add_task("measurements", total=None)
        begun = client.post(f"/v1/axes/{axis}/rejudgements", asked)
        job = client.wait(begun, lambda job: bar.update(task, completed=job["done"], total=job["total"]))
    result = job["result"] or {}
    if as_json:
        print_json(result)
    else:
        _print(axis, COMPARISON.validate_python(result))


def _print(axis: str, comparison: Comparison) -> None:
    old, new = (_cells(column) for column in (comparison.old, comparison.new))
    rows = [(name, old[name], new[name]) for name in old]
    columns = ("", f"calibration {comparison.old.calibration or '—'}", f"calibration {comparison.new.calibration}")
    print_table(f"history of axis '{axis}'", columns, rows)
    print_line("the same measurements raise alarms" if comparison.same_alarms else "other measurements raise alarms")
    if comparison.waveforms_gone:
        print_line(f"{comparison.waveforms_gone} measurements have no waveform any more and stand as they were judged")


def _cells(column: HistoryColumn) -> dict[str, str]:
    lower, upper = (("open" if end is None else f"{end:.0f}") for end in column.median_interval_95_n)
    preload = column.median_preload_n
    return {
        "alarms": str(column.n_alarms),
        "first alarm": "—" if column.first_alarm_at is None else text_of(column.first_alarm_at),
        "state now": column.state,
        "states": ", ".join(f"{state} {count}" for state, count in column.states.items()),
        "measurements": f"{column.n_measurements}, refused {column.n_refused}",
        "median preload": "—" if preload is None else f"{preload:.0f} N",
        "median 95 % interval": "—" if preload is None else f"{lower} to {upper} N",
    }
