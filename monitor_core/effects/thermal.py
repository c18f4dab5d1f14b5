"""What temperature does to preload and stiffness."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, having, increasing
from monitor_core.effects.sizes import Reference
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics

THERMAL_PRELOAD = Effect(
    key="thermal-preload",
    name="Preload that follows temperature",
    physics=(
        "Nut and screw expand differently, and the preload rises or falls in proportion to the deviation from "
        "the reference temperature."
    ),
    source="no source: linear thermal expansion",
    parameters=(
        EffectParameter("preload_n_per_k", "N/K", lower=-0.045, upper=0.045, scale=0.0045, reference=Reference.PRELOAD),
    ),
    add=increasing("added", thermal_preload="preload_n_per_k"),
    needs=frozenset({ConditionAxis.TEMPERATURE}),
    applies=having("joints", "dynamic_load_rating"),
)

THERMAL_STIFFNESS = Effect(
    key="thermal-stiffness",
    name="Springs that soften as they warm",
    physics=(
        "Steel loses stiffness as it warms, some 0.3 ‰ a kelvin, and with it the screw and every joint by the same "
        "share of the deviation from the reference temperature: all frequencies fall alike, at every position."
    ),
    source="Young's modulus of steels against temperature, ASME B31.3, Table C-6",
    parameters=(EffectParameter("relative_change_per_k", "1/K", lower=-1e-3, upper=1e-3, scale=-3e-4),),
    add=increasing("added", thermal_stiffness="relative_change_per_k"),
    needs=frozenset({ConditionAxis.TEMPERATURE}),
)


#: Relative change of the modulus of steel per kelvin near room temperature: tables go from −2.7e-4 (chromium steel
#: AISI 430, 232 to 227 GPa from 20 to 100 °C) to −3.3e-4 (carbon steel, ASME B31.3, Table C-6: 202.0 to 197.2 GPa from
#: 21 to 93 °C). [1/K]
MODULUS_PER_KELVIN = -2.9e-4


def _add_warming(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    factor = 1.0 + MODULUS_PER_KELVIN * values["temperature_k"]
    if not factor > 0.0:
        raise OutsideValidityError(f"steel must keep some stiffness; got {values['temperature_k']:g} K of warming")
    rigidities = ("axial_rigidity", "torsional_rigidity")
    springs = [f"{joint}_stiffness" for joint in ("bearing", "far_bearing", "nut", "bracket", "coupling")]
    return replace(
        axis,
        screw=replace(axis.screw, **{name: factor * getattr(axis.screw, name) for name in rigidities}),
        joints=replace(axis.joints, **{name: factor * getattr(axis.joints, name) for name in springs}),
    )


WARMING = Effect(
    key="warming",
    name="Warming",
    physics=(
        "Steel softens as it warms, and with it the screw and every joint by the same share: all frequencies fall "
        "alike, at every position."
    ),
    source="Young's modulus of steels against temperature, ASME B31.3, Table C-6, and data sheets",
    parameters=(EffectParameter("temperature_k", "K", lower=-60.0, upper=100.0, scale=5.0),),
    add=_add_warming,
)
