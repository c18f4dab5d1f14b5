"""Options that several commands take."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

_Command = TypeVar("_Command", bound=Callable[..., object])

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
url_option = click.option("--url", required=True, help="Address of the service, e.g. http://127.0.0.1:8710.")
force_option = click.option("--force", is_flag=True, help="Replace an existing file.")


def data_dir_option(words: str = "Data of the service") -> Callable[[_Command], _Command]:
    """Return the option of the data folder; ``words`` say what is done with it."""
    help_text = f"{words} (PRELOAD_DATA_DIR)."
    return click.option("--data-dir", type=click.Path(path_type=Path, file_okay=False), help=help_text)
