"""``preload frf DATA``: frequency response, coherence and mode of each measurement, or the modes of an FRF set."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from monitor_core.modal import ModalMeasurement
from monitor_core.recording import Rejection
from monitor_core.recordings.calibration_file import EXCITATION_LEVEL_UNITS
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.session_hdf5 import UNIT_IN_NAMES
from monitor_core.session import (
    MeasuredModes,
    SessionMeasurement,
    excitation_remarks,
    judge_session,
    modes_of_session,
)
from monitor_core.uncertainty import plus_minus
from service.cli.inputs.data import (
    Data,
    DataKind,
    axis_settings,
    band_option,
    data_argument,
    data_of,
    frf_set_of,
    map_option,
    opened_session,
)
from service.cli.options import json_option
from service.cli.output import print_json, print_table
from service.documents.measurement import modal_document, refusal_document
from service.json_types import JsonObject

if TYPE_CHECKING:
    from monitor_core.response_modes import ModesAtConditions

_MOST_MODES = 30


@click.command()
@data_argument
@map_option
@band_option
@click.option(
    "--modes", "n_modes", type=click.IntRange(min=1, max=_MOST_MODES), metavar="N",
    help="List up to N modes of each measurement, those that carry most of the response; of a set of frequency "
    "responses exactly N, without it one for each peak.",
)  # fmt: skip
@json_option
def frf(
    paths: tuple[Path, ...],
    map_path: Path | None,
    band_hz: tuple[float, float] | None,
    n_modes: int | None,
    as_json: bool,
) -> None:
    """Find the axial mode in each measurement of a recorded session, or the modes of frequency responses."""
    settings = axis_settings(band_hz)
    data = data_of(paths, map_path, takes=(DataKind.SESSION, DataKind.FRF_SET))
    if data.kind is DataKind.FRF_SET:
        _of_responses(data, band_hz, n_modes, as_json=as_json)
        return
    with opened_session(data) as recorded:
        if n_modes is None:
            measurements = [MeasuredModes(item, ()) for item in judge_session(recorded, settings)]
        else:
            measurements = list(modes_of_session(recorded, settings, n_modes))
    remarks = excitation_remarks([item.measurement for item in measurements])
    if as_json:
        listed = n_modes is not None
        documents = [_document(item, remarks.get(item.measurement.name), listed=listed) for item in measurements]
        print_json({"measurements": documents})
        return
    if n_modes is None:
        each = [item.measurement for item in measurements]
        rows = [_row(item, item.outcome.modal, remarks.get(item.name)) for item in each]
    else:
        rows = [_row(item.measurement, mode) for item in measurements for mode in item.modes]
    print_table(
        f"Modes in {data.name}",
        ("measurement", "position", "frequency", "damping", "coherence", "averages", "excitation", "remarks"),
        rows,
    )


def _document(measured: MeasuredModes, remark: str | None, *, listed: bool) -> JsonObject:
    item = measured.measurement
    document: JsonObject = {
        "measurement": item.name,
        "position_mm": to_millimetres(item.conditions.position),
        "preload_n": item.conditions.preload,
        "windows_refused": dict(Counter(str(rejection.reason) for rejection in item.refused_windows)),
        **_outcome_document(item.outcome.modal, remark),
    }
    if listed:
        document["modes"] = [_outcome_document(mode, None) for mode in measured.modes]
    return document


def _outcome_document(outcome: ModalMeasurement | Rejection, remark: str | None) -> JsonObject:
    if isinstance(outcome, Rejection):
        return refusal_document(outcome)
    quantity = outcome.excitation_quantity
    return {
        "refused": False,
        **modal_document(outcome),
        f"excitation_rms_{UNIT_IN_NAMES[quantity]}": outcome.excitation_rms,
        "excitation_quantity": str(quantity),
        "excitation_source": str(outcome.excitation_source),
        "response_quantity": str(outcome.response_quantity),
        "excitation_level": outcome.excitation_level,
        "excitation_level_unit": EXCITATION_LEVEL_UNITS[quantity],
        "warnings": _said(outcome, remark),
    }


def _said(modal: ModalMeasurement, remark: str | None) -> list[str]:
    return [*modal.warnings, *([] if remark is None else [remark])]


def _row(item: SessionMeasurement, mode: ModalMeasurement | Rejection, remark: str | None = None) -> tuple[str, ...]:
    conditions = item.conditions if isinstance(mode, Rejection) else mode.conditions
    place = (item.name, f"{to_millimetres(conditions.position):.1f} mm")
    if isinstance(mode, Rejection):
        return (*place, "—", "—", "—", "—", "—", f"{mode.reason}: {mode.detail}")
    frequency = mode.mode.frequency
    return (
        *place,
        f"{plus_minus(frequency.value, frequency.standard_uncertainty)} Hz",
        f"{100 * mode.mode.damping_ratio.value:.2f} %",
        f"{mode.coherence:.3f}",
        f"{mode.n_averages:.0f}",
        f"{mode.excitation_rms:.3g} {mode.excitation_quantity.unit} rms",
        "; ".join(_said(mode, remark)),
    )


def _of_responses(data: Data, band_hz: tuple[float, float] | None, n_modes: int | None, *, as_json: bool) -> None:
    # imported here: it brings the drive models along, which a session needs none of
    from monitor_core.response_modes import modes_by_conditions  # noqa: PLC0415

    observations = frf_set_of(data).observations
    groups = list(modes_by_conditions(observations, band=band_hz, n_modes=n_modes))
    if as_json:
        print_json({"responses": [_response_document(group) for group in groups]})
        return
    print_table(
        f"Modes in {data.name}",
        ("responses", "position", "frequency", "damping", "remarks"),
        [row for group in groups for row in _response_rows(group)],
    )


def _response_document(group: "ModesAtConditions") -> JsonObject:
    place: JsonObject = {
        "responses": list(group.responses),
        "position_mm": to_millimetres(group.conditions.position),
        "preload_n": group.conditions.preload,
        "payload_kg": group.conditions.payload_mass,
    }
    if isinstance(group.found, Rejection):
        return place | refusal_document(group.found)
    modes: list[JsonObject] = [
        {
            "frequency_hz": mode.frequency.value,
            "frequency_standard_uncertainty_hz": mode.frequency.standard_uncertainty,
            "damping_ratio": mode.damping_ratio.value,
            "damping_ratio_standard_uncertainty": mode.damping_ratio.standard_uncertainty,
        }
        for mode in group.found.modes
    ]
    band: list[float] = list(group.found.band)
    return place | {"refused": False, "modes": modes, "unexplained": group.found.unexplained, "band_hz": band}


def _response_rows(group: "ModesAtConditions") -> list[tuple[str, ...]]:
    numbers = ", ".join(f"{number:04d}" for number in group.responses[:5])
    name = numbers + (", …" if len(group.responses) > 5 else "")
    position = f"{to_millimetres(group.conditions.position):.1f} mm"
    if isinstance(group.found, Rejection):
        return [(name, position, "—", "—", f"{group.found.reason}: {group.found.detail}")]
    said = f"the modes leave {100 * group.found.unexplained:.2g} % of the responses unexplained"
    return [
        (
            name,
            position,
            f"{plus_minus(mode.frequency.value, mode.frequency.standard_uncertainty)} Hz",
            f"{100 * mode.damping_ratio.value:.2f} %",
            said,
        )
        for mode in group.found.modes
    ]
