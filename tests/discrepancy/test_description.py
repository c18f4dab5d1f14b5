"""What no catalogue names is described: by plants that share no formula with the models."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.description.describe import describe, describe_elsewhere, describe_in_place
from monitor_core.discrepancy.description.levels import describe_levels
from monitor_core.discrepancy.description.variation import QUANTITIES, contacts_for, hung_elsewhere
from monitor_core.discrepancy.screening import screen
from monitor_core.effects import Variable
from monitor_core.effects.variation import Form
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.hold_out import fitted_values, gap_of, judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.models.extended import ExtendedModel
from monitor_core.models.families import build_model
from monitor_core.recordings.effect_file import effect_file_text, read_effect_file
from monitor_core.recordings.model_file import parse_model
from service.report.verdict import described_sentence
from tests.hidden_effects import cases, frf_file
from tests.hidden_effects.truth import transmission_line


def described(kind, size, seed, changed=lambda observations, _drive: observations):
    """Return the case, what was said of it from the model as stated, and the fit before."""
    case, baseline, candidates, sizes = stated(kind, size, seed, changed)
    return case, describe(baseline, baseline, candidates, sizes, lambda _sentence: None), baseline


def stated(kind, size, seed, changed=lambda observations, _drive: observations):
    """Return the case, the fit of the model as stated, the candidates and the sizes of the machine."""
    case = cases.draw_case(kind, size, seed=seed, respond=transmission_line.respond)
    measured = frf_file.observations(case)
    file = parse_model(case.baseline, kind)
    drive = DescribedDrive(build_model(file.family, file.parameters).parameters, dict(file.uncertain), {})
    measured = changed(measured, drive)
    comparison = compare_responses(measured, held_out=default_folds(each.conditions for each in measured))
    plain = Hypothesis(drive)
    baseline = fit(comparison, plain, plain.null, fitted_values(comparison.layout))
    sizes = sizes_of_drive(drive.physics({}), measured)
    return case, baseline, drive.candidates(sizes), sizes


def fitted_with(key, baseline, candidates):
    """Return the fit with one of the candidates more, from where it is absent."""
    (effect,) = (effect for effect in candidates if effect.key == key)
    hypothesis = baseline.hypothesis.with_effect(effect)
    start = hypothesis.carried_over(baseline.hypothesis, baseline.coordinates)
    return fit(baseline.comparison, hypothesis, start, baseline.fitted)


@pytest.mark.release
def test_an_absorber_that_wanders_is_described_with_its_mass_and_frequency(tmp_path):
    """0.3 per metre about the middle of the screw; the law is written as an effect file and read back as it was."""
    case, answer, before = described("outside:wandering-absorber", "large", 41)
    found, truth = answer.described, case.truth["outside:wandering-absorber"]
    assert (found.place, found.parameter, found.law.variable) == ("table", "frequency_hz", Variable.POSITION)
    assert found.frequency_hz == pytest.approx(truth["frequency_hz"], rel=0.02)
    assert found.mass_kg == pytest.approx(truth["mass_kg"], rel=0.05)
    assert found.parameters["change"].estimate.value / found.law.scale == pytest.approx(0.3, rel=0.05)
    held_out = (gap_of(fitted.comparison, fitted.held_out) for fitted in (before, answer.fitted))
    assert next(held_out) > 5.0 * before.comparison.noise_floor > 5.0 * next(held_out) / 1.2
    (tmp_path / "mine.py").write_text(effect_file_text(found.effects), encoding="utf-8")
    (again,) = read_effect_file(tmp_path / "mine.py")
    assert (again.key, again.name, again.add) == (found.effects[0].key, found.effects[0].name, found.effects[0].add)


def test_what_looks_alike_is_known_by_its_other_place():
    """What hangs on nut or table, and the contacts in series with a bracket; a bearing has no such other."""
    by_field = {quantity.field: quantity for quantity in QUANTITIES}
    for name in ("frequency", "mass"):
        on_nut, on_table = (by_field[f"{place}_absorber_{name}"] for place in ("nut", "table"))
        assert (hung_elsewhere(on_nut), hung_elsewhere(on_table)) == (on_table, on_nut)
    assert contacts_for(by_field["bracket_stiffness"]) == by_field["nut_stiffness"]
    for field in ("bearing_stiffness", "nut_stiffness", "rotor_absorber_frequency"):
        assert hung_elsewhere(by_field[field]) is contacts_for(by_field[field]) is None


@pytest.mark.release
def test_a_nut_that_softens_is_described_at_the_nut():
    _, answer, _ = described("outside:nut-softening", "large", 42)
    found = answer.described
    assert (found.place, found.parameter, found.law.variable) == ("nut", "nut_stiffness_n_per_m", Variable.EXCITATION)
    assert found.parameters[found.law.parameters[0].name].interval_95[1] < 0.0


@pytest.mark.release
def test_what_was_found_does_not_stand_in_the_way_of_a_law_of_the_axis_as_stated():
    """A nut that softens was taken for one whose stiffness is cubic; with both it would soften to nothing."""
    _, baseline, candidates, _ = stated("outside:nut-softening", "large", 42)
    final = fitted_with("cubic-stiffness", baseline, candidates)
    answer = describe(baseline, final, [], None, lambda _sentence: None)  # from these two fits alone
    assert (answer.described.place, answer.described.law.variable) == ("nut", Variable.EXCITATION)
    assert len(answer.described.effects) == 1
    assert [effect.key for effect in answer.fitted.hypothesis.effects] == [answer.described.effects[0].key]


@pytest.mark.release
def test_what_follows_the_excitation_by_a_law_of_its_own_is_asked_before_all_effects_are():
    """Beside a first effect that stands in its way; a preload that drifts is none."""
    _, baseline, candidates, sizes = stated("outside:nut-softening", "large", 42)
    first = fitted_with("preload-exponent", baseline, candidates)
    found = describe_in_place(baseline, first, sizes, lambda _sentence: None)
    assert (found.described.place, found.described.law.variable) == ("nut", Variable.EXCITATION)
    assert found.kept == frozenset()
    _, baseline, candidates, sizes = stated("outside:preload-drift", "large", 42)
    first = fitted_with("preload-exponent", baseline, candidates)
    assert describe_in_place(baseline, first, sizes, lambda _sentence: None) is None


@pytest.mark.release
def test_a_preload_that_drifts_is_described_with_the_order_of_measurement():
    """The rigidity of the nut goes with the cube root of its preload."""
    case, answer, _ = described("outside:preload-drift", "large", 42)
    found, lost = answer.described, case.truth["outside:preload-drift"]["share"]
    assert (found.place, found.parameter, found.law.variable) == ("nut", "nut_stiffness_n_per_m", Variable.ORDER)
    low, high = found.parameters["change"].interval_95
    assert low < (1.0 - lost) ** (1.0 / 3.0) - 1.0 < high


@pytest.mark.release
def test_what_was_found_goes_where_a_law_leaves_nothing_of_it():
    """Warm settings came late, so a preload that drifts was taken for one that follows the temperature as well."""
    _, baseline, candidates, sizes = stated("outside:preload-drift", "large", 42)
    final = fitted_with("thermal-preload", baseline, candidates)
    answer = describe(final, final, candidates, sizes, lambda _sentence: None)  # from this fit alone
    assert answer.described.law.variable is Variable.ORDER
    assert answer.kept == frozenset() == answer.fitted.hypothesis.keys - {answer.described.effects[0].key}


@pytest.mark.release
@pytest.mark.parametrize("seed", [40, 43, 44])
def test_a_coupling_that_cracks_is_described_with_how_much_it_yields_once_a_turn(seed):
    """Its compliance is up to so many times as large where the crack opens, and as stated half a turn on."""
    case, answer, before = described("outside:cracked-coupling", "medium", seed)
    found, share = answer.described, case.truth["outside:cracked-coupling"]["share"]
    assert (found.place, found.parameter) == ("motor", "coupling_stiffness_nm_per_rad")
    assert (found.law.variable, found.law.form) == (Variable.POSITION, Form.YIELDING)
    wave = math.hypot(*(found.parameters[name].estimate.value for name in ("cosine", "sine")))
    assert 2.0 * wave == pytest.approx(share, rel=0.1)
    held_out = (gap_of(fitted.comparison, fitted.held_out) for fitted in (before, answer.fitted))
    assert next(held_out) > 2.0 * before.comparison.noise_floor > 2.0 * next(held_out) / 1.2


@pytest.mark.release
@pytest.mark.parametrize(
    ("kind", "place", "size"),
    [("outside:rotor-absorber", "motor", "inertia_kg_m2"), ("outside:screw-end-absorber", "screw end", "mass_kg")],
)
def test_what_swings_at_a_port_is_described_with_its_size_and_frequency(tmp_path, kind, place, size):
    """No effect of the catalogue hangs there; the plant is of waves, the model in closed form."""
    case, answer, before = described(kind, "large", 41)
    found, truth = answer.described, case.truth[kind]
    assert (found.place, found.parameter, found.law) == (place, "impedance", None)
    assert found.frequency_hz == pytest.approx(truth["frequency_hz"], rel=0.01)
    assert found.parameters[size].estimate.value == getattr(found, size) == pytest.approx(truth[size], rel=0.05)
    held_out = (gap_of(fitted.comparison, fitted.held_out) for fitted in (before, answer.fitted))
    assert next(held_out) > 2.0 * before.comparison.noise_floor > 2.0 * next(held_out) / 1.2
    (tmp_path / "mine.py").write_text(effect_file_text(found.effects), encoding="utf-8")
    assert [again.key for again in read_effect_file(tmp_path / "mine.py")] == [each.key for each in found.effects]


@pytest.mark.release
@pytest.mark.parametrize(
    ("kind", "size", "seed", "place"),
    [
        ("outside:rotor-absorber", "large", 41, "motor"),
        ("outside:rotor-absorber", "small", 43, "motor"),  # all that is left could be a healthy axis
        ("table-absorber", "large", 41, None),
    ],
)
def test_what_was_named_for_swinging_on_the_table_is_sought_at_every_port(kind, size, seed, place):
    """An inertia on the rotor leads its port by far; a mass on the table is left its name."""
    _, baseline, candidates, sizes = stated(kind, size, seed)
    assert (size == "small") is not judged_gap(baseline).exceeds_healthy
    (on_table,) = (effect for effect in candidates if effect.key == "table-absorber")
    found = next(found for found in screen(baseline, [on_table]))
    named = fit(baseline.comparison, baseline.hypothesis.with_effect(on_table), found.starts[0], baseline.fitted)
    answer = describe_elsewhere(named, [baseline], sizes, lambda _sentence: None)
    assert (answer and answer.described.place) == place
    assert answer is None or (answer.fitted.cost < named.cost and answer.kept == frozenset())


@pytest.mark.release
def test_a_screw_that_bends_is_described_with_where_its_modes_lie(tmp_path):
    """The plant has four modes of a beam on two supports, each with its slope at the nut; their shares are found."""
    case, answer, before = described("outside:screw-bending", "large", 41)
    found, truth = answer.described, case.truth["outside:screw-bending"]
    assert (found.place, found.parameter, found.law) == ("screw", "impedance", None)
    assert found.frequency_hz == pytest.approx(truth["frequency_hz"], rel=0.01)
    values = {name: parameter.estimate.value for name, parameter in found.parameters.items()}
    parts, beside = case.axis.parts, truth["eccentricity_m"]
    rigidity = parts.youngs_modulus * math.pi * parts.screw_diameter**4 / 64.0
    compliance = 2.0 * beside**2 * parts.screw_length / (math.pi**2 * rigidity)
    assert values["compliance_m_per_n"] == pytest.approx(compliance, rel=0.03)
    shares = [values[f"share_{n}"] for n in range(2, 6)]
    np.testing.assert_allclose(shares, [1.0 / 4.0, 1.0 / 9.0, 1.0 / 16.0, 0.0], atol=0.01)
    held_out = (gap_of(fitted.comparison, fitted.held_out) for fitted in (before, answer.fitted))
    assert next(held_out) > 5.0 * before.comparison.noise_floor > 5.0 * next(held_out) / 1.2
    (tmp_path / "mine.py").write_text(effect_file_text(found.effects), encoding="utf-8")
    assert [again.key for again in read_effect_file(tmp_path / "mine.py")] == ["at-port:screw"]
    assert "the screw bends under the force in the nut" in described_sentence(found)


@pytest.mark.release
def test_what_follows_no_law_is_said_to_be_there_and_no_more():
    """The nut has 0.7 to 1.4 of its stiffness at each setting, by lot: no law holds, and the values are found."""
    lots = {}

    def by_lot(observations, drive):
        rng, plain = np.random.default_rng(5), ExtendedModel(drive.stated, drive.physics({}))
        changed = []
        for each in observations:
            lot = lots.setdefault(each.conditions, math.exp(rng.uniform(math.log(0.7), math.log(1.4))))
            joints = replace(plain.physics.joints, nut_stiffness=lot * plain.physics.joints.nut_stiffness)
            other = replace(plain, physics=replace(plain.physics, joints=joints))
            now, then = (
                model.frequency_response(
                    each.frequency, each.conditions, excitation=each.excitation, response=each.response_point
                ).response
                for model in (other, plain)
            )
            ratio = now / then
            deviation = each.standard_deviation * np.abs(ratio)
            changed.append(replace(each, response=each.response * ratio, standard_deviation=deviation))
        return changed

    _, _, before = described("none", "medium", 7, by_lot)
    answer = describe_levels(before, before, lambda _sentence: None)
    found = answer.described
    assert answer.fitted is None
    assert found.law is None
    assert found.effects == ()
    assert found.has_no_form
    assert found.place == "nut"
    true = np.array([lots[conditions] for conditions in dict.fromkeys(lots)])
    assert len(found.factors) <= true.size
    assert max(found.factors.values()) / min(found.factors.values()) == pytest.approx(true.max() / true.min(), rel=0.3)


@pytest.mark.release
def test_a_healthy_axis_has_nothing_to_describe():
    """Its settings differ by no more than their tolerances."""
    _, answer, before = described("none", "medium", 7)
    assert answer is None
    assert describe_levels(before, before, lambda _sentence: None) is None
