"""A machine about its description, measured for a reference, and measured again after one thing has changed.

The truth is the finite-element plant in time, with friction, servo, sensors and acquisition; a change is made in the
plant and never by a formula of the product: other parts, another condition, a table that stands elsewhere than is
tagged, a channel that is read late. What the product sees of it are windows, and what its own road makes of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.measured_responses import measured_responses
from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from tests.plant.chain import Axis, Condition
from tests.plant.measurements import INTERNAL_RATE, LEAD_IN, Acquisition, Recorded, Scatter, to_windows
from tests.plant.motion import draw_reference
from tests.plant.sensors import ACCELERATION, ENCODER, TORQUE, anti_alias, convert, filter_margin
from tests.plant.simulation import Plant, simulate

FloatArray = NDArray[np.float64]

PRELOAD = 300.0  # of the reference [N]
POSITIONS = (0.12, 0.24, 0.36, 0.48, 0.60, 0.72, 0.84)  # [m]
BAND = (20.0, 440.0)  # in which responses are taken [Hz]

#: Relative standard deviations that the description declares, and that true parts are drawn with.
TOLERANCES = {
    "table_mass": 0.005,
    "bearing_stiffness": 0.2,
    "far_bearing_stiffness": 0.2,
    "bracket_stiffness": 0.2,
    "nut_rigidity": 0.1,
    "joint_loss_factor": 0.2,
}


@dataclass(frozen=True, slots=True)
class Happened:
    """What has become of an axis since its reference."""

    preload_share: float = 1.0  # of the preload that is left [-]
    payload: float = 0.0  # that nobody tagged [kg]
    bearing_share: float = 1.0  # of the fixed bearing's stiffness that is left [-]
    far_bearing_share: float = 1.0  # likewise of the far one [-]
    offset: float = 0.0  # true position less the tagged one [m]
    delay: float = 0.0  # by which the acceleration is read late [s]
    warming: float = 0.0  # that nobody tagged [K]
    bracket_share: float = 1.0  # of the stiffness between nut and table that is left; in no catalogue of changes [-]
    friction: float = 1.0  # times what it was; likewise [-]

    def axis(self, axis: Axis) -> Axis:
        """Return the axis with its parts as they are now."""
        return replace(
            axis,
            bearing_stiffness=self.bearing_share * axis.bearing_stiffness,
            far_bearing_stiffness=self.far_bearing_share * axis.far_bearing_stiffness,
            bracket_stiffness=self.bracket_share * axis.bracket_stiffness,
        )

    def true(self, tagged: Condition) -> Condition:
        """Return the condition behind a tagged one."""
        return replace(
            tagged,
            position=tagged.position + self.offset,
            preload=self.preload_share * tagged.preload,
            payload=tagged.payload + self.payload,
            temperature=tagged.temperature + self.warming,
            friction_scale=self.friction * tagged.friction_scale,
        )


#: By the cause that is to be named.
HAPPENINGS = {
    "none": Happened(),
    "preload": Happened(preload_share=0.75),
    "payload": Happened(payload=2.0),
    "bearing": Happened(bearing_share=0.6),
    "position": Happened(offset=10e-3),
    "sensor": Happened(delay=0.2e-3),
    "temperature": Happened(warming=15.0),
}
#: What no hypothesis of the product has.
OUTSIDE = {"bracket": Happened(bracket_share=0.8), "friction": Happened(friction=2.5)}


def drawn_axis(rng: np.random.Generator) -> Axis:
    """Return a machine about the described one."""
    nominal = Axis()
    true = {
        part: getattr(nominal, part) * math.exp(tolerance * rng.standard_normal())
        for part, tolerance in TOLERANCES.items()
    }
    return replace(nominal, **true)


def description() -> str:
    """Return the model file of the described machine: its screw as a rod of equal mass, inertia and stiffnesses."""
    axis = Axis()
    length = axis.screw_length
    diameter = math.sqrt(8.0 * axis.screw_inertia / axis.screw_mass)
    area_ratio = (axis.screw_minor_diameter / diameter) ** 2
    stated = {
        "table_mass_kg": axis.table_mass,
        "nut_mass_kg": axis.nut_mass,
        "screw_length_m": length,
        "screw_diameter_m": diameter,
        "screw_lead_m": axis.lead,
        "youngs_modulus_pa": axis.youngs_modulus * area_ratio,
        "shear_modulus_pa": axis.shear_modulus * area_ratio**2,
        "density_kg_per_m3": axis.screw_mass / (length * math.pi / 4.0 * diameter**2),
        "motor_inertia_kg_m2": axis.motor_inertia,
        "screw_motor_segment_inertia_kg_m2": axis.coupling_inertia,
        "bearing_stiffness_n_per_m": axis.bearing_stiffness,
        "far_bearing_stiffness_n_per_m": axis.far_bearing_stiffness,
        "bracket_stiffness_n_per_m": axis.bracket_stiffness,
        "nut_stiffness_n_per_m": axis.nut_rigidity,
        "dynamic_load_rating_n": 10.0 * axis.rated_preload,
        "coupling_stiffness_nm_per_rad": axis.coupling_stiffness,
        "loss_factor": axis.joint_loss_factor,
        "table_damping_ns_per_m": 20.0,
    }
    uncertain = {
        "table_mass_kg": TOLERANCES["table_mass"],
        "bearing_stiffness_n_per_m": TOLERANCES["bearing_stiffness"],
        "far_bearing_stiffness_n_per_m": TOLERANCES["far_bearing_stiffness"],
        "bracket_stiffness_n_per_m": TOLERANCES["bracket_stiffness"],
        "nut_stiffness_n_per_m": TOLERANCES["nut_rigidity"],
        "loss_factor": 0.3,
        "table_damping_ns_per_m": 0.5,
        "youngs_modulus_pa": 0.01,
        "shear_modulus_pa": 0.01,
    }
    lines = ['family = "receptance"', "", "[parameters]", *(f"{name} = {value!r}" for name, value in stated.items())]
    lines += ["", "[uncertain]", *(f"{name} = {value!r}" for name, value in uncertain.items())]
    return "\n".join(lines) + "\n"


def measured(
    axis: Axis,
    happened: Happened,
    rng: np.random.Generator,
    *,
    positions: Sequence[float] = POSITIONS,
    days: int = 3,
) -> tuple[FrequencyResponseObservation, ...]:
    """Measure an axis at each position on some days and return its responses, as the product's own road sees them."""
    tagged = [Condition(x, preload=PRELOAD) for _ in range(days) for x in positions]
    acquisition = Acquisition()
    recorded = _recorded(Plant(axis=happened.axis(axis)), tagged, happened, acquisition, rng)
    starts = [datetime(2026, 1, 1, 6, tzinfo=UTC) + timedelta(hours=index) for index in range(len(tagged))]
    windows = to_windows(recorded, tagged, starts, acquisition, preload_known=True)
    n = acquisition.n_windows
    modes = [measure_mode(windows[n * i : n * (i + 1)], band=BAND, gate=ModeGate()) for i in range(len(tagged))]
    return measured_responses(mode for mode in modes if isinstance(mode, ModalMeasurement))


