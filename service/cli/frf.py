"""``preload frf SESSION``: frequency response, coherence and mode of each measurement."""

from collections import Counter
from pathlib import Path

import click

from monitor_core.modal import ModalMeasurement
from monitor_core.recording import ExcitationQuantity, Rejection
from monitor_core.recordings.calibration_file import EXCITATION_LEVEL_UNITS
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.session_hdf5 import EXCITATION_UNIT
from monitor_core.session import SessionMeasurement, excitation_remarks, judge_session
from service.cli.inputs.session import axis_settings, band_option, watched_session
from service.cli.output import json_option, print_json, print_table
from service.documents.measurement import modal_document, refusal_document
from service.json_types import JsonObject


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@band_option
@json_option
def frf(session: Path, band_hz: tuple[float, float] | None, as_json: bool) -> None:
    """Find the axial mode in each measurement of a recorded session."""
    settings = axis_settings(band_hz)
    with watched_session(session) as recorded:
        measurements = list(judge_session(recorded, settings))
    remarks = excitation_remarks(measurements)
    if as_json:
        print_json({"measurements": [_document(item, remarks.get(item.name)) for item in measurements]})
        return
    print_table(
        f"Modes in {session.name}",
        ("measurement", "position", "frequency", "damping", "coherence", "averages", "excitation", "remarks"),
        [_row(item, remarks.get(item.name)) for item in measurements],
    )


def _document(item: SessionMeasurement, remark: str | None) -> JsonObject:
    modal = item.outcome.modal
    document: JsonObject = {
        "measurement": item.name,
        "position_mm": to_millimetres(item.conditions.position),
        "preload_n": item.conditions.preload,
        "windows_refused": dict(Counter(str(rejection.reason) for rejection in item.refused_windows)),
        "refused": False,
        **(modal_document(modal) if isinstance(modal, ModalMeasurement) else refusal_document(modal)),
    }
    if isinstance(modal, ModalMeasurement):
        quantity = modal.excitation_quantity
        document |= {
            f"excitation_rms_{'nm' if quantity is ExcitationQuantity.TORQUE else 'n'}": modal.excitation_rms,
            "excitation_level": modal.excitation_level,
            "excitation_level_unit": EXCITATION_LEVEL_UNITS[quantity],
            "warnings": [*modal.warnings, *([] if remark is None else [remark])],
        }
    return document


def _row(item: SessionMeasurement, remark: str | None) -> tuple[str, ...]:
    modal = item.outcome.modal
    if isinstance(modal, Rejection):
        position = f"{to_millimetres(item.conditions.position):.1f} mm"
        return (item.name, position, "—", "—", "—", "—", "—", f"{modal.reason}: {modal.detail}")
    frequency = modal.mode.frequency
    return (
        item.name,
        f"{to_millimetres(modal.conditions.position):.1f} mm",
        f"{frequency.value:.3f} ± {frequency.standard_uncertainty:.3f} Hz",
        f"{100 * modal.mode.damping_ratio.value:.2f} %",
        f"{modal.coherence:.3f}",
        f"{modal.n_averages:.0f}",
        f"{modal.excitation_rms:.3g} {EXCITATION_UNIT[modal.excitation_quantity].replace('.', '·')} rms",
        "; ".join([*modal.warnings, *([] if remark is None else [remark])]),
    )
