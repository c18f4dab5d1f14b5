"""Modes besides those of the drive: of the base, of what stands on the table, of what hangs on table or nut."""

import math

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, lacking, setting
from monitor_core.effects.sizes import Reference
from monitor_core.models.extended import AxisPhysics

BASE_COMPLIANCE = Effect(
    key="base-compliance",
    name="Compliance of the base",
    physics=(
        "Bed or foundation is a mass on a spring, which the reaction of the bearings pushes: one more resonance, "
        "whose frequency does not depend on the position of the table."
    ),
    source="no source: a mass on a spring",
    parameters=(
        EffectParameter(
            "compliance_m_per_n", "m/N", lower=0.0, upper=3.75, scale=0.0375, reference=Reference.AXIAL_COMPLIANCE
        ),
        # beds rock on their mounts and bend as a whole below the drive; what resonates above is a part, and moves with
        # one
        EffectParameter(
            "frequency_hz", "Hz", lower=0.025, upper=0.95, scale=0.1, null=0.3, reference=Reference.FREQUENCY
        ),
        EffectParameter("damping_ratio", "-", lower=0.0, upper=0.3, scale=0.02, null=0.02),
    ),
    add=setting(
        "added",
        base_compliance="compliance_m_per_n",
        base_frequency="frequency_hz",
        base_damping_ratio="damping_ratio",
    ),
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "base_compliance"),
)


SECOND_MODE = Effect(
    key="second-mode",
    name="One more mode at the table",
    physics=(
        "Something on the table or in its structure resonates by itself and adds one modal term, driven and seen "
        "at the table, at a frequency that nothing of the drive moves."
    ),
    source="Ewins, Modal Testing, chapter 2: one term of the modal sum",
    parameters=(
        EffectParameter("residue_per_kg", "1/kg", lower=0.0, upper=22.0, scale=0.022, reference=Reference.INVERSE_MASS),
        EffectParameter(
            "frequency_hz", "Hz", lower=0.025, upper=25.0, scale=0.25, null=1.5, reference=Reference.FREQUENCY
        ),
        EffectParameter("damping_ratio", "-", lower=0.0, upper=0.3, scale=0.02, null=0.02),
    ),
    add=setting(
        "added",
        second_mode_residue="residue_per_kg",
        second_mode_frequency="frequency_hz",
        second_mode_damping_ratio="damping_ratio",
    ),
    form_share=0.08,
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "second_mode_residue"),
)

#: At most half of what moves, and seen from a few per mille of it on.
_ABSORBER = (
    EffectParameter("mass_kg", "kg", lower=0.0, upper=0.5, scale=0.005, reference=Reference.MOVING_MASS),
    EffectParameter("frequency_hz", "Hz", lower=0.025, upper=25.0, scale=0.25, null=1.5, reference=Reference.FREQUENCY),
    EffectParameter("damping_ratio", "-", lower=0.0, upper=0.5, scale=0.02, null=0.02),
)
_ABSORBER_SOURCE = "Den Hartog, Mechanical Vibrations, section 3.2: the auxiliary mass"

TABLE_ABSORBER = Effect(
    key="table-absorber",
    name="Something that swings on the table",
    physics=(
        "A cover, cable carrier or workpiece hangs on the table by a spring and a damper. At its own frequency, the "
        "same at every position, it holds the table nearly still; below it adds its mass, above it does nothing."
    ),
    source=_ABSORBER_SOURCE,
    parameters=_ABSORBER,
    add=setting(
        "added",
        table_absorber_mass="mass_kg",
        table_absorber_frequency="frequency_hz",
        table_absorber_damping_ratio="damping_ratio",
    ),
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "table_absorber_mass"),
)


def _may_have_nut_absorber(axis: AxisPhysics) -> bool:
    """Behind a rigid bracket the nut is the table."""
    yields = math.isfinite(axis.joints.bracket_stiffness) or axis.added.series_compliance > 0.0
    return yields and not axis.added.nut_absorber_mass


NUT_ABSORBER = Effect(
    key="nut-absorber",
    name="Something that swings on the nut",
    physics=(
        "The return tubes, a wiper or an oil line of the nut hangs on it by a spring and a damper, before the bracket. "
        "At its own frequency it holds the nut nearly still, and the table moves by what the bracket lets it."
    ),
    source=_ABSORBER_SOURCE,
    parameters=_ABSORBER,
    add=setting(
        "added",
        nut_absorber_mass="mass_kg",
        nut_absorber_frequency="frequency_hz",
        nut_absorber_damping_ratio="damping_ratio",
    ),
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=_may_have_nut_absorber,
)
