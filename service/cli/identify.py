"""``preload identify DATA --model MODEL``: stiffness and damping of the joints, and what the data leave open."""

import json
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import click

from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.identification import (
    IdentifiedJoint,
    IdentifiedJoints,
    IdentifyOptions,
    MapFunction,
    PredictionRequest,
    identify as identify_joints,
)
from monitor_core.recordings.calibration_file import write_calibration
from monitor_core.recordings.effect_file import read_effect_file
from monitor_core.recordings.elements.units import metres, to_millimetres
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.model_file import read_model_file, write_model_file
from service.cli.inputs.data import (
    Data,
    DataKind,
    axis_settings,
    band_option,
    data_argument,
    data_of,
    frf_set_of,
    map_option,
)
from service.cli.inputs.model import (
    NumbersCommand,
    accelerometer_option,
    effects_option,
    model_at,
    require_session,
    responses_of_data,
)
from service.cli.options import json_option
from service.cli.output import print_json, print_line, print_table, progress_bar
from service.cli.targets import require_target
from service.documents.identification import OBJECTIVES, held_out_kind, identification_document
from service.errors import first_refusal


def _prediction(_context: click.Context, _option: click.Parameter, text: str | None) -> PredictionRequest | None:
    """Read what a calibration is predicted for: a table in a line of TOML, with the members that it has on the wire."""
    from pydantic import ValidationError  # noqa: PLC0415  # most runs predict none

    from service.operations.identification_job import PredictionIn  # noqa: PLC0415

    if text is None:
        return None
    try:
        stated = tomllib.loads(f"prediction = {{ {text} }}")["prediction"]
        return PredictionIn.model_validate_json(json.dumps(stated, default=str)).to_core()
    except tomllib.TOMLDecodeError as error:
        raise click.BadParameter(f"expected a table such as 'mode_hz = [120, 260], …'; {error}") from error
    except ValidationError as error:
        raise click.BadParameter(first_refusal(error)) from error


@click.command(cls=NumbersCommand)
@data_argument
@map_option
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
    help="Also predict k1…k4 from the joints and write the calibration; needs --prediction.",
)  # fmt: skip
@click.option(
    "--prediction", callback=_prediction, metavar="TABLE",
    help="For --calibration, as on the wire, such as 'mode_hz = [120, 260], preload_n = 200, "
    "preload_standard_uncertainty_n = 5, scatter_hz = 0.3': what holds the monitored mode alone, the preload while the "
    "data were taken, and how the frequency scatters between measurements; excitation_source = \"drive\" where that "
    "will tell the torque.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the search.")
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes that search.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the model with the joints found.")
@effects_option
@accelerometer_option
@band_option
@json_option
def identify(
    paths: tuple[Path, ...],
    map_path: Path | None,
    model_path: Path,
    hold_out_mm: tuple[float, ...],
    limits: tuple[tuple[str, float, float], ...],
    objective: str,
    calibration_out: Path | None,
    prediction: PredictionRequest | None,
    seed: int,
    workers: int,
    out: Path | None,
    effects_path: Path | None,
    accelerometer: str | None,
    band_hz: tuple[float, float] | None,
    as_json: bool,
) -> None:
    """Find the joints of an axis from peaks (a modal table), frequency responses, or a session."""
    require_target(out, "model file", inputs=paths)  # the model may be replaced by what became of it
    require_target(calibration_out, "calibration", inputs=[*paths, model_path])
    if out is not None and calibration_out is not None and out.resolve() == calibration_out.resolve():
        raise click.UsageError(f"--out and --calibration write to one file, {out}")
    if (calibration_out is None) is not (prediction is None):
        raise click.UsageError("--calibration and --prediction go together")
    data = data_of(paths, map_path, takes=(DataKind.MODAL_TABLE, DataKind.FRF_SET, DataKind.SESSION))
    require_session(accelerometer, of_session=data.is_session)
    axis = read_model_file(model_at(model_path))
    measured, assumptions = _measured(data, band_hz)
    options = IdentifyOptions(
        hold_out=tuple(metres(position) for position in hold_out_mm),
        limits={name: (low, high) for name, low, high in limits},
        weighting=OBJECTIVES[objective],
        seed=seed,
        prediction=prediction,
        accelerometer=accelerometer,
        assumptions=assumptions,
        effects=() if effects_path is None else read_effect_file(effects_path),
    )
    with _mapping(workers) as map_function, _watched(data.name) as progress:
        joints = identify_joints(axis, measured, options, map_function=map_function, progress=progress)
    if out is not None:
        write_model_file(out, joints.model)
    if calibration_out is not None and joints.calibration is not None:
        write_calibration(calibration_out, joints.calibration)
    if as_json:
        print_json(identification_document(joints))
    else:
        _print(data, joints)


