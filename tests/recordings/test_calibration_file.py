"""The calibration document: public keys, a round trip, and one clear sentence for whatever does not fit."""

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.errors import MonitorCoreError, OutsideValidityError, RecordingFormatError
from monitor_core.modal import PhaseReference
from monitor_core.preload import (
    Calibration,
    ModalReading,
    PreloadEstimate,
    PreloadFeatureCoefficients,
    axial_frequency,
    calibrate,
    estimate_preload,
    expected_frequency,
    minimum_detectable_loss,
)
from monitor_core.preload.verification import verify_calibration
from monitor_core.preload.witnesses import WitnessName
from monitor_core.recording import Conditions, ExcitationQuantity, ExcitationSource, Rejection
from monitor_core.recordings.calibration_file import (
    calibration_document,
    calibration_from_document,
    read_calibration,
    write_calibration,
)
from monitor_core.uncertainty import Estimate
from tests.preload.test_witnesses import calibrated as with_witnesses
from tests.service.sweep import FEW, numbers_in

K = PreloadFeatureCoefficients(-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8)


def calibrated(positions: tuple[float, ...], *, moving_mass: Estimate | None, temperature: bool) -> Calibration:
    rng = np.random.default_rng(30)
    readings = [
        ModalReading(
            axial_frequency(x, p, K) + rng.normal(0.0, 0.2),
            Conditions(x, preload=p, temperature=18.0 + 4.0 * rng.uniform() if temperature else None),
            0.1,
        )
        for x in positions
        for p in (50.0, 100.0, 200.0, 300.0)
    ]
    return calibrate(
        readings,
        weighting="std",
        excitation_source=ExcitationSource.DRIVE if temperature else None,
        excitation_quantity=ExcitationQuantity.TORQUE if temperature else None,
        moving_mass=moving_mass,
        phase_reference=PhaseReference(-1, 2e-4) if temperature else None,
        excitation_level=0.013 if temperature else None,
    )


PLAIN = calibrated((0.25, 0.5, 0.75), moving_mass=None, temperature=False)
FULL = calibrated((0.25, 0.4, 0.5, 0.6, 0.75), moving_mass=Estimate(23.9, 0.5), temperature=True)
_FITTED = with_witnesses(np.random.default_rng(31))
_TWO = (WitnessName.RESIDUE, WitnessName.FRICTION_TORQUE)
WITNESSED = replace(_FITTED, witnesses=tuple(each for each in _FITTED.witnesses if each.name in _TWO))


