"""``preload explain --healthy``: what a model is wrong in on healthy machines of the same type is no finding."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveModel
from monitor_core.recordings.motion_csv import write_motion_record
from tests.models.simulated_motion import Truth, simulated_record
from tests.service.test_cli import assert_refused
from tests.service.test_cli_explain import (
    MOTION,
    TABLE2,
    TIAN,
    UNCERTAIN,
    changed,
    frf_file,
    measured,
    model_in,
    value_of,
)

FORM = 0.006  # of each line; the product counts on a quarter of it where nothing was learnt
FAR = "far_bearing_stiffness_n_per_m"


def machine(axis: DriveModel, seed: int) -> list[FrequencyResponseObservation]:
    """Measure an axis three times; the model misses it by its form, at all positions alike."""
    observations = [observation for day in range(3) for observation in measured(axis, seed + 100 * day)]
    off = FORM * np.random.default_rng([seed, 3]).standard_normal((2, observations[0].frequency.size))
    factor = np.exp(off[0] + 1j * off[1])
    return [replace(observation, response=observation.response * factor) for observation in observations]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with healthy machines of a type, a machine of it, and one whose far bearing is stiffer."""
    folder = tmp_path_factory.mktemp("healthy")
    for name in ("healthy", "empty"):
        (folder / name).mkdir()
    (folder / "healthy" / "notes.txt").write_text("not looked at", encoding="utf-8")
    for seed in (10, 11, 12):
        frf_file(folder / "healthy" / f"machine{seed}.frf.h5", machine(TIAN.build(), seed))
    frf_file(folder / "sound.frf.h5", machine(TIAN.build(), 1))
    stiffer = changed(TIAN, **{FAR: 1.3 * TIAN.parameters[FAR]})
    frf_file(folder / "stiffer.frf.h5", machine(stiffer.build(), 1))
    model_in(folder / "type.toml", replace(TIAN, uncertain=UNCERTAIN))
    write_motion_record(folder / "motion.csv", simulated_record(Truth(coulomb=20.0)))
    model_in(folder / "motion.toml", MOTION)
    return folder


@pytest.mark.release
def test_form_of_the_type_is_no_finding(preload: Any, inputs: Path) -> None:
    words = ("explain", inputs / "sound.frf.h5", "--baseline", inputs / "type.toml", "--json")
    assert preload(*words).json()["outcome"] == "unknown"
    beside = preload(*words, "--healthy", inputs / "healthy").json()
    assert (beside["outcome"], beside["effects"]) == ("none", [])


@pytest.mark.release
def test_what_one_machine_has_beyond_it_is_named(preload: Any, inputs: Path) -> None:
    words = ("explain", inputs / "stiffer.frf.h5", "--baseline", inputs / "type.toml", "--json")
    files = [word for path in sorted((inputs / "healthy").glob("*.h5")) for word in ("--healthy", path)]
    document = preload(*words, *files).json()
    assert document["outcome"] == "named"
    found = value_of(document, "far-bearing-stiffness", "stiffness_n_per_m")
    assert found["value"] == pytest.approx(0.3 * TIAN.parameters[FAR], abs=3.0 * found["standard_uncertainty"])


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("sound.frf.h5", "--baseline", "type.toml", "--healthy", "none"), "'none' does not exist"),
        (
            ("sound.frf.h5", "--baseline", "type.toml", "--healthy", "empty"),
            "--healthy empty: expected files of responses",
        ),
        (
            ("sound.frf.h5", "--baseline", "type.toml", "--healthy", "motion.csv"),
            "--healthy motion.csv: expected a set of",
        ),
        (("motion.csv", "--baseline", "motion.toml", "--healthy", "healthy"), "for frequency responses; got a motion"),
        ((TABLE2, "--baseline", "type.toml", "--healthy", "healthy"), "for frequency responses; got peaks to explain"),
    ],
)
def test_bad_input_is_one_line(
    preload: Any, inputs: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[Any, ...], complaint: str
) -> None:
    monkeypatch.chdir(inputs)
    assert_refused(preload("explain", *words), complaint)


def test_help_names_it(preload: Any) -> None:
    assert "--healthy DATA" in preload("explain", "--help").out
