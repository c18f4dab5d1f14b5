"""``preload simulate MODEL --out SESSION``: a recorded session from a drive model."""

from datetime import UTC, datetime
from pathlib import Path

import click
import numpy as np

from monitor_core.models import DriveConditions, DriveModel, NaturalFrequency
from monitor_core.models.generator import (
    MOTOR_END,
    GuideFriction,
    SimulationSettings,
    condition_grid,
    simulate_measurements,
)
from monitor_core.recording import ExcitationSource, Session, Window
from monitor_core.recordings.elements.units import metres, to_millimetres
from monitor_core.recordings.session_hdf5 import write_session
from service.cli.inputs.model import NumbersCommand, built_model, effects_option
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
@click.option("--sample-rate-hz", type=float, default=DEFAULTS.sample_rate, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of moves and noise.")
@click.option(
    "--torque-noise-nm", type=float, default=DEFAULTS.torque_noise, show_default=True, help="White, standard deviation."
)
@click.option(
    "--acceleration-noise-m-s2", type=float, default=DEFAULTS.acceleration_noise, show_default=True,
    help="White, standard deviation.",
)  # fmt: skip
@click.option(
    "--friction-n", type=float, default=DEFAULTS.friction.coulomb, show_default=True,
    help="Coulomb friction of the guides; it raises the frequency that is measured.",
)  # fmt: skip
@click.option(
    "--viscous-friction-ns-per-m", type=float, default=DEFAULTS.friction.viscous, show_default=True,
    help="Viscous friction of the guides.",
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
    sample_rate_hz: float,
    seed: int,
    torque_noise_nm: float,
    acceleration_noise_m_s2: float,
    friction_n: float,
    viscous_friction_ns_per_m: float,
    effects_path: Path | None,
    as_json: bool,
) -> None:
    """Record a session of a drive model: short ramps to and fro, in windows as a machine would record them."""
    require_target(out, "session file", inputs=[model], ending_needed=True)
    if out.exists() and not force:
        raise click.UsageError(f"{out} already exists; --force replaces it")
    drive = built_model(model, effects_path)
    settings = SimulationSettings(
        windows_per_measurement=windows,
        window_duration=seconds,
        sample_rate=sample_rate_hz,
        excitation_source=ExcitationSource(excitation_source),
        friction=GuideFriction(coulomb=friction_n, viscous=viscous_friction_ns_per_m),
        torque_noise=torque_noise_nm,
        acceleration_noise=acceleration_noise_m_s2,
    )
    positions = [metres(x) for x in positions_mm] or _quarter_points(drive)
    conditions = condition_grid(positions, preloads_n or (None,), (payload_kg,))
    recorded = _simulated(drive, conditions, settings, seed, label=out.name)
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
