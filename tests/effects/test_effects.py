"""The catalogue of drive effects: nothing at null values, something at any other, and what each must agree with."""

import math
import pickle
from dataclasses import asdict, replace
from itertools import combinations, permutations

import numpy as np
import pytest

from monitor_core.effects import (
    DRIVE_EFFECTS,
    applicable_effects,
    sized_for,
    with_effects,
    wrong_parameter,
    wrong_parameters,
)
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.extended import ExtendedModel, natural_frequencies, physics_of, prepare_lines, responses
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.lumped import LumpedParameters
from tests.models.extended_axes import FAMILIES, bundled, case_of

BAND = np.geomspace(5.0, 1500.0, 50)
FORCE, AT_SCREW, AT_MOTOR = (
    ExcitationPoint.FORCE_AT_TABLE, ExcitationPoint.TORQUE_AT_SCREW, ExcitationPoint.TORQUE_AT_MOTOR
)  # fmt: skip
ACCELERATION, ANGLE = ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR
ASKED = ((AT_SCREW, ACCELERATION), (AT_MOTOR, ACCELERATION), (AT_MOTOR, ANGLE))
PARAMETERS = {family: bundled(family).parameters for family in FAMILIES}
#: Each family with a nut that follows the preload and one that does not: every effect applies to one of them.
AXES = PARAMETERS | {
    f"{family}, rated": replace(parameters, dynamic_load_rating=2e4)
    for family, parameters in PARAMETERS.items()
    if parameters.dynamic_load_rating is None
}
#: The keys of files, the part that is about drives, and springs that soften as they warm.
KEYS = [
    "added-mass", "payload-mass", "series-compliance", "far-bearing-stiffness", "screw-axial-stiffness",
    "screw-distributed-mass", "torsional-flexibility", "loss-factor", "guide-friction", "guide-stiffness",
    "preload-exponent", "thermal-preload", "thermal-stiffness", "position-offset", "torque-delay",
    "sensor-mounting-resonance", "base-compliance", "servo-stiffness", "periodic-preload", "cubic-stiffness",
    "second-mode", "nut-mass", "screw-loss", "table-absorber", "nut-absorber", "motor-damping", "response-delay",
    "angle-delay", "constant-loss-factor", "unit", "torque-unit",
]  # fmt: skip
#: How a unit ends a name.
ENDINGS = {
    "kg": "_kg", "m/N": "_m_per_n", "N/m": "_n_per_m", "N": "_n", "N/K": "_n_per_k", "m": "_m", "s": "_s", "s²": "_s2",
    "Hz": "_hz", "N·m/rad": "_nm_per_rad", "N·m·s/rad": "_nms_per_rad", "1/m²": "_per_m2", "1/kg": "_per_kg",
    "1/K": "_per_k",
}  # fmt: skip


def conditions_of(parameters, **changes):
    """Return three conditions that differ in all that an effect may need."""
    rated = parameters.dynamic_load_rating is not None
    varied = ((0.231, 100.0, 0.0, 0.0, 0.1), (0.357, 100.0, 3.0, 12.0, 0.1), (0.713, 300.0, 3.0, -8.0, 0.3))
    return [
        replace(
            DriveConditions(
                share * parameters.screw_length,
                preload if rated else None,
                payload_mass=payload,
                temperature_deviation=temperature,
                excitation_level=level,
            ),
            **changes,
        )
        for share, preload, payload, temperature, level in varied
    ]


def effects_of(parameters):
    """Return the effects that an axis can have, sized for it as it is measured."""
    axis, line = physics_of(parameters), np.ones(1)
    seen = [FrequencyResponseObservation(stated, line, line, line, AT_SCREW) for stated in conditions_of(parameters)]
    return sized_for(applicable_effects(axis, DRIVE_EFFECTS), sizes_of_drive(axis, seen))


PAIRS = [(name, effect) for name, parameters in AXES.items() for effect in effects_of(parameters)]


