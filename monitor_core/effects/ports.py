r"""Dynamics of their own at a port of the drive that no effect of the catalogue has: behind the rotor, and elsewhere.

Whatever hangs on a port and needs no power pushes back with a positive-real impedance. The simplest that resonates is a
mass m on a spring and a damper,

.. math::

    Z(\omega) = -\omega^2 m \frac{1 + 2j\zeta r}{1 - r^2 + 2j\zeta r}, \qquad r = \frac{\omega}{\omega_a}

positive real with any values that are not negative (Brune, J. Math. Phys. 10 (1931) 191). The catalogue has it on the
table and on the nut; these have it on the rotor, where an inertia turns, at the far end of the screw, along it, and as
a bed under both bearings that swings faster than beds do. A screw that bends is what yields between the force in the
nut and the screw (:mod:`monitor_core.models.extended.bending`). They name no part of a machine: an answer that says one
says where something swings, how much of it, and at which frequency.
"""

from enum import StrEnum

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, lacking, setting
from monitor_core.effects.sizes import Reference
from monitor_core.models.extended import AxisPhysics


class Port(StrEnum):
    """Where something may hang that no effect of the catalogue has, by its name in files."""

    ROTOR = "rotor"
    SCREW_END = "screw-end"
    BASE = "base"
    SCREW = "screw"


_SOURCE = "Den Hartog, Mechanical Vibrations, section 3.2: the auxiliary mass"
_FREQUENCY = EffectParameter(
    "frequency_hz", "Hz", lower=0.025, upper=25.0, scale=0.25, null=1.5, reference=Reference.FREQUENCY
)
_RATIO = EffectParameter("damping_ratio", "-", lower=0.0, upper=0.5, scale=0.02, null=0.02)
_FROM = frozenset({ConditionAxis.FREQUENCY})

_AT_PORT: dict[Port, Effect[AxisPhysics]] = {
    Port.ROTOR: Effect(
        key="at-port:rotor",
        name="Something that swings on the rotor",
        physics=(
            "A disc of a brake, an encoder or a wheel turns behind a spring and a damper of its own. At its own "
            "frequency it holds the rotor nearly still."
        ),
        source=_SOURCE,
        parameters=(
            EffectParameter(
                "inertia_kg_m2", "kg·m²", lower=0.0, upper=1.0, scale=0.01, reference=Reference.TURNING_INERTIA
            ),
            _FREQUENCY,
            _RATIO,
        ),
        add=setting(
            "added",
            rotor_absorber_inertia="inertia_kg_m2",
            rotor_absorber_frequency="frequency_hz",
            rotor_absorber_damping_ratio="damping_ratio",
        ),
        needs=_FROM,
        applies=lacking("added", "rotor_absorber_inertia"),
    ),
    Port.SCREW_END: Effect(
        key="at-port:screw_end",
        name="Something that swings at the far end of the screw",
        physics=(
            "A mass moves along the screw behind a spring and a damper at its far end, as a support, a seal or a "
            "cover there does. At its own frequency it holds the end nearly still."
        ),
        source=_SOURCE,
        parameters=(
            EffectParameter("mass_kg", "kg", lower=0.0, upper=1.0, scale=0.01, reference=Reference.MOVING_MASS),
            _FREQUENCY,
            _RATIO,
        ),
        add=setting(
            "added",
            screw_end_absorber_mass="mass_kg",
            screw_end_absorber_frequency="frequency_hz",
            screw_end_absorber_damping_ratio="damping_ratio",
        ),
        needs=_FROM,
        applies=lacking("added", "screw_end_absorber_mass"),
    ),
    Port.BASE: Effect(
        key="at-port:base",
        name="Something that swings under the bearings",
        physics=(
            "What holds the bearings is a mass on a spring, which the reaction of both pushes, at any frequency: a "
            "housing or a console, where a bed would swing below the drive."
        ),
        source=_SOURCE,
        parameters=(
            EffectParameter(
                "compliance_m_per_n", "m/N", lower=0.0, upper=3.75, scale=0.0375, reference=Reference.AXIAL_COMPLIANCE
            ),
            _FREQUENCY,
            _RATIO,
        ),
        add=setting(
            "added",
            base_compliance="compliance_m_per_n",
            base_frequency="frequency_hz",
            base_damping_ratio="damping_ratio",
        ),
        needs=_FROM,
        applies=lacking("added", "base_compliance"),
    ),
    Port.SCREW: Effect(
        key="at-port:screw",
        name="A screw that bends",
        physics=(
            "The nut pulls out of line and bends the screw between its supports: the nut gives way along it, most at "
            "the natural frequencies of the bent screw, and otherwise at every position."
        ),
        source="Blevins, Formulas for Natural Frequency and Mode Shape, table 8-1: a beam between two supports",
        parameters=(
            EffectParameter(
                "compliance_m_per_n", "m/N", lower=0.0, upper=10.0, scale=0.0375, reference=Reference.AXIAL_COMPLIANCE
            ),
            # of a screw whose ends may turn, and up to one whose ends may not
            EffectParameter(
                "frequency_hz", "Hz", lower=0.8, upper=2.4, scale=0.1, null=1.0, reference=Reference.BENDING_FREQUENCY
            ),
            EffectParameter("damping_ratio", "-", lower=0.0, upper=0.1, scale=0.01, null=0.01),
            *(
                EffectParameter(f"share_{n}", "-", lower=0.0, upper=2.0, scale=0.3 / n**2, null=1.0 / n**2)
                for n in range(2, 6)
            ),
        ),
        add=setting(
            "bending",
            compliance="compliance_m_per_n",
            frequency="frequency_hz",
            damping_ratio="damping_ratio",
            share_2="share_2",
            share_3="share_3",
            share_4="share_4",
            share_5="share_5",
        ),
        needs=_FROM,
        applies=lacking("bending", "compliance"),
    ),
}

PORT_EFFECTS: tuple[Effect[AxisPhysics], ...] = tuple(_AT_PORT.values())


def at_port(port: str) -> Effect[AxisPhysics]:
    """Return the effect by which something hangs on a port.

    >>> from monitor_core.effects import at_port
    >>> at_port("rotor").key
    'at-port:rotor'
    """
    return _AT_PORT[Port(port)]


def port_of(effect: Effect[AxisPhysics]) -> Port | None:
    """Return on which port something hangs by an effect; None where that is no such effect."""
    return next((port for port, known in _AT_PORT.items() if known.key == effect.key), None)
