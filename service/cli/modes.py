"""``preload modes MODEL``: natural frequencies and damping of a drive model along the axis, and what follows."""

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.effects import second_axis_at
from monitor_core.models import DriveConditions, DriveModel, MotorEnd, NaturalFrequency
from monitor_core.models.frequency_law import FrequencyLaw, frequency_law
from monitor_core.models.state_space import Plant, relative_error
from monitor_core.recordings.elements.units import metres, to_millimetres
from service.cli.inputs.data import require_band
from service.cli.inputs.model import NumbersCommand, built_model, effects_option
from service.cli.options import json_option
from service.cli.output import print_json, print_line, print_table
from service.cli.targets import require_target
from service.json_types import JsonObject

_ELEMENTS = ("G11", "G12", "G21", "G22")
_INPUTS = ("motor torque / r_g [N]", "force at the table [N]")
_OUTPUTS = ("r_g * motor angle [m]", "displacement of the table [m]")
#: Lines of a table for people, and of a file or a maximum over the band.
_FEW, _MANY = 19, 2001
#: What ``--out`` writes, as a target is called.
_FILES = {"matrix": "transfer matrix", "state-space": "state space"}


@click.command(cls=NumbersCommand)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--position-mm", "positions_mm", type=float, multiple=True, required=True, metavar="X…",
    help="Table positions from the fixed bearing.",
)  # fmt: skip
@click.option(
    "--second-position-mm", "seconds_mm", type=float, multiple=True, metavar="Y…",
    help="Table positions of a second axis, where the model states one; without it where it states it.",
)  # fmt: skip
@click.option("--preload-n", type=float, help="Where the nut's rigidity follows the preload.")
@click.option("--payload-kg", type=float, default=0.0, show_default=True, help="On the table.")
@click.option(
    "--motor-end",
    type=click.Choice([str(end) for end in MotorEnd]),
    help="What holds the motor end of the screw: clamped by its servo, free to turn, or under a prescribed (measured) "
    "torque, which hides the motor. Without it as in the family's paper.",
)
@click.option(
    "--show", type=click.Choice(["modes", "matrix", "state-space", "laws"]), default="modes", show_default=True,
    help="Of the family hybrid the transfer matrix of motor and table, or A, B, C, D for a controller design; of every "
    "family the first frequency as a polynomial over the positions and up to the payload.",
)  # fmt: skip
@click.option(
    "--modes", "n_modes", type=click.IntRange(min=1), default=2, show_default=True, metavar="N",
    help="Of a state space, the motion of the rigid drive among them; the others count by their springs.",
)  # fmt: skip
@click.option(
    "--band-hz", nargs=2, type=click.FloatRange(min=0, min_open=True), metavar="LOW HIGH",
    help="Of a matrix, and of the error of a state space; else from 0.01 to 3 of the elastic mode.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False),
    help="File of the matrix, *.csv or drawn as *.svg, or of the state space, *.mat.",
)  # fmt: skip
@effects_option
@json_option
def modes(
    model: Path,
    positions_mm: tuple[float, ...],
    seconds_mm: tuple[float, ...],
    preload_n: float | None,
    payload_kg: float,
    motor_end: str | None,
    show: str,
    n_modes: int,
    band_hz: tuple[float, float] | None,
    out: Path | None,
    effects_path: Path | None,
    as_json: bool,
) -> None:
    """List the modes of a drive model; the motion of the rigid drive (0 Hz) is left out."""
    if out is not None:
        if show not in _FILES:
            raise click.UsageError("--out goes with --show matrix or state-space")
        require_target(out, _FILES[show], inputs=[model], ending_needed=True)
    if band_hz is not None and show not in _FILES:
        raise click.UsageError("--band-hz goes with --show matrix or state-space")
    if seconds_mm and show != "modes":
        raise click.UsageError("--second-position-mm goes with --show modes")
    drive = built_model(model, effects_path)
    stacks: list[tuple[float | None, DriveModel]] = [(y, second_axis_at(drive, metres(y))) for y in seconds_mm]
    stacks = stacks or [(None, drive)]
    end = None if motor_end is None else MotorEnd(motor_end)
    conditions = [DriveConditions(metres(x), preload_n, payload_kg) for x in positions_mm]
    if show == "laws":
        _show_laws(drive, conditions, end, as_json=as_json)
        return
    if show != "modes":
        plant = _plant_of(drive, conditions, end)
        resonance = drive.natural_frequencies(conditions[0])[-1].frequency
        band = band_hz or (0.01 * resonance, 3.0 * resonance)
        require_band(band)
        if show == "matrix":
            _show_matrix(plant, band, resonance, out, as_json=as_json)
        else:
            _show_state_space(plant, band, n_modes, out, as_json=as_json)
        return
    places = [
        (x, y, [mode for mode in stack.natural_frequencies(place, motor_end=end) if mode.frequency > 0.0])
        for y, stack in stacks
        for x, place in zip(positions_mm, conditions, strict=True)
    ]
    if as_json:
        positions = [
            {
                "position_mm": x,
                **({} if y is None else {"second_position_mm": y}),
                "modes": [_document(mode) for mode in modes],
            }
            for x, y, modes in places
        ]
        print_json({"preload_n": preload_n, "payload_kg": payload_kg, "motor_end": motor_end, "positions": positions})
        return
    print_table(
        f"Modes of {model.name}",
        ("position", "mode", "frequency", "damping"),
        [row for x, y, modes in places for row in _rows(x, y, modes)],
    )


