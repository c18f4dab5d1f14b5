"""``preload torque DATA``: friction over the position and orders of the screw, from motor torque and position alone."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import radians
from pathlib import Path
from typing import Self

import click
import numpy as np

from monitor_core.recording import Rejection, Window
from monitor_core.recordings.elements.units import metres, to_millimetres
from monitor_core.torque_windows import OR, OrderLine, Screw, TorqueReading, read_torque
from monitor_core.uncertainty import Estimate, plus_minus
from service.cli.inputs.data import DataKind, data_argument, data_of, map_option, opened_session
from service.cli.options import json_option, send_to_option
from service.cli.output import print_json, print_line, print_table
from service.cli.targets import require_target
from service.clock import text_of
from service.documents.measurement import finite_or_null, refusal_document
from service.json_types import JsonObject

#: What the service charts, by the name of its line.
_CHARTED = {"screw-order": "screw", "ball-pass-order": "balls past the nut"}
_NORMAL = 1.96  # half the width of a 95 % interval, in standard uncertainties
_POSITIVE = click.FloatRange(min=0, min_open=True)


@click.command()
@data_argument
@map_option
@click.option("--lead-mm", type=_POSITIVE, required=True, help="Travel in a turn of the screw.")
@click.option("--ball-mm", type=_POSITIVE, help="Diameter of the balls; with the pitch circle it names their orders.")
@click.option("--pitch-circle-mm", type=_POSITIVE, help="Diameter of the circle of the ball centres.")
@click.option(
    "--contact-angle-deg", type=click.FloatRange(0, 89), default=45.0, show_default=True, help="Of balls and track."
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Draw friction and orders, *.svg.")
@send_to_option
@click.option("--axis", help="Axis to send it to: drag torque and orders are trended there.")
@json_option
def torque(
    paths: tuple[Path, ...], map_path: Path | None, lead_mm: float, ball_mm: float | None,
    pitch_circle_mm: float | None, contact_angle_deg: float, out: Path | None, url: str | None, axis: str | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Read friction over the position and the orders of the screw from torque or current and position."""
    if (url is None) != (axis is None):
        raise click.ClickException("to send torque, give both: --url, the service, and --axis, the axis there")
    require_target(out, "picture", inputs=paths, ending_needed=True)
    ball, circle = (None if value is None else metres(value) for value in (ball_mm, pitch_circle_mm))
    screw = Screw(metres(lead_mm), ball, circle, radians(contact_angle_deg))
    data = data_of(paths, map_path, takes=(DataKind.SESSION,))
    with opened_session(data) as recorded:
        measured = [_Measured.of(name, recorded.windows_of(name), screw) for name in recorded.measurements]
    if out is not None:
        out.write_text(_picture(measured), encoding="utf-8")
    if as_json:
        print_json({"measurements": [each.document() for each in measured]})
    else:
        columns = ("measurement", "order", "what", "torque", "95 % interval", "remarks")
        print_table(f"Torque in {data.name}", columns, [row for each in measured for row in each.rows()])
    if url is not None and axis is not None:
        from service.cli.remote.client import Client  # noqa: PLC0415  # as a rule nothing is sent

        readings = [reading for each in measured for reading in each.readings()]
        if not readings:
            raise click.ClickException("nothing is sent: no measurement told the friction of travels both ways")
        with Client(url) as client:
            answer = client.post(f"/v1/axes/{axis}/torque", {"readings": readings})
        said = f"sent to axis {axis}: {answer['accepted']} new, {answer['already_there']} already there"
        print_line(said, err=as_json)


