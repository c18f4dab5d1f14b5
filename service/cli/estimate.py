"""``preload estimate DATA --calibration FILE``: newtons with a 95 % interval per row or measurement."""

from pathlib import Path
from typing import Any

import click

from monitor_core.preload import Calibration, PreloadEstimate, estimate_preload
from monitor_core.recording import Rejection
from monitor_core.recordings.calibration_file import read_calibration
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.session import judge_session
from service.cli.inputs.session import axis_settings, is_session, watched_session
from service.cli.output import json_option, print_json, print_table
from service.documents.measurement import estimate_document, refusal_document


@click.command()
@click.argument("data", type=click.Path(path_type=Path))
@click.option(
    "--calibration", "calibration_file", required=True, type=click.Path(path_type=Path), help="From preload calibrate."
)
@json_option
def estimate(data: Path, calibration_file: Path, as_json: bool) -> None:
    """Turn natural frequencies or a recorded session into preload."""
    calibration = read_calibration(calibration_file)
    estimates = _of_session(data, calibration) if is_session(data) else _of_table(data, calibration)
    if as_json:
        print_json({"estimates": estimates})
        return
    print_table(
        f"Preload from {data.name}",
        ("measurement", "position", "frequency", "preload", "95 % interval", "remarks"),
        [_row(item) for item in estimates],
    )


def _of_session(path: Path, calibration: Calibration) -> list[dict[str, Any]]:
    estimates = []
    with watched_session(path) as session:
        for item in judge_session(session, axis_settings(None), calibration):
            modal = item.outcome.modal
            frequency = None if isinstance(modal, Rejection) else modal.mode.frequency.value
            position_mm = to_millimetres(item.conditions.position)
            place = {"measurement": item.name, "position_mm": position_mm, "frequency_hz": frequency}
            estimates.append(place | _answer(item.outcome.preload))
    return estimates


def _of_table(path: Path, calibration: Calibration) -> list[dict[str, Any]]:
    estimates = []
    for number, row in enumerate(read_modal_table(path), start=1):
        reading = row.reading
        answer = estimate_preload(reading.estimate, reading.conditions, calibration)
        place = {
            "measurement": f"row {number}",
            "position_mm": to_millimetres(row.position),
            "frequency_hz": row.frequency,
        }
        estimates.append(place | _answer(answer))
    return estimates


def _answer(answer: PreloadEstimate | Rejection) -> dict[str, Any]:
    if isinstance(answer, Rejection):
        return {"preload_n": None, "interval_95_n": None, "extrapolated": None} | refusal_document(answer)
    return estimate_document(answer) | {"refused": False}


def _row(item: dict[str, Any]) -> tuple[str, ...]:
    frequency = "—" if item["frequency_hz"] is None else f"{item['frequency_hz']:.3f} Hz"
    place = (item["measurement"], f"{item['position_mm']:.1f} mm", frequency)
    if item["refused"]:
        return (*place, "—", "—", f"{item['reason']}: {item['detail']}")
    low, high = item["interval_95_n"]
    remarks = [*(f"{name} outside the calibrated range" for name in item["outside"]), *item["assumptions"]]
    upper = "∞" if high is None else f"{high:.0f}"
    return (*place, f"{item['preload_n']:.0f} N", f"{low:.0f} to {upper} N", "; ".join(remarks))
