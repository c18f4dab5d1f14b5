"""Read what a model file states of a simulated session: how it is recorded, dry friction, the speed loop."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from monitor_core.errors import OutsideValidityError
from monitor_core.models.published.transmission_line.grid import SMOOTH, DriveFriction, SpeedControl, StribeckFriction

_FORCE = {"coulomb_n": "coulomb", "static_n": "static", "stribeck_velocity_m_per_s": "stribeck_velocity"}
_TORQUE = {"coulomb_nm": "coulomb", "static_nm": "static", "stribeck_velocity_rad_per_s": "stribeck_velocity"}
#: Of each table ``[simulation.<name>]`` its entries, and what they are called here.
TABLES: Mapping[str, Mapping[str, str]] = {
    "recording": {
        "sample_rate_hz": "sample_rate", "torque_noise_nm": "torque_noise",
        "acceleration_noise_m_per_s2": "acceleration_noise", "random_speed_m_per_s": "random_speed",
    },
    "speed-loop": {
        "proportional_gain_nms_per_rad": "proportional_gain", "integral_time_s": "integral_time",
        "current_lag_s": "current_lag", "sampling_time_s": "sampling_time",
    },
    "friction-at-guides": _FORCE,
    "friction-at-nut": _TORQUE,
    "friction-at-bearing": _TORQUE,
    "friction-at-far-bearing": _TORQUE,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class StatedSimulation:
    """What a session of a drive has besides its model."""

    recording: Mapping[str, float] = field(default_factory=dict)  # of SimulationSettings, by its names
    friction: DriveFriction = SMOOTH
    control: SpeedControl | None = None


def stated_simulation(tables: Mapping[str, Mapping[str, float]]) -> StatedSimulation:
    """Return what the tables state; ``OutsideValidityError`` if one, or an entry, is unknown, missing or impossible."""
    named = {table: _named(table, values) for table, values in tables.items()}
    rubs = {
        table.removeprefix("friction-at-").replace("-", "_"): StribeckFriction(**{"static": values["coulomb"]} | values)
        for table, values in named.items()
        if table.startswith("friction-at-")
    }
    loop = named.get("speed-loop")
    return StatedSimulation(
        named.get("recording", {}), DriveFriction(**rubs), None if loop is None else SpeedControl(**loop)
    )


def _named(table: str, values: Mapping[str, float]) -> dict[str, float]:
    if table not in TABLES:
        raise OutsideValidityError(f"the tables of a simulation are {', '.join(TABLES)}; got {table!r}")
    known = TABLES[table]
    unknown = [name for name in values if name not in known]
    needed = {"speed-loop": set(known), "recording": set()}.get(table, {next(iter(known))})
    missing = sorted(needed - set(values))
    if unknown or missing:
        got = f"got {unknown[0]}" if unknown else f"without {missing[0]}"
        raise OutsideValidityError(f"{table} has the entries {', '.join(known)}; {got}")
    return {known[name]: value for name, value in values.items()}
