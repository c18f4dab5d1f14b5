"""``preload lost-motion DATA``: what an axis loses where it turns back, and which part of it is play."""

from pathlib import Path

import click

from monitor_core.lost_motion import LostMotion, estimate_lost_motion
from monitor_core.recording import Rejection
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.uncertainty import Estimate
from service.cli.inputs.data import DataKind, data_argument, data_of, map_option, opened_session
from service.cli.options import json_option
from service.cli.output import print_json, print_table
from service.documents.measurement import refusal_document
from service.json_types import JsonObject


@click.command()
@data_argument
@map_option
@json_option
def lost_motion(paths: tuple[Path, ...], map_path: Path | None, as_json: bool) -> None:
    """Measure lost motion and play from slow reversals: motor less scale, with position and torque or current."""
    data = data_of(paths, map_path, takes=(DataKind.SESSION,))
    with opened_session(data) as recorded:
        measured = [
            (name, windows[0].conditions.position, estimate_lost_motion(windows))
            for name in recorded.measurements
            for windows in (recorded.windows_of(name),)
        ]
    if as_json:
        print_json({"measurements": [_document(*each) for each in measured]})
        return
    print_table(
        f"Lost motion in {data.name}",
        ("measurement", "position", "reversal value", "play", "95 % interval", "reversals", "remarks"),
        [_row(*each) for each in measured],
    )


def _document(name: str, position: float, outcome: LostMotion | Rejection) -> JsonObject:
    document: JsonObject = {"measurement": name, "position_mm": to_millimetres(position)}
    if isinstance(outcome, Rejection):
        return document | refusal_document(outcome)
    play = outcome.play
    document |= {
        "refused": False,
        "reversal_value_um": _um(outcome.reversal_value.value),
        "reversal_value_standard_uncertainty_um": _um(outcome.reversal_value.standard_uncertainty),
        "n_reversals": outcome.n_reversals,
    }
    if isinstance(play, Rejection):
        return document | {
            "play_um": None,
            "interval_95_um": [0.0, _um(outcome.reversal_value.value)],
            "why": play.detail,
        }
    low, high = _interval(play, outcome.reversal_value.value)
    return document | {
        "play_um": _um(play.value),
        "interval_95_um": [_um(low), _um(high)],
        "has_play": outcome.has_play,
    }


def _row(name: str, position: float, outcome: LostMotion | Rejection) -> tuple[str, ...]:
    place = f"{to_millimetres(position):.1f} mm"
    if isinstance(outcome, Rejection):
        return name, place, "", "", "", "", outcome.detail
    value, play = outcome.reversal_value, outcome.play
    lost = f"{_um(value.value):.2f} ± {_um(value.standard_uncertainty):.2f} µm"
    if isinstance(play, Rejection):
        return name, place, lost, "", f"0 to {_um(value.value):.2f} µm", str(outcome.n_reversals), play.detail
    low, high = _interval(play, value.value)
    said = f"{_um(play.value):.2f} µm" if outcome.has_play else "none seen"
    return name, place, lost, said, f"{_um(low):.2f} to {_um(high):.2f} µm", str(outcome.n_reversals), ""


def _interval(play: Estimate, most: float) -> tuple[float, float]:
    """Return the 95 % interval of a play, which is none below 0 and no more than all that is lost [m]."""
    half = play.expanded_uncertainty
    return max(play.value - half, 0.0), min(play.value + half, max(most, play.value))


def _um(metres: float) -> float:
    return 1e6 * metres
