"""``preload modes MODEL``: natural frequencies and damping of a drive model along the axis."""

from pathlib import Path

import click

from monitor_core.models import DriveConditions, MotorEnd, NaturalFrequency
from monitor_core.recordings.elements.units import metres
from service.cli.inputs.model import NumbersCommand, built_model, effects_option
from service.cli.options import json_option
from service.cli.output import print_json, print_table
from service.json_types import JsonObject


@click.command(cls=NumbersCommand)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--position-mm", "positions_mm", type=float, multiple=True, required=True, metavar="X…",
    help="Table positions from the fixed bearing.",
)  # fmt: skip
@click.option("--preload-n", type=float, help="Where the nut's rigidity follows the preload.")
@click.option("--payload-kg", type=float, default=0.0, show_default=True, help="On the table.")
@click.option(
    "--motor-end",
    type=click.Choice([str(end) for end in MotorEnd]),
    help="What holds the motor end of the screw: clamped by its servo, free to turn, or under a prescribed (measured) "
    "torque, which hides the motor. Without it as in the family's paper.",
)
@effects_option
@json_option
def modes(
    model: Path,
    positions_mm: tuple[float, ...],
    preload_n: float | None,
    payload_kg: float,
    motor_end: str | None,
    effects_path: Path | None,
    as_json: bool,
) -> None:
    """List the modes of a drive model; the motion of the rigid drive (0 Hz) is left out."""
    drive = built_model(model, effects_path)
    end = None if motor_end is None else MotorEnd(motor_end)
    modes_at_places = [
        (x, drive.natural_frequencies(DriveConditions(metres(x), preload_n, payload_kg), motor_end=end))
        for x in positions_mm
    ]
    places = [(x, [mode for mode in modes if mode.frequency > 0.0]) for x, modes in modes_at_places]
    if as_json:
        positions = [{"position_mm": x, "modes": [_document(mode) for mode in modes]} for x, modes in places]
        print_json({"preload_n": preload_n, "payload_kg": payload_kg, "motor_end": motor_end, "positions": positions})
        return
    print_table(
        f"Modes of {model.name}",
        ("position", "mode", "frequency", "damping"),
        [row for x, modes in places for row in _rows(x, modes)],
    )


def _document(mode: NaturalFrequency) -> JsonObject:
    return {"frequency_hz": mode.frequency, "damping_ratio": mode.damping_ratio}


def _rows(position_mm: float, modes: list[NaturalFrequency]) -> list[tuple[str, ...]]:
    return [
        (f"{position_mm:.1f} mm", str(number), f"{mode.frequency:.3f} Hz", f"{100 * mode.damping_ratio:.3f} %")
        for number, mode in enumerate(modes, start=1)
    ]
