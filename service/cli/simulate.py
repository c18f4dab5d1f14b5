"""``preload simulate MODEL --out SESSION``: a recorded session from a drive model."""

import csv
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click
import numpy as np
from click.core import ParameterSource

from monitor_core.models import DriveConditions, DriveModel, NaturalFrequency
from monitor_core.models.generator import (
    MOTOR_END,
    WINDOW_SPACING,
    GuideFriction,
    RecordedMotion,
    SimulationSettings,
    channels_of_motion,
    condition_grid,
    simulate_measurements,
    simulate_motion,
    stated_simulation,
    windows_of_motion,
)
from monitor_core.recording import ExcitationSource, Session, Window
from monitor_core.recordings.elements.units import metres, to_millimetres
from monitor_core.recordings.motion_csv import read_motion_profile
from monitor_core.recordings.session_hdf5 import write_session
from service.cli.inputs.model import NumbersCommand, described_model, effects_option
from service.cli.options import force_option, json_option
from service.cli.output import print_json, print_line, print_table, progress_bar
from service.cli.targets import require_target
from service.json_types import JsonObject

#: A fixed instant, so that the same seed gives the same file whenever it is written.
STARTED_AT = datetime(2025, 1, 1, tzinfo=UTC)
DEFAULTS = SimulationSettings()


@click.command(cls=NumbersCommand)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="Session file, *.session.h5."
)
@force_option
@click.option(
    "--position-mm", "positions_mm", type=float, multiple=True, metavar="X…",
    help="Table positions from the fixed bearing, one measurement at each; else the quarter points of the screw.",
)  # fmt: skip
@click.option(
    "--preload-n", "preloads_n", type=float, multiple=True, metavar="P…",
    help="Where the nut's rigidity follows the preload; every position at each.",
)  # fmt: skip
@click.option("--payload-kg", type=float, default=0.0, show_default=True, help="On the table.")
@click.option(
    "--excitation-source", type=click.Choice(["sensor", "drive"]),
    default=str(DEFAULTS.excitation_source), show_default=True,
    help="Torque sensor behind the coupling, or torque of the drive: they see different poles.",
)  # fmt: skip
@click.option(
    "--windows", type=click.IntRange(min=1), default=DEFAULTS.windows_per_measurement, show_default=True,
    help="Per measurement.",
)  # fmt: skip
@click.option("--seconds", type=float, default=DEFAULTS.window_duration, show_default=True, help="Length of a window.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of moves and noise.")
@click.option(
    "--motion", "motion_path", type=click.Path(path_type=Path), metavar="FILE",
    help="*.csv of time_s, position_m or speed_m_per_s, and cutting_force_n, that the speed loop of the model follows "
    "from each position on, in place of moves; its windows follow each other.",
)  # fmt: skip
@click.option(
    "--channels", type=click.Path(path_type=Path, dir_okay=False),
    help="Of a motion under the first conditions: speeds, torques, forces at the bearings; *.csv or drawn as *.svg.",
)  # fmt: skip
@effects_option
@json_option
def simulate(
    model: Path,
    out: Path,
    force: bool,
    positions_mm: tuple[float, ...],
    preloads_n: tuple[float, ...],
    payload_kg: float,
    excitation_source: str,
    windows: int,
    seconds: float,
    seed: int,
    motion_path: Path | None,
    channels: Path | None,
    effects_path: Path | None,
    as_json: bool,
) -> None:
    """Record a session of a drive model: short ramps to and fro, or a motion that its speed loop follows.

    [simulation] in the model file states how it is recorded, dry friction and the loop.
    """
    require_target(out, "session file", inputs=[model], ending_needed=True)
    for target in (out, channels):
        if target is not None and target.exists() and not force:
            raise click.UsageError(f"{target} already exists; --force replaces it")
    given = click.get_current_context().get_parameter_source("windows")
    if motion_path is not None and given is ParameterSource.COMMANDLINE:
        raise click.UsageError("--windows goes without --motion: the motion says how many there are")
    if channels is not None:
        if motion_path is None:
            raise click.UsageError("--channels goes with --motion")
        require_target(channels, "channels of a motion", inputs=[model, motion_path], ending_needed=True)
    description, drive = described_model(model, effects_path)
    stated = stated_simulation(description.simulation)
    settings = SimulationSettings(
        windows_per_measurement=windows,
        window_duration=seconds,
        sample_rate=stated.recording.get("sample_rate", DEFAULTS.sample_rate),
        excitation_source=ExcitationSource(excitation_source),
        friction=GuideFriction(coulomb=stated.friction.guides.coulomb),
        torque_noise=stated.recording.get("torque_noise", DEFAULTS.torque_noise),
        acceleration_noise=stated.recording.get("acceleration_noise", DEFAULTS.acceleration_noise),
        random_speed=stated.recording.get("random_speed", DEFAULTS.random_speed),
    )
    positions = [metres(x) for x in positions_mm] or _quarter_points(drive)
    conditions = condition_grid(positions, preloads_n or (None,), (payload_kg,))
    if motion_path is None:
        recorded = _simulated(drive, conditions, settings, seed, label=out.name)
    else:
        profile = read_motion_profile(motion_path)

        def follow(condition: DriveConditions, rng: np.random.Generator) -> RecordedMotion:
            return simulate_motion(drive, condition, profile, stated, settings, rng=rng)

        motions = _followed(conditions, seed, follow)
        recorded = _of_motions(motions, conditions, settings, seed)
        if channels is not None:
            _write_channels(channels, motions[0])
    write_session(out, Session(model.stem, recorded, f"simulated from {model.name} with seed {seed}"))
    measurements = [(f"m{i:04d}", c, _first_mode(drive, c, settings)) for i, c in enumerate(conditions)]
    if not all(mode.damping_ratio > 0.0 for _, _, mode in measurements):
        print_line("the model states no damping: its mode rings on beyond the windows and cannot be fitted", err=True)
    if as_json:
        documents = [_document(*item) for item in measurements]
        print_json({"session": str(out), "windows": len(recorded), "seed": seed, "measurements": documents})
        return
    print_table(
        f"{len(recorded)} windows in {out.name}",
        ("measurement", "position", "preload", "the model's first mode"),
        [_row(*item) for item in measurements],
    )


