"""``preload lost-motion DATA``: what an axis loses where it turns back, and which part of it is play."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import click

from monitor_core.lost_motion import LostMotion, estimate_lost_motion
from monitor_core.recording import Rejection, Window
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.uncertainty import Estimate, plus_minus
from service.cli.inputs.data import DataKind, data_argument, data_of, map_option, opened_session
from service.cli.options import json_option, send_to_option
from service.cli.output import print_json, print_line, print_table
from service.clock import text_of
from service.documents.measurement import finite_or_null, refusal_document
from service.json_types import JsonObject


@click.command()
@data_argument
@map_option
@send_to_option
@click.option("--axis", help="Axis to send it to: lost motion is trended there, and alarms as it grows.")
@json_option
def lost_motion(
    paths: tuple[Path, ...], map_path: Path | None, url: str | None, axis: str | None, as_json: bool
) -> None:
    """Measure lost motion and play from slow reversals: motor less scale, with position and torque or current."""
    if (url is None) != (axis is None):
        raise click.ClickException("to send lost motion, give both: --url, the service, and --axis, the axis there")
    data = data_of(paths, map_path, takes=(DataKind.SESSION,))
    with opened_session(data) as recorded:
        measured = [_Measured.of(name, recorded.windows_of(name)) for name in recorded.measurements]
    if as_json:
        print_json({"measurements": [each.document() for each in measured]})
    else:
        print_table(
            f"Lost motion in {data.name}",
            ("measurement", "position", "reversal value", "play", "95 % interval", "reversals", "remarks"),
            [each.row() for each in measured],
        )
    if url is not None and axis is not None:
        print_line(_sent(measured, url, axis), err=as_json)


@dataclass(frozen=True, slots=True)
class _Measured:
    """What the reversals of a measurement tell, and when and where they were made."""

    name: str
    first: Window
    outcome: LostMotion | Rejection

    @classmethod
    def of(cls, name: str, windows: Sequence[Window]) -> Self:
        return cls(name, min(windows, key=lambda window: window.started_at), estimate_lost_motion(windows))

    def reading(self) -> JsonObject | None:
        """Return it as the service takes it; None of what tells none."""
        if isinstance(self.outcome, Rejection):
            return None
        value, play = self.outcome.reversal_value, self.outcome.play
        half = value.expanded_uncertainty
        told = None if isinstance(play, Rejection) else _interval(play, value.value)
        reading: JsonObject = finite_or_null({
            "at": text_of(self.first.started_at),
            "measurement": self.name,
            "position_mm": to_millimetres(self.first.conditions.position),
            "reversal_value_um": _um(value.value),
            "reversal_value_standard_uncertainty_um": _um(value.standard_uncertainty),
            "reversal_value_interval_95_um": [_um(value.value - half), _um(value.value + half)],
            "play_interval_95_um": None if told is None else [_um(end) for end in told],
            "n_reversals": self.outcome.n_reversals,
            "temperature_c": self.first.conditions.temperature,
        })  # fmt: skip
        return reading

    def document(self) -> JsonObject:
        """Return all that is said of it."""
        reading, outcome = self.reading(), self.outcome
        if reading is None or isinstance(outcome, Rejection):
            place = to_millimetres(self.first.conditions.position)
            refusal = refusal_document(outcome) if isinstance(outcome, Rejection) else {}
            return {"measurement": self.name, "position_mm": place, **refusal}
        if isinstance(outcome.play, Rejection):
            return {**reading, "refused": False, "play_um": None, "why": outcome.play.detail}
        return {**reading, "refused": False, "play_um": _um(outcome.play.value), "has_play": outcome.has_play}

    def row(self) -> tuple[str, ...]:
        """Return it as a line of the table."""
        place, outcome = f"{to_millimetres(self.first.conditions.position):.1f} mm", self.outcome
        if isinstance(outcome, Rejection):
            return self.name, place, "", "", "", "", outcome.detail
        value, play = outcome.reversal_value, outcome.play
        lost = f"{plus_minus(_um(value.value), _um(value.standard_uncertainty))} µm"
        turns = str(outcome.n_reversals)
        if isinstance(play, Rejection):
            return self.name, place, lost, "", f"0 to {_um(value.value):.2f} µm", turns, play.detail
        low, high = _interval(play, value.value)
        said = f"{_um(play.value):.2f} µm" if outcome.has_play else "none seen"
        return self.name, place, lost, said, f"{_um(low):.2f} to {_um(high):.2f} µm", turns, ""


def _sent(measured: list[_Measured], url: str, axis: str) -> str:
    """Send what was measured, and say what the service makes of it."""
    readings = [reading for each in measured if (reading := each.reading()) is not None]
    if not readings:
        return "nothing is sent: no measurement told lost motion"
    from service.cli.remote.client import Client  # noqa: PLC0415  # as a rule nothing is sent

    with Client(url) as client:
        answer = client.post(f"/v1/axes/{axis}/lost-motion", {"readings": readings})
    return (
        f"sent to axis {axis}: {answer['accepted']} new, {answer['already_there']} already there. {answer['sentence']}"
    )


def _interval(play: Estimate, most: float) -> tuple[float, float]:
    """Return the 95 % interval of a play, which is none below 0 and no more than all that is lost [m]."""
    half = play.expanded_uncertainty
    return max(play.value - half, 0.0), min(play.value + half, max(most, play.value))


def _um(metres: float) -> float:
    return 1e6 * metres