@pytest.mark.parametrize("calibration", [PLAIN, FULL], ids=["plain", "full"])
def test_what_is_written_is_read_back(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "axis.calibration.json"
    write_calibration(path, calibration)
    back = read_calibration(path)
    assert np.array_equal(back.parameters.values, calibration.parameters.values)
    assert np.array_equal(back.parameters.covariance, calibration.parameters.covariance)
    assert back.parameters.degrees_of_freedom == calibration.parameters.degrees_of_freedom
    for field in fields(Calibration):
        if field.name in ("parameters", "position", "leave_one_position_out"):  # vectors, and millimetres
            continue
        assert getattr(back, field.name) == getattr(calibration, field.name), field.name
    assert (back.position.lower, back.position.upper) == pytest.approx((0.25, 0.75), rel=1e-15)
    assert [e.position for e in back.leave_one_position_out] == pytest.approx(
        [e.position for e in calibration.leave_one_position_out], rel=1e-15
    )


def test_witnesses_and_friction_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "axis.calibration.json"
    calibration = with_witnesses(np.random.default_rng(31))
    write_calibration(path, calibration)
    back = read_calibration(path)
    assert back.friction == calibration.friction
    assert back.between_sessions == calibration.between_sessions == 3e-4
    assert back.payload_stated is calibration.payload_stated is True
    for polarity in (1, -1):
        document = calibration_document(replace(calibration, trace_polarity=polarity))
        assert calibration_from_document(document).trace_polarity == polarity
    with pytest.raises(RecordingFormatError, match=r"trace_polarity: expected 1, -1 or null; got 0\.5"):
        calibration_from_document(calibration_document(calibration) | {"trace_polarity": 0.5})
    assert [w.name for w in back.witnesses] == [w.name for w in calibration.witnesses]
    for read, written in zip(back.witnesses, calibration.witnesses, strict=True):
        assert (read.terms, read.scatter) == (written.terms, written.scatter)
        assert np.array_equal(read.coefficients.values, written.coefficients.values)
        assert np.array_equal(read.coefficients.covariance, written.coefficients.covariance)
        assert read.coefficients.degrees_of_freedom == written.coefficients.degrees_of_freedom


def test_a_calibration_of_an_earlier_version_has_no_witnesses() -> None:
    document = calibration_document(FULL)
    newer = ("witnesses", "friction_coefficient_s2_per_nm", "between_sessions_relative")
    for key in (*newer, "trace_polarity", "payload_stated"):
        del document[key]
    back = calibration_from_document(document)
    assert (back.witnesses, back.friction, back.between_sessions) == ((), None, 0.0)
    assert (back.trace_polarity, back.payload_stated) == (None, False)


@pytest.mark.parametrize("terms", [[], ["constant", "phase of the moon"]], ids=["none", "unknown"])
def test_terms_of_a_witness_are_checked(terms: list[str]) -> None:
    document = json.loads(json.dumps(calibration_document(with_witnesses(np.random.default_rng(31)))))
    document["witnesses"][0]["terms"] = terms
    with pytest.raises(RecordingFormatError, match="terms: expected some of constant, position"):
        calibration_from_document(document)


def test_public_keys_carry_their_units() -> None:
    document = calibration_document(FULL)
    assert document["coefficients"] == dict(
        zip(("k1_s2_per_m2", "k2_s2_per_m", "k3_s2_n13", "k4_s2"), FULL.parameters.values.tolist()[:4], strict=True)
    )
    assert document["residual_rms_hz"] == FULL.residual_rms
    assert document["moving_mass_kg"] == pytest.approx(23.9)
    assert document["minimum_detectable_loss_n"] == minimum_detectable_loss(FULL)
    assert document["valid_range"] == {
        "position_mm": [250.0, 750.0],
        "preload_n": [50.0, 300.0],
        "payload_kg": [0.0, 0.0],
        "temperature_c": [FULL.temperature.lower, FULL.temperature.upper] if FULL.temperature else None,
    }
    json.dumps(document, allow_nan=False)  # finite throughout


def test_unknown_keys_are_left_alone() -> None:
    document = calibration_document(PLAIN) | {"remark": "after the new bearing"}
    assert calibration_from_document(document).residual_rms == PLAIN.residual_rms


def _without(key: str) -> Callable[[dict[str, Any]], object]:
    return lambda d: {k: v for k, v in d.items() if k != key}


def test_what_does_not_fit_is_refused_in_one_sentence(subtests: pytest.Subtests) -> None:
    for spoil, sentence in [
        (lambda d: [d], "expected a JSON object; got list"),
        (lambda d: d | {"format": "preload-session"}, "format: expected 'preload-calibration'"),
        (lambda d: d | {"version": 2}, "version: expected 1; got 2"),
        (_without("coefficients"), "coefficients: expected a JSON object"),
        (lambda d: d | {"coefficients": d["coefficients"] | {"k3_s2_n13": "big"}}, "k3_s2_n13: expected a number"),
        (_without("reproducibility_hz"), "reproducibility_hz: expected a number"),
        (lambda d: d | {"residual_sd_hz": -0.1}, "residual_sd_hz: must not be negative; got -0.1 Hz"),
        (lambda d: d | {"degrees_of_freedom": 0}, "degrees_of_freedom: expected a positive number"),
        (lambda d: d | {"weighting": "heavy"}, "weighting: expected 'none' or 'std'; got 'heavy'"),
        (lambda d: d | {"excitation_source": "motor"}, "excitation_source: expected 'sensor' or 'drive'"),
        (lambda d: d | {"covariance": d["covariance"][:3]}, "covariance: expected 6 rows"),
        (
            lambda d: d | {"covariance": [row[:4] for row in d["covariance"]]},
            "covariance: expected a list of 6 numbers",
        ),
        (lambda d: d | {"covariance": (-np.array(d["covariance"])).tolist()}, "without negative variances"),
        (lambda d: d | {"covariance_order": d["covariance_order"][:4]}, "covariance_order: expected k1_s2_per_m2"),
        (lambda d: d | {"declared": ["payload"]}, "declared: expected some of"),
        (lambda d: d | {"valid_range": d["valid_range"] | {"preload_n": [300, 50]}}, r"expected \[lower, upper\]"),
        (lambda d: d | {"valid_range": d["valid_range"] | {"position_mm": 250}}, "position_mm: expected a list"),
        (lambda d: d | {"phase_reference": {"polarity": 2, "delay_s": 0.0}}, r"polarity must be \+1 or -1; got 2"),
        (lambda d: d | {"n_readings": 17.5}, "n_readings: expected a whole number"),
        (lambda d: d | {"coefficients": d["coefficients"] | {"k3_s2_n13": -1e-5}}, "k3 must be positive"),
    ]:
        with subtests.test(spoil=spoil, sentence=sentence):
            with pytest.raises(RecordingFormatError, match=sentence) as refusal:
                calibration_from_document(spoil(calibration_document(FULL)), "axis.json")
            assert str(refusal.value).startswith("axis.json")
            assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("text", ["{", "", "\xff\xfe", "NaN", '{"format": NaN}', "[" * 100_000])
def test_what_is_no_document_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "axis.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(RecordingFormatError, match=r"axis\.json"):
        read_calibration(path)


def test_a_declared_parameter_stays_declared() -> None:
    back = calibration_from_document(calibration_document(FULL))
    assert back.declared == ("inverse_moving_mass",)
    fitted = replace(FULL, declared=(), moving_mass_dof=4.0)
    assert fitted.parameter("inverse_moving_mass") != back.parameter("inverse_moving_mass")


@pytest.mark.release
def test_whatever_number_is_written_it_is_refused_or_answers(subtests: pytest.Subtests) -> None:
    """Each number alone, and an answer where the law does not look: in the middle, with witnesses off by a tenth."""
    for pointer, place in numbers_in(document := json.loads(json.dumps(calibration_document(WITNESSED)))):
        with subtests.test(".".join(map(str, pointer))):
            stated = place[pointer[-1]]
            for value in (0.0, *FEW):
                place[pointer[-1]] = value
                try:
                    back = calibration_from_document(document)
                    verify_calibration(back)
                except MonitorCoreError:
                    continue
                middle = Conditions(0.5 * (back.position.lower + back.position.upper), preload=back.preload.upper)
                frequency = Estimate(expected_frequency(back, middle), 0.1)
                setting = back.setting(middle, back.preload.upper)
                off = {witness.name: 1.1 * witness.expected(setting) for witness in back.witnesses}
                assert isinstance(estimate_preload(frequency, middle, back, witnesses=off), PreloadEstimate | Rejection)
            place[pointer[-1]] = stated


def test_what_is_fixed_has_no_covariance() -> None:
    document = json.loads(json.dumps(calibration_document(PLAIN)))
    fixed = document["covariance"]
    for i in range(4):
        fixed[0][i] = fixed[i][0] = 0.0
    assert calibration_from_document(document).parameters.standard_uncertainties[0] == 0.0
    fixed[0][1] = fixed[1][0] = 1e-15
    with pytest.raises(RecordingFormatError, match="without negative variances; got correlations"):
        calibration_from_document(document)


def test_numbers_that_cannot_be_together_are_refused_with_what_is_expected(tmp_path: Path) -> None:
    document = json.loads(json.dumps(calibration_document(PLAIN)))
    document["coefficients"]["k4_s2"] = 1e300
    (tmp_path / "axis.json").write_text(json.dumps(document))
    with pytest.raises(RecordingFormatError, match=r"axis.json: expected .* at 250 mm and 50 N .*; got .*feature"):
        read_calibration(tmp_path / "axis.json")
    stored = calibration_from_document(document)  # one that is stored already stays readable
    with pytest.raises(OutsideValidityError, match="expected a calibration that answers"):
        calibration_document(stored)
