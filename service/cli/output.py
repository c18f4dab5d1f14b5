"""Print results: JSON for programs, tables for people, progress on standard error.

All that is printed goes through here, and what a file, a service or an option brought along is shown and never obeyed:
characters that move the cursor, ring, colour or turn the direction of writing appear as their codes.
"""

import json
from collections.abc import Mapping, Sequence

import click
from rich.cells import cell_len
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from service.documents.measurement import finite_or_null
from service.documents.printable import printable


def print_line(text: str, *, err: bool = False) -> None:
    """Print one line, on standard error if ``err``."""
    click.echo(printable(text), err=err)


def print_json(document: Mapping[str, object]) -> None:
    """Print one document; what is not finite becomes null, since JSON has no other word for it."""
    text = json.dumps(finite_or_null(document), indent=2, allow_nan=False)
    click.echo(text.replace("\x7f", "\\u007f"))  # json writes the codes of all other characters that are not ASCII's


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table: with lines in a terminal, a row on each line in plain columns where a program reads."""
    numeric = [bool(rows) and _is_number(cell) for cell in (rows[0] if rows else columns)]
    cells = [[printable(cell) for cell in row] for row in (columns, *rows)]
    console = Console()
    if not console.is_terminal:
        click.echo("\n".join((printable(title), *_plain(cells, numeric))))
        return
    table = Table(title=Text(printable(title)), title_justify="left")
    for column, is_numeric in zip(cells[0], numeric, strict=True):
        table.add_column(Text(column), justify="right" if is_numeric else "left", overflow="fold")
    for row in cells[1:]:
        table.add_row(*map(Text, row))
    console.print(table)


def _plain(cells: Sequence[Sequence[str]], numeric: Sequence[bool]) -> list[str]:
    """Return lines with the cells of a column under each other, numbers to the right."""
    widths = [max(map(cell_len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(
            " " * (width - cell_len(cell)) + cell if is_numeric else cell + " " * (width - cell_len(cell))
            for cell, width, is_numeric in zip(row, widths, numeric, strict=True)
        ).rstrip()
        for row in cells
    ]


def progress_bar(*, of_unknown_length: bool = False) -> Progress:
    """Return a progress bar on standard error; it stays silent where that is no terminal.

    Of work whose length is not known beforehand it shows how long it has taken.
    """
    console = Console(stderr=True)
    columns: tuple[ProgressColumn, ...] = (_Description(), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    if of_unknown_length:
        columns = (TimeElapsedColumn(), _Description())
    return Progress(*columns, console=console, disable=not console.is_terminal)


class _Description(ProgressColumn):
    """What is being done, which may name a file."""

    def render(self, task: Task) -> Text:
        """Return the description as it is, without markup."""
        return Text(printable(task.description))


def _is_number(text: str) -> bool:
    return text[:1].isdigit() or text[:1] in "−-—"
