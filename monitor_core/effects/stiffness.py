"""Springs of the force path that a model lacks, or has at another stiffness."""

from collections.abc import Mapping

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, changed, having, increasing, scaling
from monitor_core.effects.sizes import Reference
from monitor_core.models.extended import AxisPhysics

SERIES_COMPLIANCE = Effect(
    key="series-compliance",
    name="Compliance in series",
    physics=(
        "Pedestal, bolted joints and table yield in series with nut and bracket, the same at every position and "
        "preload, and with the loss factor of the joints."
    ),
    source="Nguyen et al. (2018), Eq. (4): one more term of the sum",
    parameters=(
        EffectParameter(
            "compliance_m_per_n", "m/N", lower=0.0, upper=3.75, scale=0.075, reference=Reference.AXIAL_COMPLIANCE
        ),
    ),
    add=increasing("added", series_compliance="compliance_m_per_n"),
)

FAR_BEARING_STIFFNESS = Effect(
    key="far-bearing-stiffness",
    name="Axial stiffness of the far bearing",
    physics=(
        "The far end of the screw is held as well, more stiffly than the model has it: frequencies rise, most "
        "where the table is far from the fixed bearing."
    ),
    source="Tian et al., Eq. (8)",
    parameters=(
        EffectParameter(
            "stiffness_n_per_m", "N/m", lower=0.0, upper=20.0, scale=0.3, reference=Reference.BEARING_STIFFNESS
        ),
    ),
    add=increasing("joints", far_bearing_stiffness="stiffness_n_per_m"),
)