def lines_of(parameters, **changes):
    return prepare_lines(
        [
            case_of(parameters, BAND, conditions, *asked)
            for conditions in conditions_of(parameters, **changes)
            for asked in ASKED
        ]
    )


def moved(before, after):
    """Return the largest relative change."""
    return float(np.max(np.abs(after / before - 1.0)))


def frequencies(axis, conditions):
    """Return the elastic natural frequencies below 600 Hz with a free motor end."""
    found = natural_frequencies(axis, conditions, [MotorEnd.FREE] * len(conditions), 600.0)
    return np.array([mode.frequency for modes in found for mode in modes if mode.frequency > 0.0])


def strong_values(effect):
    return {parameter.name: parameter.null + parameter.scale for parameter in effect.parameters}


def of_key(key, parameters):
    (effect,) = (listed for listed in effects_of(parameters) if listed.key == key)
    return effect


# --- the table -------------------------------------------------------------------------------------------------------


def test_keys_are_those_of_the_formats() -> None:
    assert list(dict.fromkeys(effect.key for effect in DRIVE_EFFECTS)) == KEYS


def test_effects_travel_between_processes() -> None:
    effects = (*DRIVE_EFFECTS, *wrong_parameters(RATED))
    copies = pickle.loads(pickle.dumps(effects))  # noqa: S301 made here
    assert [effect.key for effect in copies] == [effect.key for effect in effects]


@pytest.mark.parametrize("name", AXES)
def test_an_axis_has_each_key_once(name) -> None:
    keys = [effect.key for effect in applicable_effects(physics_of(AXES[name]), DRIVE_EFFECTS)]
    absent = set(KEYS) - set(keys)
    assert len(set(keys)) == len(keys)
    before_a_bracket = {"nut-mass", "nut-absorber"}
    assert absent - before_a_bracket <= {"screw-distributed-mass", "preload-exponent", "thermal-preload"}
    assert (absent & before_a_bracket) == (before_a_bracket if math.isinf(AXES[name].bracket_stiffness) else set())
    assert ("screw-distributed-mass" in absent) == (name != "lumped")
    assert ("thermal-preload" in absent) == (AXES[name].dynamic_load_rating is None)


def test_every_effect_says_what_it_is(subtests: pytest.Subtests) -> None:
    for effect in DRIVE_EFFECTS:
        with subtests.test(effect.key):
            assert effect.name
            assert effect.physics.endswith(".")
            assert effect.source
            for parameter in effect.parameters:
                assert parameter.unit == "-" or parameter.name.endswith(ENDINGS[parameter.unit])


# --- null values and others ------------------------------------------------------------------------------------------


def test_nothing_changes_at_null_values(subtests) -> None:
    for name, parameters in AXES.items():
        axis, lines, conditions = physics_of(parameters), lines_of(parameters), conditions_of(parameters)
        expected = responses(axis, lines), frequencies(axis, conditions)
        for effect in effects_of(parameters):
            with subtests.test(f"{effect.key}, {name}"):
                null = effect.added_to(axis, effect.null_values())
                np.testing.assert_array_equal(responses(null, lines), expected[0])
                np.testing.assert_array_equal(frequencies(null, conditions), expected[1])


def test_every_parameter_moves_a_prediction(subtests) -> None:
    for name, effect in PAIRS:
        with subtests.test(f"{effect.key}, {name}"):
            axis, lines = physics_of(AXES[name]), lines_of(AXES[name])
            values = strong_values(effect)
            strong = responses(effect.added_to(axis, values), lines)
            for parameter in effect.parameters:
                without = responses(effect.added_to(axis, values | {parameter.name: parameter.null}), lines)
                assert moved(without, strong) > 1e-4


#: Conditions under which what an effect needs does not vary, and is null.
STILL = {
    ConditionAxis.PAYLOAD: {"payload_mass": 0.0},
    ConditionAxis.TEMPERATURE: {"temperature_deviation": 0.0},
    ConditionAxis.LEVEL: {"excitation_level": 0.0},
}


