"""``preload identify DATA --model MODEL``: stiffness and damping of the joints, and what the data leave open."""

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.recording import ExcitationSource
from monitor_core.recordings.elements.units import metres
from monitor_core.recordings.frf_set import read_frf_set
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.model_file import read_model_file
from monitor_core.uncertainty import Estimate
from service.cli.inputs.model import NumbersCommand
from service.cli.inputs.session import (
    accelerometer_option,
    axis_settings,
    band_option,
    is_session,
    require_session,
    responses_of_session,
)
from service.cli.output import json_option, print_json, print_table, progress_bar
from service.operations.identification.joint_identification import OBJECTIVES, IdentificationRequest, identify_joints
from service.operations.identification.predicted_calibration import PredictionRequest
from service.operations.measured_responses import modal_observation


@click.command(cls=NumbersCommand)
@click.argument("data", type=click.Path(path_type=Path))
@click.option("--model", "model_path", type=click.Path(path_type=Path), required=True, help="Drive model, TOML.")
@click.option(
    "--hold-out-mm", "hold_out_mm", type=float, multiple=True, metavar="X…",
    help="Positions that the fit does not see and is judged by; without any, each in turn.",
)  # fmt: skip
@click.option(
    "--limit", "limits", type=(str, float, float), multiple=True, metavar="NAME LOW HIGH",
    help="Of a free joint, such as nut_stiffness_n_per_m 1e8 3e9; by default 30 (damping: 100) times less and more "
    "than a receptance model states, decades for other families.",
)  # fmt: skip
@click.option(
    "--objective", type=click.Choice(list(OBJECTIVES)), default="weighted", show_default=True,
    help="For peaks: errors weighted by their uncertainties, or as Eq. (26) of the paper has them.",
)  # fmt: skip
@click.option(
    "--calibration", "calibration_out", type=click.Path(path_type=Path, dir_okay=False),
    help="Also predict k1…k4 from the joints and write the calibration; needs the three options below.",
)  # fmt: skip
@click.option(
    "--mode-hz", nargs=2, type=click.FloatRange(min=0, min_open=True), metavar="LOW HIGH",
    help="Holds the mode that will be monitored, alone at every position and preload.",
)  # fmt: skip
@click.option(
    "--preload-n", nargs=2, type=click.FloatRange(min=0, min_open=True), metavar="N UNCERTAINTY",
    help="Preload of the nut while the data were taken, and its standard uncertainty.",
)  # fmt: skip
@click.option(
    "--scatter-hz", type=click.FloatRange(min=0, min_open=True),
    help="Standard deviation of the frequency between measurements of one setting.",
)  # fmt: skip
@click.option(
    "--excitation-source", type=click.Choice([str(s) for s in ExcitationSource]), default=str(ExcitationSource.SENSOR),
    show_default=True, help="What the torque will be measured with when the axis is monitored.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the search.")
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes that search.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the model with the joints found.")
@accelerometer_option
@band_option
@json_option
def identify(
    data: Path,
    model_path: Path,
    hold_out_mm: tuple[float, ...],
    limits: tuple[tuple[str, float, float], ...],
    objective: str,
    calibration_out: Path | None,
    mode_hz: tuple[float, float] | None,
    preload_n: tuple[float, float] | None,
    scatter_hz: float | None,
    excitation_source: str,
    seed: int,
    workers: int,
    out: Path | None,
    accelerometer: str | None,
    band_hz: tuple[float, float] | None,
    as_json: bool,
) -> None:
    """Find the joints of an axis from peaks (a modal table), frequency responses, or a session."""
    prediction = None
    if calibration_out is not None:
        if mode_hz is None or preload_n is None or scatter_hz is None:
            raise click.UsageError("--calibration needs --mode-hz, --preload-n and --scatter-hz; got not all of them")
        source = ExcitationSource(excitation_source)
        prediction = PredictionRequest(mode_hz, Estimate(*preload_n), scatter_hz, source)
    require_session(accelerometer, of_session=_is_session(data))
    measured, taken_as = _measured(data, band_hz)
    request = IdentificationRequest(
        model=read_model_file(model_path),
        measured=measured,
        hold_out=tuple(metres(one) for one in hold_out_mm),
        limits={name: (low, high) for name, low, high in limits},
        weighting=OBJECTIVES[objective],
        seed=seed,
        prediction=prediction,
        accelerometer=accelerometer,
        taken_as=taken_as,
    )
    for path in (out, calibration_out):
        if path is not None and not path.parent.is_dir():
            raise click.UsageError(f"{path} is to be written into a folder that is there; {path.parent} is none")
    with _mapping(workers) as map_function, _watched(data.name) as progress:
        document = identify_joints(request, map_function=map_function, progress=progress)
    if out is not None:
        out.write_text(document["model"], encoding="utf-8")
    if calibration_out is not None:
        calibration_out.write_text(json.dumps(document["calibration"], indent=2), encoding="utf-8")
    if as_json:
        print_json(document)
    else:
        _print(data, document)