def _add_screw_axial_stiffness(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed(axis, "screw", axial_rigidity=axis.screw.axial_rigidity * (1.0 + values["relative_change"]))


SCREW_AXIAL_STIFFNESS = Effect(
    key="screw-axial-stiffness",
    name="Axial stiffness of the screw",
    physics=(
        "Thread, bore and true diameter make E S another one, by one ratio along the screw. The frequency "
        "changes the more, the further the table is from its bearings."
    ),
    source="Nguyen et al. (2018), Eq. (2)",
    parameters=(EffectParameter("relative_change", "-", lower=-0.5, upper=0.5, scale=0.05),),
    add=_add_screw_axial_stiffness,
)

_TORSION_KEY = "torsional-flexibility"
_TORSION_NAME = "Torsional flexibility of the screw"
_TORSION_SOURCE = "Tian et al., Eq. (12); Nguyen et al. (2018), Eq. (3)"
#: In units of what the screw's own G J gives, so that one number serves a model that is rigid in torsion (1: as
#: flexible as the screw is) and one that twists already (0.1: a tenth more).
_COMPLIANCE = EffectParameter("compliance_share", "-", lower=-0.5, upper=10.0, scale=0.5)


def _add_torsion_and_inertia(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    share = axis.screw.torsional_inertia_share
    spread = share + values["inertia_share"] * (1.0 - share)
    held = axis.screw.far_end_held_share * (1.0 - values["inertia_share"])
    torsion = axis.screw.torsion_share + values["compliance_share"]
    return changed(axis, "screw", torsion_share=torsion, torsional_inertia_share=spread, far_end_held_share=held)


def _has_spread_inertia(axis: AxisPhysics) -> bool:
    return axis.screw.torsional_inertia_share == 1.0


def _has_lumped_inertia(axis: AxisPhysics) -> bool:
    return axis.screw.torsional_inertia_share < 1.0


TORSIONAL_FLEXIBILITY = Effect(
    key=_TORSION_KEY,
    name=_TORSION_NAME,
    physics=(
        "The screw twists under the torque by more than the model's G J gives, by one ratio along it. Torsional modes "
        "move; axial ones where the table is far from the motor."
    ),
    source=_TORSION_SOURCE,
    parameters=(_COMPLIANCE,),
    add=increasing("screw", torsion_share="compliance_share"),
    applies=_has_spread_inertia,
)
TORSIONAL_FLEXIBILITY_OF_LUMPED_INERTIA = Effect(
    key=_TORSION_KEY,
    name=_TORSION_NAME,
    physics=(
        "The screw twists more than the model lets it, and a share of its inertia, which the model turns with the "
        "motor, twists with it: the drive has torsional modes. Its far end then turns freely, which some models hold."
    ),
    source=_TORSION_SOURCE,
    parameters=(_COMPLIANCE, EffectParameter("inertia_share", "-", lower=0.0, upper=1.0, scale=1.0)),
    add=_add_torsion_and_inertia,
    applies=_has_lumped_inertia,
    textbook={"compliance_share": 0.0, "inertia_share": 1.0},
)

GUIDE_STIFFNESS = Effect(
    key="guide-stiffness",
    name="Stiffness of the guides",
    physics=(
        "Guides in presliding, bellows or cables hold the table to ground, beside the drive: frequencies rise, "
        "and the drive no longer moves freely as a whole."
    ),
    source="no source: a spring in parallel with the path of the force",
    parameters=(
        EffectParameter(
            "stiffness_n_per_m", "N/m", lower=0.0, upper=27.0, scale=0.027, reference=Reference.AXIAL_STIFFNESS
        ),
    ),
    add=increasing("added", guide_stiffness="stiffness_n_per_m"),
)

SERVO_STIFFNESS = Effect(
    key="servo-stiffness",
    name="Stiffness of the servo",
    physics=(
        "The position loop answers an angle of the rotor with a torque, seen as a spring to ground. The drive no "
        "longer turns freely; seen where the rotor takes part."
    ),
    source="no source: a proportional position loop",
    parameters=(
        EffectParameter(
            "stiffness_nm_per_rad", "N·m/rad", lower=0.0, upper=200.0, scale=0.02, reference=Reference.ROTOR_STIFFNESS
        ),
    ),
    add=increasing("added", servo_stiffness="stiffness_nm_per_rad"),
)

CUBIC_STIFFNESS = Effect(
    key="cubic-stiffness",
    name="Cubic stiffness of the nut",
    physics=(
        "The force in the nut is k (1 + β δ²) δ: strong excitation finds another stiffness than weak excitation. "
        "A nut that loses contact softens, β < 0."
    ),
    source=(
        "Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5; "
        "Dykman & Krivoglaz, Phys. Status Solidi B 48 (1971) 497"
    ),
    parameters=(
        EffectParameter(
            "relative_stiffness_per_m2",
            "1/m²",
            lower=-0.5,
            upper=5.0,
            scale=5e-4,
            reference=Reference.NUT_DEFLECTION,
        ),
    ),
    add=increasing("added", cubic_nut_stiffness="relative_stiffness_per_m2"),
    # rms error of eleven simulated machines; docs/explanation/hidden-effects.md says what is known of it
    form_share=0.22,
    needs=frozenset({ConditionAxis.FREQUENCY, ConditionAxis.LEVEL}),
)

_BEARING_SOURCE = "no source: the springs at the ends of the screw, Eqs. (9) and (10) of Tian et al."
_BEARING_RATIO = EffectParameter("ln_ratio", "-", lower=-4.0, upper=2.0, scale=0.1)


BEARING_CHANGE = Effect(
    key="bearing-change",
    name="Change of the fixed bearing",
    physics="The fixed bearing has come loose or lost its preload: frequencies fall, most with the table near to it.",
    source=_BEARING_SOURCE,
    parameters=(_BEARING_RATIO,),
    add=scaling("joints", bearing_stiffness="ln_ratio"),
)

FAR_BEARING_CHANGE = Effect(
    key="far-bearing-change",
    name="Change of the far bearing",
    physics="The far bearing holds less than it did: frequencies fall, most with the table near to it.",
    source=_BEARING_SOURCE,
    parameters=(_BEARING_RATIO,),
    add=scaling("joints", far_bearing_stiffness="ln_ratio"),
    applies=having("joints", "far_bearing_stiffness"),
)
