"""Drive-model files: what is written is read back, and what does not fit is refused with one sentence."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from monitor_core.errors import OutsideValidityError, RecordingFormatError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.models.extended import ExtendedModel
from monitor_core.models.families import FAMILIES
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings.model_file import model_file_text, read_model_file, write_model_file
from tests.conftest import PROJECT_ROOT

MODELS = PROJECT_ROOT / "replay_data" / "models"
HYBRID = read_model_file(MODELS / "hybrid.toml")
TEXT = (MODELS / "hybrid.toml").read_text(encoding="utf-8")


def read(tmp_path, text):
    (tmp_path / "drive.toml").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_model_file(tmp_path / "drive.toml")


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_every_family_has_a_file_that_can_be_built(family):
    model = read_model_file(MODELS / f"{family.name}.toml")
    assert model.family == family.name
    assert isinstance(model.build().parameters, family.parameters)


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_what_is_written_is_read_back(tmp_path, family):
    model = read_model_file(MODELS / f"{family.name}.toml")
    write_model_file(tmp_path / "copy.toml", model)
    assert read_model_file(tmp_path / "copy.toml") == model


@pytest.mark.release
@given(
    mass=st.floats(1e-30, 1e30),
    share=st.floats(1e-12, 1e6),
    value=st.floats(allow_nan=False, allow_infinity=False),
    key=st.from_regex(r"[A-Za-z0-9_.:-]{1,20}", fullmatch=True),
)
def test_every_number_and_every_key_survives_to_the_last_bit(tmp_path_factory, mass, share, value, key):
    model = AxisDescription(
        "hybrid",
        dict(HYBRID.parameters) | {"table_mass_kg": mass},
        {"table_mass_kg": share},
        {key: {"value_si": value}, "wrong-parameter:table_mass_kg": {}},
    )
    path = tmp_path_factory.mktemp("model") / "copy.toml"
    write_model_file(path, model)
    assert read_model_file(path) == model


def test_tables_of_a_simulation_survive_a_round_trip(tmp_path):
    model = read_model_file(MODELS / "speed-loop.toml")
    assert model.simulation["speed-loop"]["sampling_time_s"] == 1.25e-4
    write_model_file(tmp_path / "copy.toml", model)
    assert read_model_file(tmp_path / "copy.toml") == model


def test_uncertain_parameters_and_effects_are_kept_as_read(tmp_path):
    model = read(
        tmp_path,
        TEXT
        + "[uncertain]\nbearing_stiffness_n_per_m = 0.2\n"
        + '[effects.far-bearing-stiffness]\nstiffness_n_per_m = 38000000\n[effects."wrong-parameter:x"]\n',
    )
    assert model.uncertain == {"bearing_stiffness_n_per_m": 0.2}
    assert model.effects == {"far-bearing-stiffness": {"stiffness_n_per_m": 3.8e7}, "wrong-parameter:x": {}}


WITH_EFFECTS = AxisDescription(
    "hybrid",
    HYBRID.parameters,
    effects={
        "added-mass": {"mass_kg": 1.0},
        "second-mode": {"residue_per_kg": 1e-3, "frequency_hz": 300.0, "damping_ratio": 0.02},
        "wrong-parameter:nut_stiffness_n_per_m": {"ln_ratio": -0.3},
    },
)


def accelerance(model, **conditions):
    return model.frequency_response(
        np.geomspace(10.0, 800.0, 60),
        DriveConditions(0.3, **conditions),
        excitation=ExcitationPoint.TORQUE_AT_MOTOR,
        response=ResponsePoint.ACCELERATION_AT_TABLE,
    ).response


def test_effects_of_the_file_are_part_of_the_model():
    heavier = AxisDescription("hybrid", HYBRID.parameters, effects={"added-mass": {"mass_kg": 1.0}}).build()
    stated = ExtendedModel.of(HYBRID.build().parameters)
    np.testing.assert_allclose(accelerance(heavier), accelerance(stated, payload_mass=1.0), rtol=1e-12)


def test_a_model_with_effects_predicts_the_same_after_a_round_trip(tmp_path):
    write_model_file(tmp_path / "copy.toml", WITH_EFFECTS)
    copy = read_model_file(tmp_path / "copy.toml").build()
    np.testing.assert_array_equal(accelerance(copy), accelerance(WITH_EFFECTS.build()))
    assert not np.allclose(accelerance(copy), accelerance(HYBRID.build()), rtol=1e-2)


BAD_EFFECTS = {
    "unknown": ({"mass": {"mass_kg": 1.0}}, "one of added-mass, payload-mass, "),
    "unknown, with a list": (
        {"mass": {"mass_kg": 1.0}},
        "wrong-parameter:<parameter>; got 'mass'",
    ),
    "unknown value": ({"added-mass": {"mass": 1.0}}, "added-mass has the parameters mass_kg; got mass"),
    "no value": ({"added-mass": {}}, "added-mass has the parameters mass_kg; got none"),
    "no such thing": ({"preload-exponent": {"exponent_change": 0.1}}, "preload-exponent does not apply"),
    "not possible": ({"guide-friction": {"friction_n": -1.0}}, "guide-friction: guide_friction must be finite and not"),
    "wrong of nothing": ({"wrong-parameter:nut_mass_kg": {"ln_ratio": 0.1}}, "; got 'nut_mass_kg'"),
    "wrong of zero": ({"wrong-parameter:table_damping_ns_per_m": {"ln_ratio": 0.1}}, "states and that is not zero: "),
}


@pytest.mark.parametrize("what", BAD_EFFECTS)
def test_an_effect_that_does_not_fit_gets_one_sentence(what):
    effects, sentence = BAD_EFFECTS[what]
    with pytest.raises(OutsideValidityError) as caught:
        AxisDescription("hybrid", HYBRID.parameters, effects=effects).build()
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def without(name):
    return "\n".join(line for line in TEXT.splitlines() if not line.startswith(name))


def with_value(name, value):
    return without(name) + f"\n{name} = {value}\n"


BAD = {
    "no TOML": ("family = ", "drive.toml: expected a drive model in TOML; "),
    "no text": (b'family = "hybrid\xff"', "drive.toml: expected UTF-8 text"),
    "no family": (without("family"), "drive.toml, family: expected a text; it is missing"),
    "family of a wrong type": ("family = 3\n" + without("family"), "drive.toml, family: expected a text; got int 3"),
    "unknown family": (TEXT.replace('"hybrid"', '"spring"'), "drive.toml, family: family must be one of lumped"),
    "a drive called a motion": (TEXT.replace('"hybrid"', '"motion"'), "[parameters]: a motion model has no parameter "),
    "motion without a mass": ('family = "motion"\n[parameters]\nviscous_friction_ns_per_m = 3', "needs moving_mass_kg"),
    "no parameters": ('family = "hybrid"', "drive.toml, parameters: expected a table [parameters]; it is missing"),
    "parameters of a wrong type": ('family = "hybrid"\nparameters = 3', "expected a table [parameters]; got int 3"),
    "unknown table": (TEXT + "[motor]\n", "only effects, family, parameters, simulation, uncertain; got 'motor'"),
    "missing parameter": (without("table_mass_kg"), "drive.toml [parameters]: a hybrid model needs table_mass_kg"),
    "unknown parameter": (TEXT + "mass_kg = 3\n", "drive.toml [parameters]: a hybrid model has no parameter mass_kg"),
    "unit left out": (with_value("table_mass", "3"), "no parameter table_mass;"),
    "of another family": (TEXT + "nut_damping_ns_per_m = 3\n", "has no parameter nut_damping_ns_per_m"),
    "text": (with_value("table_mass_kg", '"ten"'), "table_mass_kg: expected a number [SI]; got str 'ten'"),
    "truth value": (with_value("table_mass_kg", "true"), "table_mass_kg: expected a number [SI]; got bool True"),
    "list": (with_value("table_mass_kg", "[1.0]"), "table_mass_kg: expected a number [SI]; got list [1.0]"),
    "not a number": (with_value("table_mass_kg", "nan"), "table_mass_kg: expected a finite number; got nan SI"),
    "infinite": (with_value("table_mass_kg", "inf"), "table_mass_kg: expected a finite number; got inf SI"),
    "negative": (with_value("table_mass_kg", "-1"), "table_mass_kg must be positive and finite; got -1.0 kg"),
    "twice": (TEXT + "table_mass_kg = 3\ntable_mass_kg = 3\n", "expected a drive model in TOML"),
    "uncertain is no table": ("uncertain = 1\n" + TEXT, "expected a table [uncertain]; got int 1"),
    "uncertain of nothing": (TEXT + "[uncertain]\nmass_kg = 0.1", "drive.toml [uncertain]: expected only "),
    "uncertain not stated": (TEXT + "[uncertain]\nbracket_stiffness_n_per_m = 0.1", "got 'bracket_stiffness_n_per_m'"),
    "uncertain about zero": (
        TEXT.replace("loss_factor = 0.053", "loss_factor = 0.0") + "[uncertain]\nloss_factor = 0.2",
        "[uncertain], loss_factor: expected a parameter that is not zero",
    ),
    "uncertain by zero": (
        TEXT + "[uncertain]\ntable_mass_kg = 0",
        "drive.toml [uncertain], table_mass_kg: expected a positive number; got 0.0 -",
    ),
    "effect is no table": (TEXT + "[effects]\nadded-mass = 3", "expected a table [added-mass]; got int 3"),
    "effect with a text": (
        TEXT + '[effects.added-mass]\nmass_kg = "much"',
        "drive.toml [effects] [added-mass], mass_kg: expected a number [SI]; got str 'much'",
    ),
    "effect with an odd name": (TEXT + '[effects."a b"]', "expected a name of letters, digits and _ . : -; got 'a b'"),
}  # fmt: skip


def test_a_bad_file_gets_one_sentence(tmp_path, subtests):
    for what, (text, sentence) in BAD.items():
        with subtests.test(what=what):
            with pytest.raises(RecordingFormatError) as caught:
                read(tmp_path, text)
            assert sentence in str(caught.value)
            assert str(caught.value).startswith("drive.toml")
            assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(RecordingFormatError, match=r"none\.toml: expected a file; nothing is at this path"):
        read_model_file(tmp_path / "none.toml")


@pytest.mark.parametrize(
    "model",
    [
        AxisDescription("hybrid", {}),
        AxisDescription("hybrid", HYBRID.parameters, {"mass_kg": 0.1}),
        AxisDescription("hybrid", HYBRID.parameters, effects={"a\nb": {}}),
        AxisDescription("hybrid", HYBRID.parameters, effects={"a": {"b": float("nan")}}),
    ],
)
def test_what_could_not_be_read_back_is_not_written(model):
    with pytest.raises(RecordingFormatError, match="drive model"):
        model_file_text(model)
