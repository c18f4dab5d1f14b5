"""What the commands that read a session share: its options, and the session itself with progress."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click

from monitor_core.fitting.accelerometer import PLACES
from monitor_core.measured_responses import SessionResponses, responses_of_session
from monitor_core.pipeline import AxisSettings
from monitor_core.recording import Window
from monitor_core.recordings.session_hdf5 import open_session
from monitor_core.session import RecordedMeasurements
from monitor_core.uncertainty import Estimate
from service.cli.output import progress_bar

SESSION_SUFFIXES = (".h5", ".hdf5")

band_option = click.option(
    "--band-hz",
    nargs=2,
    type=click.FloatRange(min=0, min_open=True),
    metavar="LOW HIGH",
    help="Where the axial mode is looked for; without it nearly everywhere below 0.4 of the sampling rate.",
)


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


def is_session(path: Path) -> bool:
    """Tell a session file from a modal table by its name."""
    return path.suffix.lower() in SESSION_SUFFIXES


def axis_settings(band_hz: tuple[float, float] | None, moving_mass: Estimate | None = None) -> AxisSettings:
    """Return the settings that the command's options state."""
    if band_hz is not None and not band_hz[0] < band_hz[1]:
        raise click.BadParameter(f"--band-hz takes LOW before HIGH; got {band_hz[0]:g} {band_hz[1]:g}")
    return AxisSettings(search_band=band_hz, moving_mass=moving_mass)


@dataclass(frozen=True, slots=True)
class _WatchedSession:
    """A session that counts the measurements taken from it."""

    reader: RecordedMeasurements
    count: Callable[[], None]

    @property
    def measurements(self) -> tuple[str, ...]:
        return self.reader.measurements

    def windows_of(self, measurement: str) -> tuple[Window, ...]:
        self.count()
        return self.reader.windows_of(measurement)


@contextmanager
def watched_session(path: Path) -> Iterator[RecordedMeasurements]:
    """Open a session and show how many of its measurements were taken; memory stays flat."""
    with open_session(path) as reader, counted_session(reader, path.name) as session:
        yield session


@contextmanager
def counted_session(session: RecordedMeasurements, name: str) -> Iterator[RecordedMeasurements]:
    """Show how many measurements of a session were taken."""
    with progress_bar() as progress:
        task = progress.add_task(name, total=len(session.measurements))
        yield _WatchedSession(session, lambda: progress.advance(task))


def responses_of_file(path: Path, settings: AxisSettings) -> SessionResponses:
    """Return the averaged responses of a session file, with progress; raises as :func:`responses_of_session`."""
    with watched_session(path) as session:
        return responses_of_session(session, settings)