def _simulated(
    drive: DriveModel, conditions: tuple[DriveConditions, ...], settings: SimulationSettings, seed: int, *, label: str
) -> tuple[Window, ...]:
    windows: list[Window] = []
    rng = np.random.default_rng(seed)
    with progress_bar() as progress:
        task = progress.add_task(label, total=len(conditions))
        for measurement in simulate_measurements(drive, conditions, settings, started_at=STARTED_AT, rng=rng):
            windows += measurement
            progress.advance(task)
    return tuple(windows)


def _followed(
    conditions: Sequence[DriveConditions],
    seed: int,
    follow: Callable[[DriveConditions, np.random.Generator], RecordedMotion],
) -> list[RecordedMotion]:
    """Run the drive under each condition, on all cores: compiled, the steps leave the interpreter to the others."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(follow, conditions, np.random.default_rng(seed).spawn(len(conditions))))


def _of_motions(
    motions: Sequence[RecordedMotion], conditions: Sequence[DriveConditions], settings: SimulationSettings, seed: int
) -> tuple[Window, ...]:
    """Return the windows of all motions, each a measurement that starts when the one before it is over."""
    streams = np.random.default_rng(seed + 1).spawn(len(conditions))
    lasts = timedelta(seconds=WINDOW_SPACING * motions[0].time.size / settings.sample_rate)
    return tuple(
        window
        for i, (motion, condition) in enumerate(zip(motions, conditions, strict=True))
        for window in windows_of_motion(
            motion, condition, settings, measurement=f"m{i:04d}", starts=STARTED_AT + i * lasts, rng=streams[i]
        )
    )


def _write_channels(path: Path, motion: RecordedMotion) -> None:
    """Write the channels of a motion as columns, or draw them."""
    channels = channels_of_motion(motion)
    if path.suffix.lower() == ".csv":
        with path.open("w", newline="", encoding="utf-8") as stream:
            write = csv.writer(stream)
            write.writerow(channels)
            write.writerows(np.column_stack(list(channels.values())).tolist())
        return
    from service.report.line_chart import Curve, LinePicture, stacked  # noqa: PLC0415  # most draw none

    panels = [
        ("speed of the motor in rad/s; dashed: commanded", "rad/s", motion.speed, motion.commanded_speed),
        ("torque at the nut in N·m; dashed: of the motor", "N·m", motion.nut_torque, motion.motor_torque),
        ("force on the fixed bearing in N; dashed: far bearing", "N", motion.bearing_force, motion.far_bearing_force),
        ("acceleration of the table in m/s²", "m/s²", motion.acceleration, None),
    ]
    pictures = []
    for title, unit, own, beside in panels:
        curves = [Curve(motion.time, own, "measured")]
        if beside is not None:
            curves.insert(0, Curve(motion.time, beside, "reference"))
        pictures.append((LinePicture(title, "s", unit, curves), title))
    path.write_text(stacked(pictures), encoding="utf-8")


def _quarter_points(drive: DriveModel) -> list[float]:
    length = drive.parameters.to_file_names()["screw_length_m"]
    return [share * length for share in (0.25, 0.5, 0.75)]


def _first_mode(drive: DriveModel, condition: DriveConditions, settings: SimulationSettings) -> NaturalFrequency:
    poles = drive.natural_frequencies(condition, MOTOR_END[settings.excitation_source])
    return next(pole for pole in poles if pole.frequency > 0.0)


def _document(name: str, condition: DriveConditions, first: NaturalFrequency) -> JsonObject:
    return {
        "measurement": name,
        "position_mm": to_millimetres(condition.position),
        "preload_n": condition.preload,
        "payload_kg": condition.payload_mass,
        "model_frequency_hz": first.frequency,
        "model_damping_ratio": first.damping_ratio,
    }


def _row(name: str, condition: DriveConditions, first: NaturalFrequency) -> tuple[str, ...]:
    return (
        name,
        f"{to_millimetres(condition.position):.1f} mm",
        "—" if condition.preload is None else f"{condition.preload:g} N",
        f"{first.frequency:.3f} Hz, {100 * first.damping_ratio:.2f} %",
    )
