"""Modes besides those of the drive: of the base, and of what stands on the table."""

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, lacking, setting
from monitor_core.effects.sizes import Reference

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