def test_nothing_is_seen_without_what_it_needs(subtests) -> None:
    for name, effect in PAIRS:
        with subtests.test(f"{effect.key}, {name}"):
            parameters, axis = AXES[name], physics_of(AXES[name])
            strong = effect.added_to(axis, strong_values(effect))
            for needed in effect.needs & set(STILL):
                lines = lines_of(parameters, **STILL[needed])
                np.testing.assert_array_equal(responses(strong, lines), responses(axis, lines))
            # a base moves frequencies, but by as much as a softer bearing would: only its own resonance tells it
            # (and what hangs on table or nut is one more mode, and moves those about it)
            moving = {"base-compliance", "loss-factor", "table-absorber", "nut-absorber"}
            if ConditionAxis.FREQUENCY in effect.needs and effect.key not in moving:
                conditions = conditions_of(parameters)
                np.testing.assert_allclose(frequencies(strong, conditions), frequencies(axis, conditions), rtol=1e-3)


def test_it_is_smooth_where_it_is_absent(subtests) -> None:
    """A search starts at null: half the step makes half the change, so that the slope there is finite."""
    for name, effect in PAIRS:
        with subtests.test(f"{effect.key}, {name}"):
            axis, lines, null = physics_of(AXES[name]), lines_of(AXES[name]), effect.null_values()
            base = responses(axis, lines)
            steps = {parameter.name: 1e-4 * parameter.scale for parameter in effect.parameters}
            whole, half = (
                [
                    responses(effect.added_to(axis, null | {key: null[key] + share * step}), lines) / base - 1.0
                    for key, step in steps.items()
                ]
                for share in (1.0, 0.5)
            )
            assert np.max(np.abs(whole)) > 0.0
            np.testing.assert_allclose(2.0 * np.array(half), whole, rtol=0.0, atol=0.01 * np.max(np.abs(whole)))


# --- composition -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", AXES)
def test_effects_of_the_catalogue_commute(name) -> None:
    """Each changes numbers of its own, so that nothing is left of the order, not even rounding."""
    axis = physics_of(AXES[name])
    for effect, other in combinations(effects_of(AXES[name]), 2):
        first = other.added_to(effect.added_to(axis, strong_values(effect)), strong_values(other))
        second = effect.added_to(other.added_to(axis, strong_values(other)), strong_values(effect))
        assert first == second


@pytest.mark.parametrize("key", ["base-compliance", "second-mode", "sensor-mounting-resonance", "table-absorber"])
def test_what_can_be_there_once_is_not_overwritten(key) -> None:
    parameters = PARAMETERS["hybrid"]
    effect = of_key(key, parameters)
    once = effect.added_to(physics_of(parameters), strong_values(effect))
    with pytest.raises(OutsideValidityError, match=f"{key} does not apply: .* or has the effect already"):
        effect.added_to(once, strong_values(effect))


# --- what each agrees with -------------------------------------------------------------------------------------------

#: Effects that are another value of a parameter of the family: values, and the parameter's.
SAME_AS_PARAMETER = {
    "added-mass": ({"mass_kg": 1.7}, lambda p: {"table_mass": p.table_mass + 1.7}),
    "far-bearing-stiffness": (
        {"stiffness_n_per_m": 2e7}, lambda p: {"far_bearing_stiffness": p.far_bearing_stiffness + 2e7}
    ),
    "screw-axial-stiffness": ({"relative_change": -0.1}, lambda p: {"youngs_modulus": 0.9 * p.youngs_modulus}),
    "torsional-flexibility": ({"compliance_share": 0.25}, lambda p: {"shear_modulus": p.shear_modulus / 1.25}),
    "series-compliance": ({"compliance_m_per_n": 5e-9}, lambda _: {"bracket_stiffness": 2e8}),
    "constant-loss-factor": ({"loss_factor": 0.02}, lambda p: {"loss_factor": p.loss_factor + 0.02}),
    "motor-damping": ({"damping_nms_per_rad": 3e-3}, lambda p: {"motor_damping": p.motor_damping + 3e-3}),
}  # fmt: skip


