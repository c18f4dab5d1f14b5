"""The axis in finite elements: its screw in tension and torsion, its bodies, joints and dampers, and what is hidden.

Degrees of freedom: axial nodes, torsional nodes, table, rotor, and base and absorber where there are any. A node of the
mesh lies under the nut. Every mechanism is built as such: springs with loss are chains of Maxwell elements, absorber
and base are bodies, friction and a nut that is not linear are forces in time.
"""

import math
from collections.abc import Sequence

import numpy as np

from tests.hidden_effects.truth.axis import Axis, Hidden, Parts, Setting
from tests.hidden_effects.truth.oscillators import Oscillators, decouple, steady_motion
from tests.hidden_effects.truth.oscillators_stepped import FedBack, stepped_motion
from tests.hidden_effects.truth.reduction import Joint, NutPath, Structure
from tests.hidden_effects.truth.reduction_states import state_space

#: Length to which the two that follow belong; on a screw that is longer or shorter they go with it. [m]
SCREW_LENGTH = 0.971
#: With it the third mode is within 0.02 %. [m]
ELEMENT_LENGTH = 0.016
#: Of a nut that something hangs on, over what hangs there: hardly anything, but its degree of freedom needs some. [-]
LEAST_NUT_MASS = 1e-2
#: The steel of the screw loses a little by itself, as Kelvin and Voigt have it: a loss factor of 0.002 at 500 Hz. No
#: description of a drive holds it; it is why no model of one agrees to the last digit. [s]
SCREW_LOSS_TIME = 2e-3 / (2.0 * math.pi * 500.0)