def _measured(
    data: Data, band_hz: tuple[float, float] | None
) -> tuple[tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...], tuple[str, ...]]:
    """Return what was measured, and what was settled on the way, in sentences."""
    if band_hz is not None and not data.is_session:
        raise click.UsageError(f"--band-hz goes with a session; got {data.name}")
    if data.kind is DataKind.FRF_SET:
        return frf_set_of(data).observations, ()
    if data.is_session:
        session = responses_of_data(data, axis_settings(band_hz))
        return session.observations, session.sentences
    return tuple(row.observation for row in read_modal_table(data.file)), ()


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


def _print(data: Data, identified: IdentifiedJoints) -> None:
    quality = identified.quality
    print_table(
        f"Joints from {data.name} ({quality.kind}, {len(quality.positions)} positions)",
        ("joint", "value", "95 % interval", "verdict"),
        [_joint_row(name, joint) for name, joint in identified.joints.items()],
    )
    for sentence in identified.assumptions:
        print_line(sentence)
    dropped = [peak.sentence for peak in identified.dropped_peaks]
    for sentence in (*identified.not_identifiable, *identified.missing_modes, *dropped):
        print_line(f"- {sentence}.")
    rows = [
        ("starts that agree", f"{100 * quality.starts_agreeing:.0f} % of {quality.starts}"),
        ("residuals over their uncertainty", f"{quality.residual_standard_deviation:.3g}"),
    ]
    if quality.paper_objective is not None:
        rows.append(("y of Eq. (26)", f"{quality.paper_objective:.4g}"))
    if identified.held_out is not None:
        worst = 100.0 * abs(identified.held_out.worst.relative_error)
        rows.append((f"worst error, {held_out_kind(identified.held_out)}", f"{worst:.2f} %"))
    if identified.modes_to_monitor:
        best = identified.modes_to_monitor[0]
        loss = best.preload_loss
        shows = "no loss of preload" if loss is None else f"a preload loss of {100 * loss:.1f} %"
        where = f"{to_millimetres(best.peak.conditions.position):g} mm"
        rows.append(("mode to monitor", f"{best.peak.frequency:.1f} Hz at {where} shows {shows}"))
    if identified.next_positions:
        rows.append(("measure next at", f"{to_millimetres(identified.next_positions[0].position):.0f} mm"))
    print_table("What it rests on", ("quantity", "value"), rows)
    if identified.robustness:
        _print_robustness(identified)


def _print_robustness(identified: IdentifiedJoints) -> None:
    """Print what each position alone gives beside all of them, and the worst error of each at every position."""
    columns = identified.robustness
    rows = [
        (f"{name} [{joint.unit}]", *(f"{each.joints[name]:.4g}" for each in columns))
        for name, joint in identified.joints.items()
    ]
    for place in dict.fromkeys(error.conditions.position for error in columns[0].errors):
        seen = [
            [100.0 * abs(e.relative_error) for e in each.errors if e.conditions.position == place] for each in columns
        ]
        rows.append((f"worst error at {to_millimetres(place):g} mm", *(f"{max(errors):.2f} %" for errors in seen)))
    names = ["from " + ", ".join(f"{to_millimetres(x):g}" for x in each.positions) + " mm" for each in columns]
    print_table("One position against several", ("quantity", *names), rows)


def _joint_row(name: str, joint: IdentifiedJoint) -> tuple[str, ...]:
    ends = joint.interval
    between = "none: lack of fit" if ends is None else f"{ends.lower:.4g} … {ends.upper:.4g}"
    return (name, f"{joint.estimate.value:.4g} {joint.unit}", between, str(joint.verdict))