@pytest.mark.parametrize("key", SAME_AS_PARAMETER)
def test_it_is_the_family_with_another_parameter(key) -> None:
    parameters = PARAMETERS["receptance"]
    values, changes = SAME_AS_PARAMETER[key]
    lines = lines_of(parameters)
    np.testing.assert_allclose(
        responses(of_key(key, parameters).added_to(physics_of(parameters), values), lines),
        responses(physics_of(replace(parameters, **changes(parameters))), lines),
        rtol=1e-9,
    )


def test_a_loss_factor_is_that_of_the_papers_at_200_hz_and_causal_everywhere() -> None:
    r"""A causal spring of constant loss angle δ is :math:`k (j\omega/\omega_0)^{2\delta/\pi}`, Kjartansson (1979)."""
    parameters = replace(PARAMETERS["receptance"], bearing_stiffness=1e6, coupling_stiffness=1e6)
    with_loss = of_key("loss-factor", parameters).added_to(physics_of(parameters), {"loss_factor": 0.2})
    springs = ("bearing_stiffness", "far_bearing_stiffness", "nut_stiffness", "coupling_stiffness")
    for frequency in (100.0, 200.0, 400.0):
        lines = prepare_lines([case_of(parameters, [frequency], conditions_of(parameters)[0], FORCE)])
        stiffer = (frequency / 200.0) ** (2.0 / math.pi * math.atan(0.2))
        scaled = {name: getattr(parameters, name) * stiffer for name in springs}
        expected = responses(physics_of(replace(parameters, loss_factor=0.2, **scaled)), lines)
        np.testing.assert_allclose(responses(with_loss, lines), expected, rtol=1e-9)


RATED = PARAMETERS["lumped"]
LUMPED_AXIS = physics_of(RATED)
AT = conditions_of(RATED)[1]
LEAD_PHASE = 2.0 * math.pi * AT.position / RATED.screw_lead
OVER_LEAD = 1.0 + 0.1 * math.cos(LEAD_PHASE) - 0.2 * math.sin(LEAD_PHASE)
#: Effects that are other conditions than those stated: values, and the conditions.
SAME_AS_CONDITIONS = {
    "payload-mass": ({"mass_kg": 0.8}, {"payload_mass": AT.payload_mass + 0.8}),
    "thermal-preload": ({"preload_n_per_k": 2.0}, {"preload": AT.preload + 2.0 * AT.temperature_deviation}),
    "position-offset": ({"offset_m": -0.01}, {"position": AT.position - 0.01}),
    "periodic-preload": (
        {"cosine_amplitude": 0.1, "sine_amplitude": -0.2}, {"preload": AT.preload * OVER_LEAD}
    ),
}  # fmt: skip


def response_at(axis, conditions, excitation=AT_MOTOR, response=ACCELERATION):
    return responses(axis, prepare_lines([case_of(RATED, BAND, conditions, excitation, response)]))


@pytest.mark.parametrize("key", SAME_AS_CONDITIONS)
def test_it_is_the_axis_under_other_conditions(key) -> None:
    values, changes = SAME_AS_CONDITIONS[key]
    np.testing.assert_allclose(
        response_at(of_key(key, RATED).added_to(LUMPED_AXIS, values), AT),
        response_at(LUMPED_AXIS, replace(AT, **changes)),
        rtol=1e-12,
    )


def test_warm_springs_and_screw_are_softer_by_one_share() -> None:
    warm = of_key("thermal-stiffness", RATED).added_to(LUMPED_AXIS, {"relative_change_per_k": -3e-4})
    share = 1.0 - 3e-4 * AT.temperature_deviation
    screw, joints = LUMPED_AXIS.screw, LUMPED_AXIS.joints
    of_screw = {name: share * getattr(screw, name) for name in ("axial_rigidity", "torsional_rigidity")}
    of_joints = {
        name: share * getattr(joints, name)
        for name in ("bearing_stiffness", "bracket_stiffness", "nut_stiffness", "coupling_stiffness")
    }
    softer = replace(LUMPED_AXIS, screw=replace(screw, **of_screw), joints=replace(joints, **of_joints))
    np.testing.assert_allclose(response_at(warm, AT), response_at(softer, AT), rtol=1e-12)
    usual = replace(AT, temperature_deviation=0.0)
    np.testing.assert_array_equal(response_at(warm, usual), response_at(LUMPED_AXIS, usual))
    with pytest.raises(OutsideValidityError, match="springs must keep some stiffness at every temperature"):
        response_at(of_key("thermal-stiffness", RATED).added_to(LUMPED_AXIS, {"relative_change_per_k": -1.0}), AT)


