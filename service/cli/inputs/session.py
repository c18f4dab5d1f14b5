"""What the commands that read a session share: its measurements, gated and fitted."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from monitor_core.fitting.accelerometer import PLACES
from monitor_core.measured_responses import SessionResponses, responses_of_windows
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import AxisSettings, MeasurementOutcome, check_window, judge_measurement, measure_response
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.session_hdf5 import open_session
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


@dataclass(frozen=True, slots=True)
class SessionMeasurement:
    """One measurement of a session: what came of it, and of the windows that were refused."""

    name: str
    position_mm: float
    preload: float | None  # as set on purpose [N]
    outcome: MeasurementOutcome
    refused_windows: tuple[Rejection, ...]


def is_session(path: Path) -> bool:
    """Tell a session file from a modal table by its name."""
    return path.suffix.lower() in SESSION_SUFFIXES


def axis_settings(band_hz: tuple[float, float] | None, moving_mass: Estimate | None = None) -> AxisSettings:
    """Return the settings that the command's options state."""
    if band_hz is not None and not band_hz[0] < band_hz[1]:
        raise click.BadParameter(f"--band-hz takes LOW before HIGH; got {band_hz[0]:g} {band_hz[1]:g}")
    return AxisSettings(search_band=band_hz, moving_mass=moving_mass)


def judge_session(
    path: Path, settings: AxisSettings, calibration: Calibration | None = None
) -> Iterator[SessionMeasurement]:
    """Judge the measurements of a session one after another, with progress; memory stays flat."""
    for one in _checked_windows(path, settings, calibration):
        first = one.recorded[0].conditions
        yield SessionMeasurement(
            one.name,
            to_millimetres(first.position),
            first.preload,
            judge_measurement(one.accepted, settings, calibration) if one.accepted else _nothing_accepted(one.refused),
            one.refused,
        )


def responses_of_session(path: Path, settings: AxisSettings) -> SessionResponses:
    """Return the averaged responses of the measurements that can be judged, with progress; memory stays flat.

    All lines of a measurement count, wherever its mode is looked for.

    Raises
    ------
    NotIdentifiableError
        If there is none.
    """
    return responses_of_windows(
        (
            measure_response(one.accepted, settings) if one.accepted else _nothing_accepted(one.refused).modal,
            one.accepted,
        )
        for one in _checked_windows(path, settings, None)
    )


@dataclass(frozen=True, slots=True)
class _CheckedWindows:
    name: str
    recorded: Sequence[Window]
    accepted: Sequence[Window]
    refused: tuple[Rejection, ...]


def _checked_windows(path: Path, settings: AxisSettings, calibration: Calibration | None) -> Iterator[_CheckedWindows]:
    with open_session(path) as reader, progress_bar() as progress:
        task = progress.add_task(path.name, total=len(reader.measurements))
        for name in reader.measurements:
            windows = reader.windows_of(name)
            checked = [(window, check_window(window, settings, calibration)) for window in windows]
            refused = tuple(quality for _, quality in checked if isinstance(quality, Rejection))
            accepted = [window for window, quality in checked if not isinstance(quality, Rejection)]
            yield _CheckedWindows(name, windows, accepted, refused)
            progress.advance(task)


def fitted_modes(judged: list[SessionMeasurement]) -> list[ModalMeasurement]:
    """Return the modes of the measurements whose preload was set on purpose and that were not refused."""
    return [
        item.outcome.modal
        for item in judged
        if item.preload is not None and isinstance(item.outcome.modal, ModalMeasurement)
    ]


def _nothing_accepted(refused: tuple[Rejection, ...]) -> MeasurementOutcome:
    reasons = ", ".join(sorted({str(rejection.reason) for rejection in refused}))
    rejection = Rejection(RejectionReason.TOO_FEW_AVERAGES, f"every window was refused: {reasons}")
    return MeasurementOutcome(rejection, rejection, rejection)
