"""``preload restore FOLDER``: a backup becomes a data folder again."""

from pathlib import Path

import click

from service.cli.data.backup import embedded_folder, report
from service.cli.output import json_option, progress_bar
from service.store.safekeeping.restore import restore as restore_folder


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option(
    "--data-dir", type=click.Path(path_type=Path, file_okay=False), help="Where to, new or empty (PRELOAD_DATA_DIR)."
)
@click.option("--despite-damage", is_flag=True, help="Restore what there is of a damaged backup.")
@json_option
@click.pass_context
def restore(context: click.Context, folder: Path, data_dir: Path | None, despite_damage: bool, as_json: bool) -> None:
    """Verify a backup and copy it into a new or empty data folder; a service can start there then."""
    target = embedded_folder(data_dir)
    with progress_bar() as progress:
        task = progress.add_task("files copied", total=None)
        manifest, damaged = restore_folder(
            folder, target, lambda _: progress.advance(task), despite_damage=despite_damage
        )
    report(target, manifest, damaged, as_json=as_json)
    if damaged:
        context.exit(1)