def test_at_one_preload_an_exponent_is_a_nut_stiffness() -> None:
    exponent = of_key("preload-exponent", RATED).added_to(LUMPED_AXIS, {"exponent_change": 0.15})
    ln_ratio = 0.15 * math.log(AT.preload / (0.1 * RATED.dynamic_load_rating))
    nut = wrong_parameter("nut_stiffness_n_per_m", RATED).added_to(LUMPED_AXIS, {"ln_ratio": ln_ratio})
    np.testing.assert_allclose(response_at(exponent, AT), response_at(nut, AT), rtol=1e-12)


def test_a_delay_turns_the_phase() -> None:
    late = of_key("torque-delay", RATED).added_to(LUMPED_AXIS, {"delay_s": 3e-4})
    turned = response_at(LUMPED_AXIS, AT) * np.exp(-2j * math.pi * BAND * 3e-4)
    np.testing.assert_allclose(response_at(late, AT), turned, rtol=1e-12)


@pytest.mark.parametrize(("key", "late", "in_time"), [
    ("response-delay", ACCELERATION, ANGLE), ("angle-delay", ANGLE, ACCELERATION),
])  # fmt: skip
def test_a_delay_of_one_channel_turns_the_phase_of_that_alone(key, late, in_time) -> None:
    """And both delays together are that of the torque: which of the three is late, two channels cannot say."""
    delayed = of_key(key, RATED).added_to(LUMPED_AXIS, {"delay_s": 3e-4})
    turned = response_at(LUMPED_AXIS, AT, response=late) * np.exp(-2j * math.pi * BAND * 3e-4)
    np.testing.assert_allclose(response_at(delayed, AT, response=late), turned, rtol=1e-12)
    np.testing.assert_array_equal(
        response_at(delayed, AT, response=in_time), response_at(LUMPED_AXIS, AT, response=in_time)
    )
    other = "angle-delay" if key == "response-delay" else "response-delay"
    both = of_key(other, RATED).added_to(delayed, {"delay_s": 3e-4})
    torque = of_key("torque-delay", RATED).added_to(LUMPED_AXIS, {"delay_s": 3e-4})
    for response in (late, in_time):
        np.testing.assert_allclose(
            response_at(both, AT, response=response), response_at(torque, AT, response=response), rtol=1e-12
        )


def test_an_accelerometer_on_its_mounting_is_a_mass_on_a_spring() -> None:
    """Resonance at 2 kHz with a half-power bandwidth of 160 Hz: damping ratio 0.04."""
    values = {"inverse_square_s2": (2.0 * math.pi * 2000.0) ** -2, "bandwidth_hz": 160.0}
    mounted = of_key("sensor-mounting-resonance", RATED).added_to(LUMPED_AXIS, values)
    ratio = BAND / 2000.0
    transmissibility = (1.0 + 0.08j * ratio) / (1.0 - ratio**2 + 0.08j * ratio)
    np.testing.assert_allclose(response_at(mounted, AT), response_at(LUMPED_AXIS, AT) * transmissibility, rtol=1e-12)
    np.testing.assert_array_equal(
        response_at(mounted, AT, response=ANGLE), response_at(LUMPED_AXIS, AT, response=ANGLE)
    )