def _recorded(
    plant: Plant, tagged: Sequence[Condition], happened: Happened, acquisition: Acquisition, rng: np.random.Generator
) -> Recorded:
    """Record as the plant's own measurements do, with the acceleration read late."""
    scatter = Scatter()
    true = [scatter.draw(happened.true(conditions), rng) for conditions in tagged]
    factor = INTERNAL_RATE // acquisition.sample_rate
    margin, lead_in = filter_margin(factor), round(LEAD_IN * INTERNAL_RATE)
    n_window = round(acquisition.duration * INTERNAL_RATE)
    time = (np.arange(lead_in + n_window + margin) - lead_in) / INTERNAL_RATE
    reference = draw_reference(acquisition.program, rng, (len(true), acquisition.n_windows), time, acquisition.duration)
    motion = simulate(plant, true, reference, 1.0 / INTERNAL_RATE)
    acceleration = motion.nut_acceleration
    if happened.delay:
        acceleration = CubicSpline(time, acceleration)(np.maximum(time - happened.delay, time[0]))
    tags = np.array([conditions.position for conditions in tagged])[:, None]
    channels = []
    for channel, sensor in (
        (motion.sensor_torque, TORQUE),
        (acceleration, ACCELERATION),
        (motion.motor_travel + tags, ENCODER),
    ):
        samples = anti_alias(channel[lead_in - margin :], factor)
        channels.append(convert(np.ascontiguousarray(np.moveaxis(samples, 0, -1)), sensor, rng))
    return Recorded(*channels)
