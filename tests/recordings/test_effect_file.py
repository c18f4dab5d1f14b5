"""Effects of a user's own: the file in the module's text is found and composes; what is no such file is refused."""

from dataclasses import replace
from textwrap import dedent

import numpy as np
import pytest

from monitor_core.effects import DRIVE_EFFECTS
from monitor_core.errors import RecordingFormatError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.models.extended import ExtendedModel
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings import effect_file
from monitor_core.recordings.effect_file import read_effect_file
from monitor_core.recordings.model_file import read_model_file
from tests.conftest import PROJECT_ROOT

HYBRID = read_model_file(PROJECT_ROOT / "replay_data" / "models" / "hybrid.toml")
#: The code block of the module's own text.
EXAMPLE = dedent(effect_file.__doc__.partition("code-block:: python\n")[2].partition("\nThe file is run")[0])


def read(tmp_path, text):
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    return read_effect_file(tmp_path / "mine.py")


def test_an_effect_of_a_users_own_joins_the_table(tmp_path):
    """A handwheel of 2e-4 kg·m² is a rotor with so much more inertia."""
    effects = (*DRIVE_EFFECTS, *read(tmp_path, EXAMPLE))
    file = AxisDescription("hybrid", HYBRID.parameters, effects={"handwheel": {"inertia_kg_m2": 2e-4}})
    parameters = HYBRID.build().parameters
    expected = ExtendedModel.of(replace(parameters, motor_inertia=parameters.motor_inertia + 2e-4))
    band, at = np.geomspace(5.0, 900.0, 50), DriveConditions(0.3)
    points = {"excitation": ExcitationPoint.TORQUE_AT_MOTOR, "response": ResponsePoint.ANGLE_AT_MOTOR}
    np.testing.assert_allclose(
        file.build(effects).frequency_response(band, at, **points).response,
        expected.frequency_response(band, at, **points).response,
        rtol=1e-12,
    )


BAD = {
    "empty": ("", "expected a recording; the file is empty (0 bytes)"),
    "no Python": ("EFFECTS = (", "expected a Python file of effects; got SyntaxError: '(' was never closed"),
    "fails": ("1 / 0", "expected a Python file of effects; got ZeroDivisionError: division by zero"),
    "an effect that cannot be": (EXAMPLE.replace("scale=1e-4", "scale=1.0"), "the scale of inertia_kg_m2 must lie"),
    "a key that cannot be": (EXAMPLE.replace('"handwheel"', '"Hand wheel"'), "lower-case letters, digits and dashes"),
    "two parameters of one name": (EXAMPLE.replace("1e-4),", "1e-4),) * 2 + ("), "parameters with different names"),
    "nothing": ("x = 1", "expected a definition of EFFECTS, a tuple of effects; it is missing"),
    "no tuple": ("EFFECTS = 3", "expected EFFECTS to be a tuple of at least one; got 3"),
    "empty tuple": ("EFFECTS = ()", "expected EFFECTS to be a tuple of at least one; got ()"),
    "no effects": ("EFFECTS = (3,)", "expected effects in EFFECTS; number 1 is of type int"),
    "twice": (EXAMPLE + "\nEFFECTS *= 2\n", "expected effects with different keys; got handwheel, handwheel"),
}


def test_what_defines_no_effects_gets_one_sentence(tmp_path, subtests):
    for what, (text, sentence) in BAD.items():
        with subtests.test(what=what):
            with pytest.raises(RecordingFormatError) as caught:
                read(tmp_path, text)
            assert sentence in str(caught.value)
            assert str(caught.value).startswith("mine.py: ")
            assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(RecordingFormatError, match=r"none\.py: expected a file; nothing is at this path"):
        read_effect_file(tmp_path / "none.py")
