"""``preload retention show | run``: how long waveforms are kept, what they take, and the purge of the rest."""

import getpass
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from service.api.retention import RetentionOut, retention_out
from service.cli.options import data_dir_option, json_option
from service.cli.output import print_json, print_line, print_table, progress_bar
from service.clock import now
from service.operations.purge import Purge
from service.operations.retention import Rule, rule_of, survey
from service.settings import Settings
from service.store.database import Database
from service.store.safekeeping.private import private_folder
from service.store.waveform_objects import files_at
from service.store.waveforms import WaveformStore

_days = click.option("--days", type=click.IntRange(1, 36500), help="As if PRELOAD_KEEP_RAW_DAYS were this.")


@contextmanager
def _store(data_dir: Path | None, **more: int) -> Iterator[tuple[Database, WaveformStore, Rule, Path]]:
    """Open the data of a service, which may be running."""
    settings = Settings(**({} if data_dir is None else {"data_dir": data_dir}), **more)  # type: ignore[arg-type]  # pydantic checks them
    private_folder(settings.data_dir)
    waveforms = WaveformStore(files_at(settings.data_dir, settings.waveform_url))
    database = Database(settings.resolved_database_url())
    try:
        database.migrate()
        yield database, waveforms, rule_of(settings), settings.data_dir
    finally:
        waveforms.close()
        database.close()


@click.group()
def retention() -> None:
    """Say how long waveforms are kept and what they take; let go what the rule does not keep."""


@retention.command("show")
@_days
@data_dir_option()
@json_option
def show(days: int | None, data_dir: Path | None, as_json: bool) -> None:
    """Say what is kept and why, what a purge would let go, and what a year brings. Nothing is changed."""
    with _store(data_dir, **({} if days is None else {"keep_raw_days": days})) as (database, waveforms, rule, _):
        stored = retention_out(survey(database, waveforms, rule, now()))
    if as_json:
        print_json(stored.model_dump(mode="json"))
    else:
        _print(stored)


@retention.command("run")
@click.option("--dry-run", is_flag=True, help="Change nothing; say what would be let go.")
@data_dir_option()
@json_option
@click.pass_context
def run(context: click.Context, dry_run: bool, data_dir: Path | None, as_json: bool) -> None:
    """Let go now what the rule does not keep, beside a running service or without one."""
    if dry_run:
        context.invoke(show, days=None, data_dir=data_dir, as_json=as_json)
        return
    with _store(data_dir) as (database, waveforms, rule, folder), progress_bar() as progress:
        purge = Purge(database, waveforms, rule, folder)
        with database.write() as session:
            begun = purge.begin(session, f"command line ({getpass.getuser()})", now())
        task = progress.add_task("files looked at", total=None)
        row = purge.run(begun.id, lambda done, total: progress.update(task, completed=done, total=total), time.sleep)
    if as_json:
        print_json({"purge": row.id, "windows": row.n_windows, "freed_bytes": row.freed_bytes})
    else:
        print_line(f"purge {row.id}: {row.n_windows} windows let go, {row.freed_bytes / 1e9:.3f} GB freed")


def _print(stored: RetentionOut) -> None:
    print_line(stored.rule.sentence)
    rows = [(str(kept.why), str(kept.windows), f"{kept.bytes / 1e9:.3f}") for kept in stored.kept]
    rows.append(("to be let go", str(stored.to_let_go.windows), f"{stored.to_let_go.bytes / 1e9:.3f}"))
    print_table(f"{stored.bytes / 1e9:.3f} GB in {stored.files} files", ("kept because", "windows", "GB"), rows)
    paces = [
        (pace.axis, f"{pace.days:.1f}", "—" if pace.gb_per_year is None else f"{pace.gb_per_year:.2f}")
        for pace in stored.axes
    ]
    print_table(f"{stored.gb_per_year:.2f} GB a year at this pace", ("axis", "days counted", "GB a year"), paces)