@dataclass(frozen=True, slots=True)
class _Measured:
    """What the torque of a measurement tells."""

    name: str
    first: Window
    outcome: TorqueReading | Rejection

    @classmethod
    def of(cls, name: str, windows: Sequence[Window], screw: Screw) -> Self:
        return cls(name, min(windows, key=lambda window: window.started_at), read_torque(windows, screw))

    def document(self) -> JsonObject:
        """Return all that is said of it; torques are in the stated unit."""
        document: JsonObject = {"measurement": self.name, "at": text_of(self.first.started_at)}
        if isinstance(self.outcome, Rejection):
            return {**document, **refusal_document(self.outcome)}
        profile, spectrum = self.outcome.profile, self.outcome.spectrum
        document |= {"refused": False, "unit": self.outcome.unit}
        if isinstance(profile, Rejection):
            document["friction"] = refusal_document(profile)
        else:
            document["friction"] = {
                "drag": _estimate(profile.drag),
                "offset": _estimate(profile.mean_offset),
                "speed_mm_per_s": to_millimetres(profile.speed),
                "n_travels": list(profile.n_travels),
                "position_mm": [to_millimetres(x) for x in profile.position.tolist()],
                "friction_there": profile.friction.tolist(),
                "offset_there": profile.offset.tolist(),
                "standard_uncertainty_there": profile.standard_uncertainty,
            }
        if isinstance(spectrum, Rejection):
            document["orders"] = refusal_document(spectrum)
        else:
            document["orders"] = {
                "lines": [asdict(line) for line in spectrum.lines],
                "ripples": [{"frequency_hz": f, "amplitude": amplitude} for f, amplitude in spectrum.ripples],
                "turns": spectrum.turns,
                "n_stretches": spectrum.n_stretches,
                "order": spectrum.orders.tolist(),
                "amplitude": spectrum.amplitudes.tolist(),
            }
        return document

    def readings(self) -> list[JsonObject]:
        """Return what the service charts of it: drag torque, and the orders of screw and balls that are no ripple."""
        if isinstance(self.outcome, Rejection) or isinstance(self.outcome.profile, Rejection):
            return []
        profile, spectrum = self.outcome.profile, self.outcome.spectrum
        half = profile.drag.expanded_uncertainty
        ends = (profile.drag.value - half, profile.drag.value + half)
        told = [("drag-torque", profile.drag.value, profile.drag.standard_uncertainty, ends, min(profile.n_travels))]
        if not isinstance(spectrum, Rejection):
            for quantity, name in _CHARTED.items():
                of_name = (line for line in spectrum.lines if name in line.name.split(OR))
                for line in (line for line in of_name if line.told_from_time or not line.is_there):
                    width = (line.upper - line.lower) / (2.0 * _NORMAL)
                    told.append((quantity, line.amplitude, width, (line.lower, line.upper), spectrum.n_stretches))
        stated: JsonObject = {
            "at": text_of(self.first.started_at),
            "measurement": self.name,
            "position_mm": to_millimetres(float(profile.position[0] + profile.position[-1]) / 2.0),
            "speed_mm_per_s": to_millimetres(profile.speed),
            "unit": self.outcome.unit,
            "temperature_c": self.first.conditions.temperature,
        }
        names = ("quantity", "value", "standard_uncertainty", "interval_95", "n_repeats")
        return [finite_or_null(stated | dict(zip(names, each, strict=True))) for each in told]

    def rows(self) -> list[tuple[str, ...]]:
        """Return it as lines of the table."""
        if isinstance(self.outcome, Rejection):
            return [(self.name, "", "", "", "", self.outcome.detail)]
        (profile, spectrum), unit = (self.outcome.profile, self.outcome.spectrum), self.outcome.unit
        rows: list[tuple[str, ...]]
        if isinstance(profile, Rejection):
            rows = [(self.name, "", "friction", "", "", profile.detail)]
        else:
            forward, back = profile.n_travels
            how = f"at {to_millimetres(profile.speed):.1f} mm/s, {forward} travels forward, {back} back"
            once = "" if profile.repeats else "; how far one travel is from the next is not in the interval"
            rows = [
                (self.name, "", "friction", *_with_interval(profile.drag, unit), how + once),
                (self.name, "", "offset", *_with_interval(profile.mean_offset, unit), "weight, imbalance, zero error"),
            ]
        if isinstance(spectrum, Rejection):
            return [*rows, (self.name, "", "orders", "", "", spectrum.detail)]
        rows += [self._row(line, unit) for line in spectrum.lines]
        rows += [
            (self.name, "", "ripple over time", f"{amplitude:.3g} {unit}", "", f"{frequency:.2f} Hz, taken out")
            for frequency, amplitude in spectrum.ripples
        ]
        return rows

    def _row(self, line: OrderLine, unit: str) -> tuple[str, ...]:
        order, what = f"{line.order:.2f}", line.name or "not named by lead and balls"
        if not line.is_there:
            return self.name, order, what, "not there", f"up to {line.upper:.2g} {unit}", ""
        even = "" if line.told_from_time else "the speed was too even to tell it from a ripple over time"
        return (
            self.name,
            order,
            what,
            f"{line.amplitude:#.3g} {unit}",
            f"{line.lower:#.3g} to {line.upper:#.3g} {unit}",
            even,
        )


def _estimate(estimate: Estimate) -> JsonObject:
    half = estimate.expanded_uncertainty
    return {
        "value": estimate.value,
        "standard_uncertainty": estimate.standard_uncertainty,
        "interval_95": [estimate.value - half, estimate.value + half],
    }


def _with_interval(estimate: Estimate, unit: str) -> tuple[str, str]:
    half = estimate.expanded_uncertainty
    value = f"{plus_minus(estimate.value, estimate.standard_uncertainty)} {unit}"
    return value, f"{estimate.value - half:.4g} to {estimate.value + half:.4g} {unit}"


def _picture(measured: Sequence[_Measured]) -> str:
    """Draw friction over the position, dashed the offset, and the amplitudes over the orders, of each measurement."""
    from service.report.line_chart import Curve, LinePicture, stacked  # noqa: PLC0415  # a table needs none of it

    panels = []
    for each in measured:
        if isinstance(each.outcome, Rejection):
            continue
        unit, profile, spectrum = each.outcome.unit, each.outcome.profile, each.outcome.spectrum
        if not isinstance(profile, Rejection):
            place = 1e3 * profile.position
            curves = [Curve(place, profile.offset, "reference"), Curve(place, profile.friction, "measured")]
            words = f"{each.name}: friction in {unit}; dashed: offset"
            panels.append((LinePicture("Friction over the position", "mm", unit, curves), words))
        if not isinstance(spectrum, Rejection):
            shown = np.flatnonzero(spectrum.orders >= 2.0 / spectrum.turns)
            curves = [Curve(spectrum.orders[shown], spectrum.amplitudes[shown], "measured")]
            words = f"{each.name}: amplitude in {unit} over orders of the screw"
            panels.append((LinePicture("Orders of the screw", "1/rev", unit, curves, logarithmic=True), words))
    if not panels:
        raise click.ClickException("nothing is drawn: no measurement told friction or orders")
    return stacked(panels)
