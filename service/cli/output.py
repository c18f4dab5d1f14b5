"""Print results: JSON for programs, tables for people, progress on standard error."""

import json
from collections.abc import Mapping, Sequence

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from service.documents.measurement import finite_or_null

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")


def print_json(document: Mapping[str, object]) -> None:
    """Print one document; what is not finite becomes null, since JSON has no other word for it."""
    click.echo(json.dumps(finite_or_null(document), indent=2, allow_nan=False))


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table for a person."""
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, justify="right" if rows and _is_number(rows[0][columns.index(column)]) else "left")
    for row in rows:
        table.add_row(*row)
    Console(width=None if Console().is_terminal else 140).print(table)


def progress_bar() -> Progress:
    """Return a progress bar on standard error; it stays silent where that is no terminal."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=console, disable=not console.is_terminal,
    )  # fmt: skip


def _is_number(text: str) -> bool:
    return text[:1].isdigit() or text[:1] in "−-—"