def respond(
    axis: Axis, settings: Sequence[Setting], torque: np.ndarray, sample_rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return acceleration of the table and angle of the rotor under torques on the rotor.

    Parameters
    ----------
    axis : Axis
    settings : sequence of Setting
    torque : ndarray, shape (n_settings, n_samples)
        As recorded, band-limited. A linear axis answers as if it repeated for ever, one that is not starts from rest:
        leave out the first second or two. [N·m]
    sample_rate : float
        [Hz]

    Returns
    -------
    acceleration, angle : ndarray, shape (n_settings, n_samples)
        [m/s²], [rad]
    """
    hidden = axis.hidden
    if hidden.constant_loss_factor:
        raise ValueError("no motion in time has a loss factor without stiffening; take the wave lines")
    plants = [plant(axis, setting) for setting in settings]
    torque = np.clip(torque, -hidden.torque_limit, hidden.torque_limit)
    fed_back = FedBack(
        hidden.guide_friction,
        np.array([nut_stiffness(axis, setting) for setting in settings]),
        hidden.cubic_nut_stiffness,
        hidden.nut_softening,
        hidden.nut_softening_deflection,
        hidden.nut_backlash,
        hidden.nut_contact_loss,
        hidden.nut_contact_deflection,
    )
    if fed_back.acts:
        motion = stepped_motion(plants, torque, sample_rate, hidden.torque_delay, fed_back)
    else:
        motion = steady_motion(plants, torque, sample_rate, hidden.torque_delay, 2)
    return late(motion[0], hidden.response_delay, sample_rate), late(motion[1], hidden.angle_delay, sample_rate)


def late(channel: np.ndarray, delay: float, sample_rate: float) -> np.ndarray:
    """Return a band-limited record that goes on for ever as it is recorded later."""
    if not delay:
        return channel
    spectrum = np.fft.rfft(channel, axis=1)
    spectrum *= np.exp(-2j * math.pi * delay * np.fft.rfftfreq(channel.shape[1], 1.0 / sample_rate))
    return np.fft.irfft(spectrum, channel.shape[1], axis=1)


def plant(axis: Axis, setting: Setting) -> Oscillators:
    """Return the linear plant: inputs torque, force on the table, excess force in the nut.

    Its outputs are the accelerometer at the table [m/s²], the angle of the rotor [rad], the velocity of the table [m/s]
    and the deflection of the nut [m].
    """
    return decouple(state_space(assemble(axis, setting), axis.hidden, transmission(axis.parts)))


def transmission(parts: Parts) -> float:
    """Return the travel per angle. [m/rad]."""
    return parts.screw_lead / (2.0 * math.pi)


def nut_stiffness(axis: Axis, setting: Setting) -> float:
    """Return the stiffness of the nut under the preload that it really has. [N/m]."""
    parts, hidden = axis.parts_at(setting), axis.hidden
    turn = 2.0 * math.pi * setting.position / parts.screw_lead - hidden.periodic_phase
    preload = setting.preload + hidden.thermal_preload * setting.temperature_deviation
    preload *= (1.0 + hidden.periodic_preload * math.cos(turn)) * (1.0 - hidden.preload_drift * setting.order)
    preload *= axis.worn(setting)
    exponent = 1.0 / 3.0 + hidden.preload_exponent_change
    return float(0.8 * parts.nut_rigidity * (preload / parts.rated_preload) ** exponent)


def assemble(axis: Axis, setting: Setting, element_length: float | None = None) -> Structure:
    """Return the matrices of the axis as it is set."""
    parts, hidden = axis.parts_at(setting), axis.hidden
    x = setting.position + hidden.position_offset
    element_length = element_length or ELEMENT_LENGTH * parts.screw_length / SCREW_LENGTH
    near, far = (max(4, math.ceil(length / element_length)) for length in (x, parts.screw_length - x))
    nodes = np.r_[np.linspace(0.0, x, near + 1), np.linspace(x, parts.screw_length, far + 1)[1:]]
    n = nodes.size
    has_base = hidden.base_compliance > 0.0
    on_nut = max(hidden.nut_mass_before_bracket, LEAST_NUT_MASS * hidden.nut_absorber_mass)
    bending = axis.bending(x)
    bodies = _bodies(axis, setting, on_nut) | {f"bending_{number}": mode.mass for number, mode in enumerate(bending)}
    size = 2 * n + len(bodies)

    def along(**factors: float) -> np.ndarray:
        places = {"near_end": 0, "far_end": n - 1, "driven_end": n, "nut": near, "nut_turn": n + near}
        places |= {name: 2 * n + index for index, name in enumerate(bodies)}
        vector = np.zeros(size)
        for name, factor in factors.items():
            vector[places[name]] = factor
        return vector

    mass, screw, damping = _screw(parts, hidden, nodes, size)
    stiffness = np.zeros((size, size))
    grounded: list[tuple[np.ndarray, float, float]] = [  # direction, stiffness, damping
        (along(table=1.0), hidden.guide_stiffness, parts.table_damping),
        (along(rotor=1.0), hidden.servo_stiffness, parts.motor_damping + hidden.motor_damping),
    ]
    if has_base:
        omega, spring = 2.0 * math.pi * hidden.base_frequency, 1.0 / hidden.base_compliance
        grounded.append((along(base=1.0), spring, 2.0 * hidden.base_damping_ratio * spring / omega))
    for place, name, mass_of, frequency, ratio in (
        ("table", "absorber", hidden.absorber_mass, hidden.absorber_frequency, hidden.absorber_damping_ratio),
        ("nut_body", "nut_absorber", hidden.nut_absorber_mass, hidden.nut_absorber_frequency,
         hidden.nut_absorber_damping_ratio),
        ("rotor", "rotor_absorber", hidden.rotor_absorber_inertia, hidden.rotor_absorber_frequency,
         hidden.rotor_absorber_damping_ratio),
        ("far_end", "screw_end_absorber", hidden.screw_end_absorber_mass, hidden.screw_end_absorber_frequency,
         hidden.screw_end_absorber_damping_ratio),
    ):  # fmt: skip
        if mass_of:
            wander = hidden.absorber_frequency_slope * (x - 0.5 * parts.screw_length) if place == "table" else 0.0
            omega = 2.0 * math.pi * frequency * (1.0 + wander)
            stretch = along(**{name: 1.0, place: -1.0})
            grounded.append((stretch, mass_of * omega**2, 2.0 * ratio * mass_of * omega))

    for number, mode in enumerate(bending):
        damper = 2.0 * mode.damping_ratio * mode.mass * mode.omega
        grounded.append((along(**{f"bending_{number}": 1.0}), mode.mass * mode.omega**2, damper))

    on_base = {"base": -1.0} if has_base else {}
    far_bearing = parts.far_bearing_stiffness + hidden.far_bearing_stiffness
    held = [
        (along(near_end=1.0, **on_base), parts.bearing_stiffness, parts.bearing_damping),
        (along(far_end=1.0, **on_base), far_bearing, parts.far_bearing_damping),
        (along(rotor=1.0 / hidden.belt_ratio, driven_end=-1.0), parts.coupling_stiffness, parts.coupling_damping),
    ]
    bracket = 1.0 / (1.0 / parts.bracket_stiffness + hidden.series_compliance)
    carrier = "table"
    if on_nut:
        carrier = "nut_body"
        held.append((along(table=1.0, nut_body=-1.0), bracket, 0.0))
        bracket = math.inf
    for index, amount in enumerate(bodies.values()):
        mass[2 * n + index, 2 * n + index] += amount
    for direction, spring, damper in grounded:
        stiffness += spring * np.outer(direction, direction)
        damping += damper * np.outer(direction, direction)
    for direction, _, damper in held:
        damping += damper * np.outer(direction, direction)
    return Structure(
        mass,
        screw,
        stiffness,
        damping,
        tuple(Joint(direction, spring) for direction, spring, _ in held if spring),
        NutPath(
            along(
                **{carrier: 1.0, "nut": -1.0, "nut_turn": -transmission(parts)},
                **{f"bending_{number}": -mode.at_nut for number, mode in enumerate(bending)},
            ),
            bracket,
            nut_stiffness(axis, setting),
            parts.nut_damping,
        ),
        along(table=1.0),
        along(rotor=1.0),
    )


def _bodies(axis: Axis, setting: Setting, on_nut: float) -> dict[str, float]:
    """Return masses and inertia beside the screw."""
    parts, hidden = axis.parts, axis.hidden
    bodies = {"table": _moving_mass(axis, setting) - on_nut, "rotor": parts.motor_inertia + parts.coupling_inertia}
    if hidden.base_compliance:
        bodies["base"] = 1.0 / hidden.base_compliance / (2.0 * math.pi * hidden.base_frequency) ** 2
    if on_nut:
        bodies["nut_body"] = on_nut
    if hidden.absorber_mass:
        bodies["absorber"] = hidden.absorber_mass
    if hidden.nut_absorber_mass:
        bodies["nut_absorber"] = hidden.nut_absorber_mass
    if hidden.rotor_absorber_inertia:
        bodies["rotor_absorber"] = hidden.rotor_absorber_inertia
    if hidden.screw_end_absorber_mass:
        bodies["screw_end_absorber"] = hidden.screw_end_absorber_mass
    return bodies


def _moving_mass(axis: Axis, setting: Setting) -> float:
    wrong = axis.hidden.payload_error if setting.payload else 0.0
    more = wrong + axis.hidden.added_mass - axis.lost(setting)
    return axis.parts.table_mass + axis.parts.nut_mass + setting.payload + more


def _screw(parts: Parts, hidden: Hidden, nodes: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mass, stiffness and damping of the free screw: linear shape functions, consistent masses."""
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    area, polar = math.pi / 4.0 * parts.screw_diameter**2, math.pi / 32.0 * parts.screw_diameter**4
    tension = parts.youngs_modulus * area * hidden.axial_modulus_factor
    torsion = parts.shear_modulus * polar / (1.0 + hidden.torsional_compliance_share)
    for offset, rigidity, inertia in (
        (0, tension, parts.density * area),
        (nodes.size, torsion, parts.density * polar),
    ):
        for e, h in enumerate(np.diff(nodes)):
            place = slice(offset + e, offset + e + 2)
            stiffness[place, place] += rigidity / h * np.array([[1.0, -1.0], [-1.0, 1.0]])
            mass[place, place] += inertia * h / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
    # a loss that is hidden is all that the screw loses, by a law of its own
    loss_time = 0.0 if hidden.screw_loss_factor else SCREW_LOSS_TIME * parts.screw_length / SCREW_LENGTH
    return mass, stiffness, loss_time * stiffness