def test_a_base_adds_its_own_receptance_to_what_the_force_meets() -> None:
    """Without the table's inertia the path answers a force with C; the base adds that of a mass on a spring."""
    values = {"compliance_m_per_n": 2e-9, "frequency_hz": 70.0, "damping_ratio": 0.05}
    with_base = of_key("base-compliance", RATED).added_to(LUMPED_AXIS, values)
    moving = RATED.table_mass + RATED.nut_mass + RATED.screw_mass + AT.payload_mass
    inertia = -((2.0 * math.pi * BAND) ** 2) * moving
    displacements = (
        response_at(axis, AT, FORCE, ResponsePoint.DISPLACEMENT_AT_TABLE) for axis in (with_base, LUMPED_AXIS)
    )
    path_with, path = (1.0 / (1.0 / displacement - inertia) for displacement in displacements)
    ratio = BAND / 70.0
    np.testing.assert_allclose(path_with - path, 2e-9 / (1.0 - ratio**2 + 0.1j * ratio), rtol=0.0, atol=1e-14)


def test_one_more_mode_is_one_more_term() -> None:
    values = {"residue_per_kg": 2e-3, "frequency_hz": 410.0, "damping_ratio": 0.03}
    both = of_key("second-mode", RATED).added_to(LUMPED_AXIS, values)
    ratio = BAND / 410.0
    term = -2e-3 * ratio**2 / (1.0 - ratio**2 + 0.06j * ratio)
    quiet = replace(AT, excitation_level=0.0)
    difference = response_at(both, quiet, FORCE) - response_at(LUMPED_AXIS, quiet, FORCE)
    np.testing.assert_allclose(difference, term, rtol=1e-9)


@pytest.mark.parametrize(
    ("key", "values", "stiffness"),
    [
        ("guide-stiffness", {"stiffness_n_per_m": 3e4}, 3e4),
        ("servo-stiffness", {"stiffness_nm_per_rad": 0.05}, 0.05 * (2.0 * math.pi / RATED.screw_lead) ** 2),
    ],
)
def test_what_holds_the_drive_gives_it_a_slow_mode(key, values, stiffness) -> None:
    """The whole drive on a spring hundreds of times softer than itself: √(k/m), m the moving mass with what turns."""
    held = of_key(key, RATED).added_to(LUMPED_AXIS, values)
    ratio = RATED.screw_lead / (2.0 * math.pi)
    moving = RATED.table_mass + RATED.nut_mass + RATED.screw_mass + AT.payload_mass
    mass = moving + RATED.screw_inertia / ratio**2
    slowest = frequencies(held, [AT])[0]
    assert slowest == pytest.approx(math.sqrt(stiffness / mass) / (2.0 * math.pi), rel=2e-3)


def test_of_a_mass_that_is_spread_a_third_counts() -> None:
    """Rayleigh: of a spring that is light beside what it carries, a third of the mass moves with that."""
    screw_alone = replace(RATED, table_mass=200.0, bearing_stiffness=1e12, bracket_stiffness=1e12, nut_stiffness=1e12)
    axis = physics_of(replace(screw_alone, dynamic_load_rating=None, coupling_stiffness=1e9, shear_modulus=1e15))
    spread = of_key("screw-distributed-mass", RATED).added_to(axis, {"share": 1.0})
    at = DriveConditions(0.999 * RATED.screw_length)
    (with_table,), (along_screw,) = (
        natural_frequencies(physics, [at], [MotorEnd.CLAMPED], 400.0)[0] for physics in (axis, spread)
    )
    total = 200.0 + RATED.nut_mass + RATED.screw_mass
    expected = math.sqrt(total / (total - 2.0 / 3.0 * RATED.screw_mass))
    assert along_screw.frequency / with_table.frequency == pytest.approx(expected, rel=2e-5)


# --- wrong parameters ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_every_wrong_parameter_vanishes_and_moves(family) -> None:
    parameters = PARAMETERS[family]
    axis, lines = physics_of(parameters), lines_of(parameters)
    before = responses(axis, lines)
    found = wrong_parameters(parameters)
    declared = {name for name, value in parameters.to_file_names().items() if value}
    assert {effect.key for effect in found} == {f"wrong-parameter:{name}" for name in declared}
    for effect in found:
        assert effect.added_to(axis, {"ln_ratio": 0.0}) == axis
        assert moved(before, responses(effect.added_to(axis, strong_values(effect)), lines)) > 1e-6