def _measured(
    data: Path, band_hz: tuple[float, float] | None
) -> tuple[tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...], tuple[str, ...]]:
    """Return what was measured, and what was settled on the way, in sentences."""
    if band_hz is not None and not _is_session(data):
        raise click.UsageError(f"--band-hz goes with a session; got {data.name}")
    if data.name.endswith(".frf.h5"):
        return read_frf_set(data).observations, ()
    if _is_session(data):
        session = responses_of_session(data, axis_settings(band_hz))
        return session.observations, session.sentences
    return tuple(modal_observation(row) for row in read_modal_table(data)), ()


def _is_session(data: Path) -> bool:
    return is_session(data) and not data.name.endswith(".frf.h5")


@contextmanager
def _mapping(workers: int) -> Iterator[MapFunction]:
    if workers == 1:
        yield map
        return
    with ProcessPoolExecutor(workers) as pool:
        yield pool.map


@contextmanager
def _watched(name: str) -> Iterator[Callable[[int, int], None]]:
    with progress_bar() as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _print(data: Path, document: dict[str, Any]) -> None:
    objective = document["objective"]
    print_table(
        f"Joints from {data.name} ({objective['kind']}, {len(objective['positions_mm'])} positions)",
        ("joint", "value", "95 % interval", "verdict"),
        [_joint_row(name, one) for name, one in document["parameters"].items()],
    )
    for sentence in document["taken_as"]:
        click.echo(sentence)
    for sentence in (*document["not_identifiable"], *document["missing_modes"]):
        click.echo(f"- {sentence}.")
    rows = [
        ("starts that agree", f"{100 * objective['starts_agreeing']:.0f} % of {objective['starts']}"),
        ("residuals over their uncertainty", f"{objective['residual_standard_deviation']:.3g}"),
    ]
    if "eq_26" in objective:
        rows.append(("y of Eq. (26)", f"{objective['eq_26']:.4g}"))
    if document["held_out"] is not None:
        held_out = document["held_out"]
        rows.append((f"worst error, {held_out['kind']}", f"{held_out['worst_percent']:.2f} %"))
    if document["modes_to_monitor"]:
        best = document["modes_to_monitor"][0]
        loss = best["minimum_detectable_preload_loss"]
        shows = "no loss of preload" if loss is None else f"a preload loss of {100 * loss:.1f} %"
        rows.append(("mode to monitor", f"{best['frequency_hz']:.1f} Hz at {best['position_mm']:g} mm shows {shows}"))
    if document["next_positions"]:
        rows.append(("measure next at", f"{document['next_positions'][0]['position_mm']:.0f} mm"))
    print_table("What it rests on", ("quantity", "value"), rows)


def _joint_row(name: str, one: dict[str, Any]) -> tuple[str, ...]:
    low, high = one["interval_95"]
    return (name, f"{one['value']:.4g} {one['unit']}", f"{low:.4g} … {high:.4g}", one["verdict"])
