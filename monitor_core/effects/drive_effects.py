"""Effects that a model of a drive may lack: masses, springs, losses, preload, temperature, sensors, modes of their own.

An effect is written here and gets a line in :data:`DRIVE_EFFECTS` at the end (CONTRIBUTING.md).
Those that only a change between two times asks for are in no table.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import (
    ConditionAxis,
    Effect,
    EffectParameter as P,
    changed,
    filling,
    growing,
    having,
    increasing,
    lacking,
    resonating,
    scaling,
)
from monitor_core.effects.sizes import Reference
from monitor_core.effects.units import RESPONSE_UNIT, TORQUE_UNIT
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics

ADDED_MASS = Effect(
    "added-mass",
    "Added mass on the table",
    "A fixture, cover or cable carrier moves with the table. All frequencies fall, most where the table carries the "
    "mode; a known payload tells it from a softer path.",
    source="no source: a rigid body in translation",
    parameters=(P("mass_kg", "kg", 0.0, 9.0, 0.023, reference=Reference.MOVING_MASS),),
    add=increasing("added", table_mass="mass_kg"),
)

PAYLOAD_MASS = Effect(
    "payload-mass",
    "Wrong payload mass",
    "Wherever a payload is stated, the true one weighs more or less by one amount. Frequencies differ with the "
    "payload on the table and agree without it.",
    source="no source: a rigid body in translation",
    # what is stated cannot weigh less than nothing
    parameters=(P("mass_kg", "kg", -0.83, 8.3, 0.083, reference=Reference.PAYLOAD),),
    add=increasing("added", payload_error="mass_kg"),
    needs=frozenset({ConditionAxis.PAYLOAD}),
)


def _may_have_screw_distributed_mass(axis: AxisPhysics) -> bool:
    return axis.screw.axial_mass_share < 1.0


SCREW_DISTRIBUTED_MASS = Effect(
    "screw-distributed-mass",
    "Distributed mass of the screw",
    "A share of the screw's mass, which the model lets move with the table, is spread along the screw: the first mode "
    "rises and the screw has axial modes of its own.",
    source="Tian et al., Eq. (1)",
    parameters=(P("share", "-", 0.0, 1.0, 1.0, beyond=False),),
    add=filling("screw", axial_mass_share="share"),
    applies=_may_have_screw_distributed_mass,
    textbook={"share": 1.0},
)


def _has_a_bracket_that_yields(axis: AxisPhysics) -> bool:
    """Behind a rigid bracket the nut is the table."""
    return math.isfinite(axis.joints.bracket_stiffness) or axis.added.series_compliance > 0.0


NUT_MASS = Effect(
    "nut-mass",
    "Mass of the nut before its bracket",
    "Of the mass that the model lets move with the table a part, the nut with its housing, sits between the contacts "
    "and the bracket: it swings on the bracket by itself, and the modes of table and screw rise a little.",
    source="no source: two bodies on two springs; Tian et al. put the nut on the table",
    parameters=(P("mass_kg", "kg", 0.0, 0.5, 0.025, beyond=False, reference=Reference.MOVING_MASS),),
    add=increasing("added", nut_mass="mass_kg"),
    applies=_has_a_bracket_that_yields,
)


SERIES_COMPLIANCE = Effect(
    "series-compliance",
    "Compliance in series",
    "Pedestal, bolted joints and table yield in series with nut and bracket, the same at every position and preload, "
    "and with the loss factor of the joints.",
    source="Nguyen et al. (2018), Eq. (4): one more term of the sum",
    parameters=(P("compliance_m_per_n", "m/N", 0.0, 3.75, 0.075, reference=Reference.AXIAL_COMPLIANCE),),
    add=increasing("added", series_compliance="compliance_m_per_n"),
)

FAR_BEARING_STIFFNESS = Effect(
    "far-bearing-stiffness",
    "Axial stiffness of the far bearing",
    "The far end of the screw is held as well, more stiffly than the model has it: frequencies rise, most where the "
    "table is far from the fixed bearing.",
    source="Tian et al., Eq. (8)",
    parameters=(P("stiffness_n_per_m", "N/m", 0.0, 20.0, 0.3, reference=Reference.BEARING_STIFFNESS),),
    add=increasing("joints", far_bearing_stiffness="stiffness_n_per_m"),
)

SCREW_AXIAL_STIFFNESS = Effect(
    "screw-axial-stiffness",
    "Axial stiffness of the screw",
    "Thread, bore and true diameter make E S another one, by one ratio along the screw. The frequency changes the "
    "more, the further the table is from its bearings.",
    source="Nguyen et al. (2018), Eq. (2)",
    parameters=(P("relative_change", "-", -0.5, 0.5, 0.05),),
    add=growing("screw", axial_rigidity="relative_change"),
)

_TORSION_KEY = "torsional-flexibility"

_TORSION_NAME = "Torsional flexibility of the screw"

_TORSION_SOURCE = "Tian et al., Eq. (12); Nguyen et al. (2018), Eq. (3)"

#: In units of what the screw's own G J gives, so that one number serves a model that is rigid in torsion (1: as
#: flexible as the screw is) and one that twists already (0.1: a tenth more).
_COMPLIANCE = P("compliance_share", "-", -0.5, 10.0, 0.5)


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
    _TORSION_KEY,
    _TORSION_NAME,
    "The screw twists under the torque by more than the model's G J gives, by one ratio along it. Torsional modes "
    "move; axial ones where the table is far from the motor.",
    source=_TORSION_SOURCE,
    parameters=(_COMPLIANCE,),
    add=increasing("screw", torsion_share="compliance_share"),
    applies=_has_spread_inertia,
)

TORSIONAL_FLEXIBILITY_OF_LUMPED_INERTIA = Effect(
    _TORSION_KEY,
    _TORSION_NAME,
    "The screw twists more than the model lets it, and a share of its inertia, which the model turns with the motor, "
    "twists with it: the drive has torsional modes. Its far end then turns freely, which some models hold.",
    source=_TORSION_SOURCE,
    parameters=(
        _COMPLIANCE,
        P("inertia_share", "-", 0.0, 1.0, 1.0),
    ),
    add=_add_torsion_and_inertia,
    applies=_has_lumped_inertia,
    textbook={"compliance_share": 0.0, "inertia_share": 1.0},
)

GUIDE_STIFFNESS = Effect(
    "guide-stiffness",
    "Stiffness of the guides",
    "Guides in presliding, bellows or cables hold the table to ground, beside the drive: frequencies rise, and the "
    "drive no longer moves freely as a whole.",
    source="no source: a spring in parallel with the path of the force",
    parameters=(P("stiffness_n_per_m", "N/m", 0.0, 27.0, 0.027, reference=Reference.AXIAL_STIFFNESS),),
    add=increasing("added", guide_stiffness="stiffness_n_per_m"),
)

SERVO_STIFFNESS = Effect(
    "servo-stiffness",
    "Stiffness of the servo",
    "The position loop answers an angle of the rotor with a torque, seen as a spring to ground. The drive no longer "
    "turns freely; seen where the rotor takes part.",
    source="no source: a proportional position loop",
    parameters=(P("stiffness_nm_per_rad", "N·m/rad", 0.0, 200.0, 0.02, reference=Reference.ROTOR_STIFFNESS),),
    add=increasing("added", servo_stiffness="stiffness_nm_per_rad"),
)

CUBIC_STIFFNESS = Effect(
    "cubic-stiffness",
    "Cubic stiffness of the nut",
    "The force in the nut is k (1 + β δ²) δ: strong excitation finds another stiffness than weak excitation. A nut "
    "that loses contact softens, β < 0.",
    source="Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5; Dykman & Krivoglaz, Phys. "
    "Status Solidi B 48 (1971) 497",
    parameters=(P("relative_stiffness_per_m2", "1/m²", -0.5, 5.0, 0.0005, reference=Reference.NUT_DEFLECTION),),
    add=increasing("added", cubic_nut_stiffness="relative_stiffness_per_m2"),
    # rms error of eleven simulated machines; docs/explanation/hidden-effects.md says what is known of it
    form_share=0.22,
    needs=frozenset({ConditionAxis.FREQUENCY, ConditionAxis.LEVEL}),
)

_BEARING_SOURCE = "no source: the springs at the ends of the screw, Eqs. (9) and (10) of Tian et al."

_BEARING_RATIO = P("ln_ratio", "-", -4.0, 2.0, 0.1)

BEARING_CHANGE = Effect(
    "bearing-change",
    "Change of the fixed bearing",
    "The fixed bearing has come loose or lost its preload: frequencies fall, most with the table near to it.",
    source=_BEARING_SOURCE,
    parameters=(_BEARING_RATIO,),
    add=scaling("joints", bearing_stiffness="ln_ratio"),
)

FAR_BEARING_CHANGE = Effect(
    "far-bearing-change",
    "Change of the far bearing",
    "The far bearing holds less than it did: frequencies fall, most with the table near to it.",
    source=_BEARING_SOURCE,
    parameters=(_BEARING_RATIO,),
    add=scaling("joints", far_bearing_stiffness="ln_ratio"),
    applies=having("joints", "far_bearing_stiffness"),
)


LOSS_FACTOR = Effect(
    "loss-factor",
    "Loss factor of the joints",
    "Every spring of a joint loses a share of its energy in each cycle, at any frequency. Peaks become lower and "
    "wider; natural frequencies hardly move. Springs stiffen a little with frequency.",
    source="Sun et al. (2022), section 3: k (1 + jη); Kjartansson (1979) for what causality adds",
    parameters=(P("loss_factor", "-", 0.0, 0.5, 0.02),),
    add=increasing("joints", causal_loss_factor="loss_factor"),
    form_share=0.05,
)

CONSTANT_LOSS_FACTOR = Effect(
    "constant-loss-factor",
    "Loss factor of the joints, stiffness the same at all frequencies",
    "Every spring of a joint loses a share of its energy in each cycle, at any frequency, and is as stiff at all: the "
    "law of the papers and of most programs. What loses so in the world stiffens with frequency: loss-factor.",
    source="Sun et al. (2022), section 3: k (1 + jη)",
    parameters=(P("loss_factor", "-", 0.0, 0.5, 0.02),),
    add=increasing("joints", loss_factor="loss_factor"),
    form_share=0.05,
)

SCREW_LOSS = Effect(
    "screw-loss",
    "Loss factor of the screw",
    "The steel of the screw, or what fills or lines it, loses a share of its energy in each cycle, in tension and in "
    "torsion. Modes that strain the screw are damped the more, the further the table is from the bearing.",
    source="Kjartansson (1979); Cremer, Heckl & Petersson, Structure-Borne Sound, section 3.3, for the size in steel",
    parameters=(P("loss_factor", "-", 0.0, 0.2, 0.01),),
    add=increasing("screw", causal_loss_factor="loss_factor"),
    ordinary=0.005,  # steel has 0.0002 to 0.002, and a thread with its grease a little more
    form_share=0.05,
)

MOTOR_DAMPING = Effect(
    "motor-damping",
    "Damping of the motor",
    "Bearings and seals of the motor, eddy currents or the velocity loop of its drive hold the rotor back in "
    "proportion to its speed. Modes in which the rotor turns against the table are damped.",
    source="no source: a damper to ground",
    # with one of the reference what turns would swing no more
    parameters=(P("damping_nms_per_rad", "N·m·s/rad", 0.0, 1.0, 0.01, reference=Reference.ROTOR_DAMPING),),
    add=increasing("bodies", motor_damping="damping_nms_per_rad"),
)

GUIDE_FRICTION = Effect(
    "guide-friction",
    "Coulomb friction of the guides",
    "A force of constant size opposes the motion of the table. It damps weak excitation more than strong excitation; "
    "the response depends on the level.",
    source="Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5",
    parameters=(P("friction_n", "N", 0.0, 3.2, 0.032, reference=Reference.EXCITATION_FORCE),),
    add=increasing("added", guide_friction="friction_n"),
    form_share=0.03,
    needs=frozenset({ConditionAxis.FREQUENCY, ConditionAxis.LEVEL}),
)


PRELOAD_EXPONENT = Effect(
    "preload-exponent",
    "Exponent of the preload",
    "The rigidity of the nut grows as preload^(1/3 + change), which Hertz's contact alone would make the cube root; "
    "at 10 % of the dynamic load rating it is unchanged.",
    source="Nguyen et al. (2018), Eq. (1)",
    parameters=(P("exponent_change", "-", -1.0 / 3.0, 2.0 / 3.0, 0.1),),
    add=increasing("added", preload_exponent_change="exponent_change"),
    needs=frozenset({ConditionAxis.PRELOAD}),
    applies=having("joints", "dynamic_load_rating"),
)

PERIODIC_PRELOAD = Effect(
    "periodic-preload",
    "Preload that varies over the lead",
    "Errors of the thread that repeat each turn make preload and nut rigidity vary with the position over one lead: "
    "preload (1 + a cos 2πx/lead + b sin 2πx/lead).",
    source="no source: first harmonic of an error that repeats each turn",
    parameters=(
        P("cosine_amplitude", "-", -0.5, 0.5, 0.1, beyond=False),
        P("sine_amplitude", "-", -0.5, 0.5, 0.1, beyond=False),
    ),
    add=increasing("added", periodic_preload_cosine="cosine_amplitude", periodic_preload_sine="sine_amplitude"),
    needs=frozenset({ConditionAxis.POSITION}),
)

PRELOAD_CHANGE = Effect(
    "preload-change",
    "Change of the nut's preload",
    "Balls and raceways wear, and the nut is pressed together by less than was set: its contacts soften with the cube "
    "root of the preload. Frequencies fall a little, more at the stiff end of the screw; the antiresonance of the "
    "nut, which masses and bracket make, stays.",
    source="Nguyen et al. (2018), Eq. (1)",
    # a nut that has lost all of it has play, and no rigidity that a preload gives
    parameters=(P("preload_n", "N", -0.98, 1.0, 0.1, reference=Reference.PRELOAD),),
    add=increasing("added", preload_change="preload_n"),
    applies=having("joints", "dynamic_load_rating"),
)


THERMAL_PRELOAD = Effect(
    "thermal-preload",
    "Preload that follows temperature",
    "Nut and screw expand differently, and the preload rises or falls in proportion to the deviation from the "
    "reference temperature.",
    source="no source: linear thermal expansion",
    parameters=(P("preload_n_per_k", "N/K", -0.045, 0.045, 0.0045, reference=Reference.PRELOAD),),
    add=increasing("added", thermal_preload="preload_n_per_k"),
    needs=frozenset({ConditionAxis.TEMPERATURE}),
    applies=having("joints", "dynamic_load_rating"),
)

THERMAL_STIFFNESS = Effect(
    "thermal-stiffness",
    "Springs that soften as they warm",
    "Steel loses stiffness as it warms, some 0.3 ‰ a kelvin, and with it the screw and every joint by the same share "
    "of the deviation from the reference temperature: all frequencies fall alike, at every position.",
    source="Young's modulus of steels against temperature, ASME B31.3, Table C-6",
    parameters=(P("relative_change_per_k", "1/K", -0.001, 0.001, -0.0003),),
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
    "warming",
    "Warming",
    "Steel softens as it warms, and with it the screw and every joint by the same share: all frequencies fall alike, "
    "at every position.",
    source="Young's modulus of steels against temperature, ASME B31.3, Table C-6, and data sheets",
    parameters=(P("temperature_k", "K", -60.0, 100.0, 5.0),),
    add=_add_warming,
)


POSITION_OFFSET = Effect(
    "position-offset",
    "Offset of the position",
    "The table is further from the fixed bearing than is stated, by the same distance everywhere: the screw is "
    "longer, and so softer, on one side.",
    source="no source: kinematics",
    parameters=(P("offset_m", "m", -0.0515, 0.0515, 0.00515, reference=Reference.LENGTH),),
    add=increasing("added", position_offset="offset_m"),
    needs=frozenset({ConditionAxis.POSITION}),
)

TORQUE_DELAY = Effect(
    "torque-delay",
    "Delay between torque and motion",
    "Channels are sampled or filtered at different times, or the drive reports its torque early: the phase falls in "
    "proportion to the frequency, the magnitude stays.",
    source="no source: a shift in time, exp(−jωτ)",
    parameters=(P("delay_s", "s", -1.0, 1.0, 0.02, reference=Reference.PERIOD),),
    add=increasing("added", torque_delay="delay_s"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)

RESPONSE_DELAY = Effect(
    "response-delay",
    "Delay of the response at the table",
    "What is measured at table or nut is recorded late, by a filter or another clock, and the angle of the motor is "
    "not: the phase of the one falls in proportion to the frequency, against that of the other.",
    source="no source: a shift in time, exp(−jωτ)",
    parameters=(P("delay_s", "s", -1.0, 1.0, 0.02, reference=Reference.PERIOD),),
    add=increasing("added", response_delay="delay_s"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)

ANGLE_DELAY = Effect(
    "angle-delay",
    "Delay of the angle of the motor",
    "The angle of the motor comes late, as over a fieldbus, and what is measured at table or nut does not: the phase "
    "of the one falls in proportion to the frequency, against that of the other.",
    source="no source: a shift in time, exp(−jωτ)",
    parameters=(P("delay_s", "s", -1.0, 1.0, 0.02, reference=Reference.PERIOD),),
    add=increasing("added", angle_delay="delay_s"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)


def _add_sensor_mounting_resonance(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    r"""Multiply the acceleration by :math:`(1 + j \omega q b) / (1 - q (\omega^2 - j \omega b))`, b in rad/s.

    It is smooth in q, so that a search can start where the effect is absent: with a damping ratio, ζ = b√q/2, in place
    of the bandwidth b the slope there would be infinite.
    """
    inverse_square = values["inverse_square_s2"]
    ratio = math.pi * values["bandwidth_hz"] * math.sqrt(max(inverse_square, 0.0))  # a negative one is refused below
    return changed(axis, "added", mounting_inverse_square=inverse_square, mounting_damping_ratio=ratio)


SENSOR_MOUNTING_RESONANCE = Effect(
    "sensor-mounting-resonance",
    "Resonance of the accelerometer on its mounting",
    "The accelerometer is a mass on its magnet, wax or stud and reads too much towards its resonance f, by 1/(1 − ω² "
    "q) with q = 1/(2πf)²; the bandwidth is 2ζf. The angle of the motor is read right.",
    source="ISO 5348; transmissibility of a mass on a spring",
    parameters=(
        # a resonance at 1.5 times the first of the drive at least; where a search looks first, at 10 times
        P("inverse_square_s2", "s²", 0.0, 0.43, 0.01, reference=Reference.INVERSE_SQUARE),
        P("bandwidth_hz", "Hz", 0.0, 5.0, 0.5, null=1.0, reference=Reference.FREQUENCY),
    ),
    add=_add_sensor_mounting_resonance,
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "mounting_inverse_square"),
)


BASE_COMPLIANCE = Effect(
    "base-compliance",
    "Compliance of the base",
    "Bed or foundation is a mass on a spring, which the reaction of the bearings pushes: one more resonance, whose "
    "frequency does not depend on the position of the table.",
    source="no source: a mass on a spring",
    parameters=(
        P("compliance_m_per_n", "m/N", 0.0, 3.75, 0.0375, reference=Reference.AXIAL_COMPLIANCE),
        # beds rock on their mounts and bend as a whole below the drive; what resonates above is a part, and moves with
        # one
        P("frequency_hz", "Hz", 0.025, 0.95, 0.1, null=0.3, reference=Reference.FREQUENCY),
        P("damping_ratio", "-", 0.0, 0.3, 0.02, null=0.02),
    ),
    add=resonating("base_compliance", by="compliance_m_per_n"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "base_compliance"),
)

SECOND_MODE = Effect(
    "second-mode",
    "One more mode at the table",
    "Something on the table or in its structure resonates by itself and adds one modal term, driven and seen at the "
    "table, at a frequency that nothing of the drive moves.",
    source="Ewins, Modal Testing, chapter 2: one term of the modal sum",
    parameters=(
        P("residue_per_kg", "1/kg", 0.0, 22.0, 0.022, reference=Reference.INVERSE_MASS),
        P("frequency_hz", "Hz", 0.025, 25.0, 0.25, null=1.5, reference=Reference.FREQUENCY),
        P("damping_ratio", "-", 0.0, 0.3, 0.02, null=0.02),
    ),
    add=resonating("second_mode_residue", by="residue_per_kg"),
    form_share=0.08,
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "second_mode_residue"),
)

#: At most half of what moves, and seen from a few per mille of it on.
_ABSORBER = (
    P("mass_kg", "kg", 0.0, 0.5, 0.005, reference=Reference.MOVING_MASS),
    P("frequency_hz", "Hz", 0.025, 25.0, 0.25, null=1.5, reference=Reference.FREQUENCY),
    P("damping_ratio", "-", 0.0, 0.5, 0.02, null=0.02),
)

_ABSORBER_SOURCE = "Den Hartog, Mechanical Vibrations, section 3.2: the auxiliary mass"

TABLE_ABSORBER = Effect(
    "table-absorber",
    "Something that swings on the table",
    "A cover, cable carrier or workpiece hangs on the table by a spring and a damper. At its own frequency, the same "
    "at every position, it holds the table nearly still; below it adds its mass, above it does nothing.",
    source=_ABSORBER_SOURCE,
    parameters=_ABSORBER,
    add=resonating("table_absorber_mass", by="mass_kg"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "table_absorber_mass"),
)


def _may_have_nut_absorber(axis: AxisPhysics) -> bool:
    return _has_a_bracket_that_yields(axis) and not axis.added.nut_absorber_mass


NUT_ABSORBER = Effect(
    "nut-absorber",
    "Something that swings on the nut",
    "The return tubes, a wiper or an oil line of the nut hangs on it by a spring and a damper, before the bracket. At "
    "its own frequency it holds the nut nearly still, and the table moves by what the bracket lets it.",
    source=_ABSORBER_SOURCE,
    parameters=_ABSORBER,
    add=resonating("nut_absorber_mass", by="mass_kg"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=_may_have_nut_absorber,
)

#: Keys are those of files. Two entries share one: which of them an axis can have depends on its inertia.
DRIVE_EFFECTS: tuple[Effect[AxisPhysics], ...] = (
    ADDED_MASS,
    PAYLOAD_MASS,
    SERIES_COMPLIANCE,
    FAR_BEARING_STIFFNESS,
    SCREW_AXIAL_STIFFNESS,
    SCREW_DISTRIBUTED_MASS,
    TORSIONAL_FLEXIBILITY,
    TORSIONAL_FLEXIBILITY_OF_LUMPED_INERTIA,
    LOSS_FACTOR,
    GUIDE_FRICTION,
    GUIDE_STIFFNESS,
    PRELOAD_EXPONENT,
    THERMAL_PRELOAD,
    THERMAL_STIFFNESS,
    POSITION_OFFSET,
    TORQUE_DELAY,
    SENSOR_MOUNTING_RESONANCE,
    BASE_COMPLIANCE,
    SERVO_STIFFNESS,
    PERIODIC_PRELOAD,
    CUBIC_STIFFNESS,
    SECOND_MODE,
    NUT_MASS,
    SCREW_LOSS,
    TABLE_ABSORBER,
    NUT_ABSORBER,
    MOTOR_DAMPING,
    RESPONSE_DELAY,
    ANGLE_DELAY,
    CONSTANT_LOSS_FACTOR,
    RESPONSE_UNIT,
    TORQUE_UNIT,
)
