"""Options that several commands take."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

_Command = TypeVar("_Command", bound=Callable[..., object])

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
force_option = click.option("--force", is_flag=True, help="Replace an existing file.")


def _address(_context: click.Context, _option: click.Parameter, url: str | None) -> str | None:
    import httpx  # noqa: PLC0415  # most commands need no web

    if url is None:
        return None
    url = url if "://" in url else f"http://{url}"
    try:
        is_address = httpx.URL(url).scheme in ("http", "https") and bool(httpx.URL(url).host)
    except httpx.InvalidURL:
        is_address = False
    if not is_address:
        raise click.ClickException(f"--url must be an address like http://127.0.0.1:8710; got {url}")
    return url


_ADDRESS = "Address of the service, e.g. http://127.0.0.1:8710"
url_option = click.option("--url", required=True, callback=_address, help=f"{_ADDRESS}.")
#: Of a command that works without a service as well.
send_to_option = click.option("--url", callback=_address, help=f"{_ADDRESS}, that it is sent to.")


def who_asks() -> tuple[str | None, str | None]:
    """Return the key of the service, and the file with the authority that signed its certificate, where stated."""
    return os.environ.get("PRELOAD_KEY"), os.environ.get("PRELOAD_CA_FILE")


def data_dir_option(words: str = "Data of the service") -> Callable[[_Command], _Command]:
    """Return the option of the data folder; ``words`` say what is done with it."""
    help_text = f"{words} (PRELOAD_DATA_DIR)."
    return click.option("--data-dir", type=click.Path(path_type=Path, file_okay=False), help=help_text)
