"""What the commands that read a session share: its options, and the session itself with progress."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click

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
