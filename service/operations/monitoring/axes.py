"""Register axes, change what is stated about them, and archive them."""

import hashlib
from contextlib import suppress
from typing import TYPE_CHECKING

from monitor_core.errors import OutsideValidityError
from monitor_core.trend import DetectorDesign
from service.clock import now
from service.errors import ConflictError, DocumentDamagedError, PreconditionError
from service.operations.monitoring.axis_configuration import (
    AxisConfiguration,
    detector_design,
    detector_settings,
    dump_configuration,
    load_configuration,
)
from service.operations.monitoring.intake.chart_state import dump_design, load_design
from service.store import axes
from service.store.database import Database
from service.store.tables import AxisRow

if TYPE_CHECKING:
    from monitor_core.fitting.axis import DescribedDrive


def settings_tag(name: str, configuration: AxisConfiguration) -> str:
    """Return what differs whenever name or configuration of an axis do."""
    return hashlib.sha256(f"{name}\n{configuration.model_dump_json()}".encode()).hexdigest()[:16]


class Axes:
    """Register, change and list axes."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def register(
        self,
        axis_id: str,
        name: str,
        configuration: AxisConfiguration,
        *,
        only_new: bool = False,
        if_match: str | None = None,
    ) -> tuple[AxisRow, bool]:
        """Register an axis or change its configuration; tell whether it is new.

        ``only_new``: raises ConflictError if there is one of that name. ``if_match``: a :func:`settings_tag`;
        PreconditionError if that of what is stored is another one.

        Raises OutsideValidityError if no limits of the charts give the wanted rate of false alarms;
        RecordingFormatError or OutsideValidityError if the drive model is none that an alarm could be explained with.
        """
        if configuration.drive_model is not None:
            axis_drive(configuration.drive_model)
        design = self._detector_design(axis_id, configuration)
        with self._database.write(axis_id) as session:
            row = session.get(AxisRow, axis_id)
            created = row is None
            _require_tag(axis_id, row, if_match)
            if row is not None and only_new:
                raise ConflictError(
                    f"an axis '{axis_id}' is registered already, called {row.name!r}; choose another name"
                )
            if row is None:
                row = axes.new_axis(session, axis_id, now())
                session.add(row)
            row.name = name
            row.configuration = dump_configuration(configuration)
            row.detector_design = dump_design(design)
            return row, created

    def _detector_design(self, axis_id: str, configuration: AxisConfiguration) -> DetectorDesign:
        """Return the limits that the axis has; newly solved ones if it is to achieve something else, or has none."""
        wanted = detector_settings(configuration)
        with self._database.read() as session:
            row = session.get(AxisRow, axis_id)
        with suppress(DocumentDamagedError):  # they follow from the settings, so that nothing is lost with them
            if row is not None and (stored := load_design(row.detector_design)).settings == wanted:
                return stored
        return detector_design(wanted)

    def archive(self, axis_id: str, *, archived: bool) -> None:
        """Hide an axis from lists and let it take no windows, or take that back. Nothing of it is deleted."""
        with self._database.write(axis_id) as session:
            row = axes.get_axis(session, axis_id)
            if archived != (row.archived_at is not None):
                row.archived_at = now() if archived else None

    def get(self, axis_id: str) -> AxisRow:
        """Return an axis."""
        with self._database.read() as session:
            return axes.get_axis(session, axis_id)

    def list(self) -> list[AxisRow]:
        """Return all axes."""
        with self._database.read() as session:
            return axes.list_axes(session)


def axis_drive(text: str) -> "DescribedDrive":
    """Return the drive that a model describes as TOML, which must be one whose nut follows its preload.

    Raises RecordingFormatError or OutsideValidityError if it is no drive model, or has a nut of one rigidity: no change
    of the preload could be thought of.
    """
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415  # many axes have none

    description = parse_model(text, "drive_model")
    drive = description.drive()
    if not description.nut_follows_preload:
        raise OutsideValidityError(
            "drive_model: expected dynamic_load_rating_n in [parameters], by which the nut follows its preload; got "
            "none"
        )
    return drive


def _require_tag(axis_id: str, row: AxisRow | None, if_match: str | None) -> None:
    if if_match is None:
        return
    stored = None if row is None else settings_tag(row.name, load_configuration(row.configuration))
    if if_match.strip().strip('"') != stored:
        raise PreconditionError(
            f"the settings of axis '{axis_id}' changed since they were read (If-Match {if_match}); nothing was saved"
        )
