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

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter as P, lacking, resonating, setting
from monitor_core.effects.sizes import Reference
from monitor_core.models.extended import AxisPhysics


class Port(StrEnum):
    """Where something may hang that no effect of the catalogue has, by its name in files."""

    ROTOR = "rotor"
    SCREW_END = "screw-end"
    BASE = "base"
    SCREW = "screw"


_SOURCE = "Den Hartog, Mechanical Vibrations, section 3.2: the auxiliary mass"
_FREQUENCY = P("frequency_hz", "Hz", 0.025, 25.0, 0.25, null=1.5, reference=Reference.FREQUENCY)
_RATIO = P("damping_ratio", "-", 0.0, 0.5, 0.02, null=0.02)
_FROM = frozenset({ConditionAxis.FREQUENCY})

_AT_PORT: dict[Port, Effect[AxisPhysics]] = {
    Port.ROTOR: Effect(
        "at-port:rotor",
        "Something that swings on the rotor",
        "A disc of a brake, an encoder or a wheel turns behind a spring and a damper of its own. At its own frequency "
        "it holds the rotor nearly still.",
        _SOURCE,
        (P("inertia_kg_m2", "kg·m²", 0.0, 1.0, 0.01, reference=Reference.TURNING_INERTIA), _FREQUENCY, _RATIO),
        resonating("rotor_absorber_inertia", by="inertia_kg_m2"),
        needs=_FROM,
        applies=lacking("added", "rotor_absorber_inertia"),
    ),
    Port.SCREW_END: Effect(
        "at-port:screw_end",
        "Something that swings at the far end of the screw",
        "A mass moves along the screw behind a spring and a damper at its far end, as a support, a seal or a cover "
        "there does. At its own frequency it holds the end nearly still.",
        _SOURCE,
        (P("mass_kg", "kg", 0.0, 1.0, 0.01, reference=Reference.MOVING_MASS), _FREQUENCY, _RATIO),
        resonating("screw_end_absorber_mass", by="mass_kg"),
        needs=_FROM,
        applies=lacking("added", "screw_end_absorber_mass"),
    ),
    Port.BASE: Effect(
        "at-port:base",
        "Something that swings under the bearings",
        "What holds the bearings is a mass on a spring, which the reaction of both pushes, at any frequency: a housing "
        "or a console, where a bed would swing below the drive.",
        _SOURCE,
        (
            P("compliance_m_per_n", "m/N", 0.0, 3.75, 0.0375, reference=Reference.AXIAL_COMPLIANCE),
            _FREQUENCY,
            _RATIO,
        ),
        resonating("base_compliance", by="compliance_m_per_n"),
        needs=_FROM,
        applies=lacking("added", "base_compliance"),
    ),
    Port.SCREW: Effect(
        "at-port:screw",
        "A screw that bends",
        "The nut pulls out of line and bends the screw between its supports: the nut gives way along it, most at the "
        "natural frequencies of the bent screw, and otherwise at every position.",
        "Blevins, Formulas for Natural Frequency and Mode Shape, table 8-1: a beam between two supports",
        (
            P("compliance_m_per_n", "m/N", 0.0, 10.0, 0.0375, reference=Reference.AXIAL_COMPLIANCE),
            # of a screw whose ends may turn, and up to one whose ends may not
            P("frequency_hz", "Hz", 0.8, 2.4, 0.1, null=1.0, reference=Reference.BENDING_FREQUENCY),
            P("damping_ratio", "-", 0.0, 0.1, 0.01, null=0.01),
            *(P(f"share_{n}", "-", 0.0, 2.0, 0.3 / n**2, null=1.0 / n**2) for n in range(2, 6)),
        ),
        setting(
            "bending",
            compliance="compliance_m_per_n",
            frequency="frequency_hz",
            damping_ratio="damping_ratio",
            **{f"share_{n}": f"share_{n}" for n in range(2, 6)},
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
    return next((port for port, hanging in _AT_PORT.items() if hanging.key == effect.key), None)
