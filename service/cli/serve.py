"""``preload serve``: the service on this machine."""

from pathlib import Path
from typing import Any

import click
import uvicorn
from pydantic import ValidationError

from service.app import create_app
from service.observability import configure_logging
from service.settings import Settings


@click.command()
@click.option("--host", help="Address to listen on (PRELOAD_HOST; loopback unless set).")
@click.option("--port", type=int, help="TCP port (PRELOAD_PORT).")
@click.option(
    "--data-dir", type=click.Path(path_type=Path, file_okay=False), help="Database and waveforms (PRELOAD_DATA_DIR)."
)
@click.option(
    "--replay-dir", type=click.Path(path_type=Path, file_okay=False), help="Recorded sessions (PRELOAD_REPLAY_DIR)."
)
def serve(**flags: Any) -> None:  # noqa: ANN401 - click hands over the flags by name
    """Run the service. Settings come from the environment (PRELOAD_*); a flag wins over it."""
    try:
        settings = Settings(**{name: value for name, value in flags.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        raise click.ClickException(f"setting {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    configure_logging(settings.log_level)
    click.echo(
        f"dashboard: http://{settings.host}:{settings.port}/   API: http://{settings.host}:{settings.port}/docs",
        err=True,
    )
    uvicorn.run(create_app(settings), host=settings.host, port=settings.port, log_config=None, access_log=False)