def _document(mode: NaturalFrequency) -> JsonObject:
    return {"frequency_hz": mode.frequency, "damping_ratio": mode.damping_ratio}


def _rows(position_mm: float, second_mm: float | None, modes: list[NaturalFrequency]) -> list[tuple[str, ...]]:
    place = f"{position_mm:.1f} mm" if second_mm is None else f"{position_mm:.1f} and {second_mm:.1f} mm"
    return [
        (place, str(number), f"{mode.frequency:.3f} Hz", f"{100 * mode.damping_ratio:.3f} %")
        for number, mode in enumerate(modes, start=1)
    ]


def _plant_of(drive: DriveModel, places: Sequence[DriveConditions], motor_end: MotorEnd | None) -> Plant:
    """Return motor and table at the one position that is stated."""
    if len(places) != 1 or motor_end not in (None, MotorEnd.FREE):
        raise click.UsageError("a transfer matrix is that of one position, with a free motor end")
    return Plant.of(drive, places[0])


def _show_matrix(plant: Plant, band: tuple[float, float], resonance: float, out: Path | None, *, as_json: bool) -> None:
    """Print G(jω) of Eq. (13) at some lines of the band; write many, or draw them."""
    few = np.unique(np.append(np.geomspace(*band, _FEW), np.clip(resonance, *band)))
    printed = _matrix(plant, few)
    many = np.geomspace(*band, _MANY)
    if out is not None and out.suffix.lower() == ".svg":
        out.write_text(_picture(plant, np.linspace(*band, _MANY)), encoding="utf-8")
    elif out is not None:
        with out.open("w", newline="", encoding="utf-8") as stream:
            write = csv.writer(stream)
            names = [f"{name.lower()}_{part}_m_per_n" for name in _ELEMENTS for part in ("re", "im")]
            write.writerow(["frequency_hz", *names])
            lines = _matrix(plant, many)
            write.writerows(np.column_stack([many, lines.view(np.float64)]).tolist())
    if as_json:
        lines_of = {
            name: {"re": element.real.tolist(), "im": element.imag.tolist()}
            for name, element in zip(_ELEMENTS, printed.T, strict=True)
        }
        print_json({**_place(plant.conditions), "frequency_hz": few.tolist(), "matrix_m_per_n": lines_of})
        return
    rows = [
        (f"{frequency:.2f} Hz", *(f"{abs(g):.3e} m/N ∠ {np.degrees(np.angle(g)):+.1f}°" for g in line))
        for frequency, line in zip(few.tolist(), printed.tolist(), strict=True)
    ]
    print_table("Displacement per force: 1 motor, torque / r_g; 2 table", ("frequency", *_ELEMENTS), rows)