@pytest.mark.parametrize("family", FAMILIES)
def test_two_wrong_parameters_are_the_model_with_both(family) -> None:
    parameters = PARAMETERS[family]
    names = [effect.key.partition(":")[2] for effect in wrong_parameters(parameters)]
    declared = parameters.to_file_names()
    for part, other in permutations(names, 2):
        axis = physics_of(parameters)
        for name, ln_ratio in ((part, 0.4), (other, -0.7)):
            axis = wrong_parameter(name, parameters).added_to(axis, {"ln_ratio": ln_ratio})
        both = declared | {part: declared[part] * math.exp(0.4), other: declared[other] * math.exp(-0.7)}
        assert_same(axis, physics_of(type(parameters).from_file_names(both, family)))


@pytest.mark.parametrize("family", FAMILIES)
def test_wrong_parameters_and_effects_commute(family) -> None:
    parameters = PARAMETERS[family]
    axis = physics_of(parameters)
    for wrong in wrong_parameters(parameters):
        for effect in effects_of(parameters):
            first = effect.added_to(wrong.added_to(axis, {"ln_ratio": 0.3}), strong_values(effect))
            second = wrong.added_to(effect.added_to(axis, strong_values(effect)), {"ln_ratio": 0.3})
            assert_same(first, second)


def assert_same(axis, other):
    """Compare every number of two axes to rounding; none of them is another one at each setting."""
    assert (axis.by_setting, axis.second) == (other.by_setting, other.second) == ((), None)
    records = ([record for record in asdict(each).values() if isinstance(record, dict)] for each in (axis, other))
    for record, theirs in zip(*records, strict=True):
        for name, value in record.items():
            assert value == theirs[name] or value == pytest.approx(theirs[name], rel=1e-12), name


def test_the_misprinted_bracket_is_a_wrong_parameter() -> None:
    """Nguyen et al. print a tenth of what their measurements speak for (docs/reference/errata.md)."""
    printed = replace(RATED, bracket_stiffness=2.1e7)
    right = wrong_parameter("bracket_stiffness_n_per_m", printed).added_to(
        physics_of(printed), {"ln_ratio": math.log(10.0)}
    )
    np.testing.assert_allclose(response_at(right, AT), response_at(LUMPED_AXIS, AT), rtol=1e-9)


# --- refusals --------------------------------------------------------------------------------------------------------

