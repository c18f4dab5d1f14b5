"""``preload frf SESSION``: frequency response, coherence and mode of each measurement."""

from collections import Counter
from pathlib import Path
from typing import Any

import click

from monitor_core.modal import ModalMeasurement
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.session import SessionMeasurement, judge_session
from service.cli.inputs.session import axis_settings, band_option, watched_session
from service.cli.output import json_option, print_json, print_table
from service.documents.measurement import modal_document, refusal_document


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@band_option
@json_option
def frf(session: Path, band_hz: tuple[float, float] | None, as_json: bool) -> None:
    """Find the axial mode in each measurement of a recorded session."""
    settings = axis_settings(band_hz)
    with watched_session(session) as recorded:
        measurements = [_document(item) for item in judge_session(recorded, settings)]
    if as_json:
        print_json({"measurements": measurements})
        return
    print_table(
        f"Modes in {session.name}",
        ("measurement", "position", "frequency", "damping", "coherence", "averages", "remarks"),
        [_row(item) for item in measurements],
    )


def _document(item: SessionMeasurement) -> dict[str, Any]:
    modal = item.outcome.modal
    document: dict[str, Any] = {
        "measurement": item.name,
        "position_mm": to_millimetres(item.conditions.position),
        "preload_n": item.conditions.preload,
        "windows_refused": dict(Counter(str(rejection.reason) for rejection in item.refused_windows)),
        "refused": False,
    }
    return document | (modal_document(modal) if isinstance(modal, ModalMeasurement) else refusal_document(modal))


def _row(item: dict[str, Any]) -> tuple[str, ...]:
    place = (item["measurement"], f"{item['position_mm']:.1f} mm")
    if item["refused"]:
        return (*place, "—", "—", "—", "—", f"{item['reason']}: {item['detail']}")
    return (
        *place,
        f"{item['frequency_hz']:.3f} ± {item['frequency_standard_uncertainty_hz']:.3f} Hz",
        f"{100 * item['damping_ratio']:.2f} %",
        f"{item['coherence']:.3f}",
        f"{item['n_averages']:.0f}",
        "; ".join(item["warnings"]),
    )