def _show_state_space(
    plant: Plant, band: tuple[float, float], n_modes: int, out: Path | None, *, as_json: bool
) -> None:
    """Print the lowest modes as A, B, C, D, with the error over the band; write a MAT file."""
    space, many = plant.state_space(n_modes), np.geomspace(*band, _MANY)
    error = relative_error(plant.matrix(many), space.transfer_matrix(np.asarray(2j * np.pi * many)))
    matrices = {name: getattr(space, name) for name in "ABCD"}
    facts: JsonObject = {
        **_place(plant.conditions),
        "modes": n_modes,
        "transmission_ratio_m_per_rad": plant.transmission_ratio,
        "band_hz": list(band),
        "largest_relative_error": error,
    }
    if out is not None:
        known = {name: value for name, value in facts.items() if value is not None}
        names = {"inputs": np.array(_INPUTS, dtype=object), "outputs": np.array(_OUTPUTS, dtype=object)}
        from scipy.io import savemat  # noqa: PLC0415  # the others write none

        savemat(out, matrices | names | known)
    if as_json:
        listed = {name: matrix.tolist() for name, matrix in matrices.items()}
        print_json({**facts, "inputs": list(_INPUTS), "outputs": list(_OUTPUTS), **listed})
        return
    for name, matrix in matrices.items():
        columns = [f"{i + 1}" for i in range(matrix.shape[1])]
        print_table(name, columns, [[f"{value:.6g}" for value in row] for row in matrix.tolist()])
    print_line(f"u: {', '.join(_INPUTS)}; y: {', '.join(_OUTPUTS)}; r_g = {plant.transmission_ratio:.6g} m/rad")
    print_line(f"largest error ‖G − Gₙ‖/‖G‖ from {band[0]:.3g} to {band[1]:.3g} Hz: {100.0 * error:.2g} %")


def _show_laws(
    drive: DriveModel, places: Sequence[DriveConditions], motor_end: MotorEnd | None, *, as_json: bool
) -> None:
    """Print the first frequency as a quadratic over the stated positions and a quartic up to the payload."""
    first, positions = places[0], [place.position for place in places]
    laws = list[tuple[str, str, FrequencyLaw]]()
    if len(set(positions)) > 1:
        empty, travel = replace(first, payload_mass=0.0), (min(positions), max(positions))
        law = frequency_law(drive, lambda x: replace(empty, position=x), travel, 2, motor_end)
        laws.append(("position", "m", law))
    if first.payload_mass > 0.0:
        law = frequency_law(drive, lambda m: replace(first, payload_mass=m), (0.0, first.payload_mass), 4, motor_end)
        laws.append(("payload", "kg", law))
    if not laws:
        raise click.UsageError("a law is over two positions or more, or up to a payload: --position-mm, --payload-kg")
    if as_json:
        documents = [
            {
                "over": name,
                "unit": unit,
                "range": [law.low, law.high],
                "coefficients_hz": law.coefficients.tolist(),
                "largest_residual_hz": law.largest_residual,
            }
            for name, unit, law in laws
        ]
        print_json({"laws": documents})
        return
    rows = [
        (f"{name} x", f"{law.low:g} to {law.high:g} {unit}", _polynomial(law), f"{law.largest_residual:.2g} Hz")
        for name, unit, law in laws
    ]
    print_table("First natural frequency", ("over", "range", "f in Hz", "largest residual"), rows)


def _matrix(plant: Plant, frequency: FloatArray) -> ComplexArray:
    """Return G11, G12, G21, G22 of each line, shape (n_lines, 4)."""
    return plant.matrix(frequency).reshape(-1, 4)


def _place(conditions: DriveConditions) -> JsonObject:
    return {
        "position_mm": to_millimetres(conditions.position),
        "preload_n": conditions.preload,
        "payload_kg": conditions.payload_mass,
    }


def _polynomial(law: FrequencyLaw) -> str:
    powers = ["", " x", *(f" x^{power}" for power in range(2, law.coefficients.size))]
    signed = (f"{c:+.5g}{power}" for c, power in zip(law.coefficients.tolist(), powers, strict=True))
    return " ".join(signed).lstrip("+")


def _picture(plant: Plant, frequency: FloatArray) -> str:
    """Draw |G11|, |G12| = |G21| and |G22|, as Figs. 3 and 5 do: dashed without the loss factor."""
    from service.report.line_chart import Curve, LinePicture, stacked  # noqa: PLC0415  # as above

    own, traditional = (np.abs(_matrix(each, frequency)) for each in (plant, plant.lossless))
    panels = []
    for i, name in ((0, "|G11|"), (1, "|G12| = |G21|"), (3, "|G22|")):
        curves = [Curve(frequency, traditional[:, i], "reference"), Curve(frequency, own[:, i], "measured")]
        picture = LinePicture(name, "Hz", "m/N", curves, logarithmic=True)
        panels.append((picture, f"{name} in m/N; dashed: without loss factor"))
    return stacked(panels)
