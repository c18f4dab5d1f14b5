"""``preload check FILE``: tell whether the program can read a file."""

from pathlib import Path

import click

from monitor_core.recordings.check import check_file
from service.cli.output import json_option, print_json


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@json_option
@click.pass_context
def check(context: click.Context, file: Path, as_json: bool) -> None:
    """Validate a session, an FRF set, a modal table, a motion record, a calibration, a drive model or a raw file."""
    report = check_file(file)
    if as_json:
        print_json({"format": report.format, "valid": report.valid, "problems": list(report.problems)})
    else:
        click.echo(f"{file.name}: {report.format}, {'valid' if report.valid else 'not valid'}")
    if not report.valid:
        if not as_json:
            click.echo(f"preload: {report.problems[0]}", err=True)
        context.exit(2)