IMPOSSIBLE = [
    ("far-bearing-stiffness", {"stiffness_n_per_m": -1e7}, "far_bearing_stiffness must be finite and not negative"),
    ("screw-axial-stiffness", {"relative_change": -1.0}, "axial_rigidity must be positive and finite; got 0.0"),
    ("screw-distributed-mass", {"share": 1.5}, "axial_mass_share must lie within 0 and 1; got 1.5"),
    ("torsional-flexibility", {"compliance_share": -1.5, "inertia_share": 0.0}, "torsion_share must be finite and not"),
    ("torsional-flexibility", {"compliance_share": 0.0, "inertia_share": -0.1}, "torsional_inertia_share must lie"),
    ("loss-factor", {"loss_factor": -1.0}, "loss_factor must be finite and not negative"),
    ("guide-friction", {"friction_n": -1.0}, "guide_friction must be finite and not negative; got -1.0"),
    ("guide-friction", {"friction_n": math.nan}, "friction_n must be finite; got nan N"),
    ("guide-friction", {}, "has the parameters friction_n; got none"),
    ("sensor-mounting-resonance", {"inverse_square_s2": -1e-9, "bandwidth_hz": 9.0}, "must be finite and not negative"),
    (
        "base-compliance",
        {"compliance_m_per_n": 1e-9, "frequency_hz": 0.0, "damping_ratio": 0.0},
        "base_frequency must be positive; got 0.0 Hz",
    ),
    ("screw-loss", {"loss_factor": -0.1}, "causal_loss_factor must be finite and not negative; got -0.1"),
    ("motor-damping", {"damping_nms_per_rad": -1.0}, "motor_damping must be finite and not negative; got"),
    ("nut-mass", {"mass_kg": -1.0}, "nut_mass must be finite and not negative; got -1.0"),
    (
        "table-absorber",
        {"mass_kg": 0.1, "frequency_hz": 0.0, "damping_ratio": 0.0},
        "table_absorber_frequency must be positive where the absorber has a mass; got 0.0 Hz",
    ),
    (
        "nut-absorber",
        {"mass_kg": 0.1, "frequency_hz": 300.0, "damping_ratio": -0.1},
        "nut_absorber_damping_ratio must be finite and not negative",
    ),
    (
        "second-mode",
        {"residue_per_kg": 1e-3, "frequency_hz": 0.0, "damping_ratio": 0.0},
        "second_mode_frequency must be positive",
    ),
    ("wrong-parameter:table_mass_kg", {"ln_ratio": 1e3}, "ln_ratio must lie within ±200; got 1000"),
    ("wrong-parameter:table_mass_kg", {"ln_ratio": 100.0}, "table_mass_kg must lie within 1e-30 and 1e+30 kg; got"),
    ("wrong-parameter:loss_factor", {"ln_ratio": 4.0}, "loss_factor must lie within 0 and 0.9; got 1.63"),
]


def test_what_no_axis_could_have_is_refused(subtests: pytest.Subtests) -> None:
    for key, values, sentence in IMPOSSIBLE:
        with subtests.test(key=key, values=values):
            with pytest.raises(OutsideValidityError) as caught:
                with_effects(ExtendedModel.of(RATED), {key: values})
            assert str(caught.value).startswith(f"the effect {key}")
            assert sentence in str(caught.value)
            assert "\n" not in str(caught.value)


def test_a_loss_factor_is_not_searched_beyond_what_the_record_takes() -> None:
    damped = LumpedParameters(**{**asdict(RATED), "loss_factor": 0.6})
    (parameter,) = wrong_parameter("loss_factor", damped).parameters
    assert 0.6 * math.exp(parameter.upper) == pytest.approx(0.9)


def test_an_effect_without_a_size_is_refused() -> None:
    factor = EffectParameter("factor", "-", lower=0.2, upper=5.0, scale=0.5, null=1.0)
    with pytest.raises(OutsideValidityError, match=r"the first parameter .* must be null at 0; got 1\.0 of factor"):
        Effect("factor", "A factor", "It multiplies.", "this test", (factor,), lambda physics, _values: physics)


def test_two_effects_of_one_key_are_refused() -> None:
    mine = Effect("added-mass", "mine", "It is mine.", "none", (EffectParameter("mass_kg", "kg", 0.0, 1.0, 0.1),), max)
    with pytest.raises(OutsideValidityError, match="effects must have different keys; got added-mass twice"):
        applicable_effects(LUMPED_AXIS, (*DRIVE_EFFECTS, mine))


@pytest.mark.parametrize(("key", "of_acceleration", "of_angle"), [
    ("unit", 1.0 / 9.80665, 1.0), ("torque-unit", 9.80665, 9.80665),
])  # fmt: skip
def test_another_unit_is_one_factor_of_its_channel(key, of_acceleration, of_angle) -> None:
    """An acceleration in g and a torque in kgf·m: nothing of the phase, the same at every frequency."""
    wrong = of_key(key, RATED).added_to(LUMPED_AXIS, {"ln_factor": -math.log(9.80665)})
    for response, factor in ((ACCELERATION, of_acceleration), (ANGLE, of_angle)):
        np.testing.assert_allclose(
            response_at(wrong, AT, response=response),
            factor * response_at(LUMPED_AXIS, AT, response=response),
            rtol=1e-12,
        )
