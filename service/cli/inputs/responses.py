"""What the commands share that compare the responses of a session with a model: an option, and the responses."""

import click

from monitor_core.fitting.accelerometer import PLACES
from monitor_core.measured_responses import SessionResponses, responses_of_session
from monitor_core.pipeline import AxisSettings
from service.cli.inputs.raw import Data, opened_session

accelerometer_option = click.option(
    "--accelerometer",
    type=click.Choice(list(PLACES)),
    help="Where that of a session sat; without it where the model explains the session better.",
)


def require_session(accelerometer: str | None, *, of_session: bool) -> None:
    """Refuse a stated place of an accelerometer for data that say it themselves."""
    if accelerometer is not None and not of_session:
        raise click.UsageError(
            "--accelerometer goes with a session; a set of frequency responses says it itself, peaks are of the table"
        )


def responses_of_data(data: Data, settings: AxisSettings) -> SessionResponses:
    """Return the averaged responses of a session, with progress; raises as :func:`responses_of_session`."""
    with opened_session(data) as session:
        return responses_of_session(session, settings)
