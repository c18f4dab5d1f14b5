"""An axis that is warmer than the reference."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics

#: Relative change of the modulus of steel per kelvin near room temperature: tables go from −2.7e-4 (chromium steel
#: AISI 430, 232 to 227 GPa from 20 to 100 °C) to −3.3e-4 (carbon steel, ASME B31.3, Table C-6: 202.0 to 197.2 GPa from
#: 21 to 93 °C). [1/K]
MODULUS_PER_KELVIN = -2.9e-4


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    factor = 1.0 + MODULUS_PER_KELVIN * values["temperature_k"]
    if not factor > 0.0:
        raise OutsideValidityError(f"steel must keep some stiffness; got {values['temperature_k']:g} K of warming")
    screw, joints = axis.screw, axis.joints
    return replace(
        axis,
        screw=replace(
            screw,
            axial_rigidity=factor * screw.axial_rigidity,
            torsional_rigidity=factor * screw.torsional_rigidity,
        ),
        joints=replace(
            joints,
            bearing_stiffness=factor * joints.bearing_stiffness,
            far_bearing_stiffness=factor * joints.far_bearing_stiffness,
            nut_stiffness=factor * joints.nut_stiffness,
            bracket_stiffness=factor * joints.bracket_stiffness,
            coupling_stiffness=factor * joints.coupling_stiffness,
        ),
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
    add=_add,
)
