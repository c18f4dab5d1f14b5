"""The bundled example is what the plant gives, what is hidden in it is found, and the README says so."""

import re
import tomllib

import numpy as np
import pytest

from monitor_core.recordings.frf_set import read_frf_set
from tests.hidden_effects.write_example import (
    FOLDER,
    HIDDEN,
    NAME,
    PICTURE,
    PROJECT,
    drawn,
    example,
    explained,
    truth_text,
)

pytestmark = pytest.mark.release  # an explanation is in `make test` with the tests of the search


@pytest.fixture(scope="module")
def explanation():
    return explained()


def test_files_are_small_and_what_the_plant_gives() -> None:
    case = example()
    assert sum(file.stat().st_size for file in FOLDER.iterdir()) < 2e5
    assert (FOLDER / "truth.toml").read_text(encoding="utf-8") == truth_text(case)
    assert (FOLDER / f"{NAME}.toml").read_text(encoding="utf-8") == case.baseline
    stored = read_frf_set(FOLDER / f"{NAME}.frf.h5").observations
    for observation, frf in zip(stored, case.measured, strict=True):
        np.testing.assert_allclose(observation.response, frf.response, rtol=1e-9)


def test_what_is_hidden_is_found_with_its_size(explanation) -> None:
    truth = tomllib.loads((FOLDER / "truth.toml").read_text(encoding="utf-8"))["effects"]
    assert explanation.outcome == "named"
    assert [effect.key for effect in explanation.effects] == [HIDDEN] == list(truth)
    (effect,) = explanation.effects
    for name, value in truth[HIDDEN].items():
        found = effect.parameters[name]
        assert abs(found.estimate.value - value) < 3.0 * found.estimate.standard_uncertainty, name
    assert explanation.gap.after.held_out < 1.05 * explanation.gap.noise_floor < explanation.gap.before.held_out


def test_readme_states_truth_and_estimate(explanation) -> None:
    """In the digits that are printed; another processor may round the last one otherwise."""
    (effect,) = explanation.effects
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| (mass|frequency|damping ratio) \| ([\d.]+).*?\| ([\d.]+) ± ([\d.]+)", text, flags=re.MULTILINE
    )
    truth = tomllib.loads((FOLDER / "truth.toml").read_text(encoding="utf-8"))["effects"][HIDDEN]
    assert len(rows) == len(truth) == 3
    for (_, true, found, uncertainty), (name, value) in zip(rows, truth.items(), strict=True):
        estimate = effect.parameters[name].estimate
        assert float(true) == pytest.approx(value, rel=1e-3)
        assert float(found) == pytest.approx(estimate.value, rel=1e-3)
        assert float(uncertainty) == pytest.approx(estimate.standard_uncertainty, rel=0.3)


def test_picture_of_the_readme_is_that_of_the_report(explanation) -> None:
    stored, now = PICTURE.read_text(encoding="utf-8"), drawn(explanation)
    assert re.sub(r"[\d.]+", "", stored) == re.sub(r"[\d.]+", "", now)
    assert f"docs/figures/{PICTURE.name}" in (PROJECT / "README.md").read_text(encoding="utf-8")
