"""Why a measurement has its value, by the API: gates with limits, ladder, whole response, other calibrations."""

import dataclasses
import re
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.recordings.calibration_file import calibration_from_document
from service.documents.stored_measurement import StoredMeasurement
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.operations.monitoring.evidence import _stored_gates
from service.web import measurement as measurement_page
from tests.browser.states import CONFIGURATION, HEALTHY, WORN, measure, measurement
from tests.service.conftest import START, Api, running_service, simulated_measurement


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """Serve an axis with a baseline, a worn measurement and one that is noise only."""
    with running_service(tmp_path_factory.mktemp("evidence") / "var") as api:
        api.register("axis", **CONFIGURATION)
        api.calibrate("axis")
        measure(api, "axis", range(9), HEALTHY)
        measure(api, "axis", range(9, 10), WORN)
        rng = np.random.default_rng(1)
        api.accept("axis", [
            dataclasses.replace(window, response=rng.normal(0.0, 1.0, window.n_samples))
            for window in measurement("axis", 20, WORN)
        ])  # fmt: skip
        yield api


def numbers(api: Api) -> tuple[int, int]:
    """Return the worn measurement and the refused one."""
    *_, worn, refused = api.trend("axis")
    return worn["measurement_id"], refused["measurement_id"]


def get(api: Api, number: int, part: str = "") -> dict:
    answer = api.http.get(f"/v1/axes/axis/measurements/{number}{part}")
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_each_gate_has_value_and_limit(measured: Api) -> None:
    gates = {gate["gate"]: gate for gate in get(measured, numbers(measured)[0])["gates"]}
    assert list(gates)[:3] == ["no-peak-in-band", "low-coherence", "too-few-averages"]
    assert all(gate["passed"] for gate in gates.values())
    said = get(measured, numbers(measured)[0])["outcome"]
    assert gates["low-coherence"] | {"value": said["coherence"], "lower": 0.5} == gates["low-coherence"]
    assert gates["no-peak-in-band"]["lower"] < said["frequency_hz"] < gates["no-peak-in-band"]["upper"]
    assert gates["uncertain-frequency"]["upper"] == pytest.approx(0.003 * said["frequency_hz"])


def test_what_joined_the_uncertainty_behind_the_gate_fails_no_gate(measured: Api) -> None:
    (listed, *_) = measured.http.get("/v1/axes/axis/calibrations").json()["calibrations"]
    document = measured.http.get(f"/v1/axes/axis/calibrations/{listed['id']}").json()["document"]
    calibration = calibration_from_document(document)
    said = get(measured, numbers(measured)[0])["outcome"]
    for of_frequency, is_told in ((0.002, True), (0.0035, False)):  # the gate's limit lies between
        said["frequency_standard_uncertainty_hz"] = of_frequency * said["frequency_hz"]
        gates = _stored_gates(StoredMeasurement.model_validate(said), AxisConfiguration(**CONFIGURATION), calibration)
        assert (gates is not None) == is_told  # else the waveforms are asked, as the gate was
        assert all(gate.passed for gate in gates or ())


def test_a_refused_measurement_names_its_gate(measured: Api) -> None:
    told = get(measured, numbers(measured)[1])
    assert told["outcome"]["refused"]
    assert told["ladder"] is None
    failed = [gate["gate"] for gate in told["gates"] if not gate["passed"]]
    assert failed in ([], [told["outcome"]["reason"]])


def test_the_ladder_leads_to_the_preload(measured: Api) -> None:
    told = get(measured, numbers(measured)[0])
    ladder, said = told["ladder"], told["outcome"]
    taken = ("payload_s2", "temperature_s2", "quadratic_s2", "linear_s2", "constant_s2", "friction_s2")
    assert ladder["inverse_square_s2"] - sum(ladder[name] for name in taken) == pytest.approx(ladder["feature_s2"])
    assert ladder["inverse_square_s2"] == pytest.approx(said["frequency_hz"] ** -2)
    assert ladder["preload_n"] == pytest.approx(said["preload_n"], rel=1e-9)
    assert sum(said["variance_shares"].values()) == pytest.approx(1.0)


def test_the_response_is_whole_and_stands_over_that_of_the_baseline(measured: Api) -> None:
    found = get(measured, numbers(measured)[0], "/evidence")
    low, high = found["band_hz"]
    measured_lines, baseline = found["response"], found["baseline_response"]
    assert measured_lines["frequency_hz"][0] < 0.5 * low
    assert measured_lines["frequency_hz"][-1] > 2.0 * high
    assert baseline["frequency_hz"] == measured_lines["frequency_hz"]
    assert found["n_baseline"] == 8

    def peak(response: dict) -> float:
        size = np.abs(np.array(response["real"]) + 1j * np.array(response["imaginary"]))
        inside = (np.array(response["frequency_hz"]) >= low) & (np.array(response["frequency_hz"]) <= high)
        return float(np.array(response["frequency_hz"])[inside][np.argmax(size[inside])])

    assert peak(measured_lines) < peak(baseline)  # it is worn


def test_the_calibration_that_judged_says_the_same_of_the_same_windows(measured: Api) -> None:
    number = numbers(measured)[0]
    own = get(measured, number)["outcome"]
    (only,) = get(measured, number, "/evidence")["judgements"]
    assert only["calibration"] == own["calibration"]
    assert only["preload_n"] == pytest.approx(own["preload_n"])


def test_where_waveforms_are_gone_the_evidence_says_so(tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        api.register("axis", **CONFIGURATION)
        api.calibrate("axis")
        measure(api, "axis", range(1))
        number = api.trend("axis")[0]["measurement_id"]
        for path in (tmp_path / "var" / "raw").rglob("*"):
            if path.is_file():
                path.unlink()
    with running_service(tmp_path / "var") as api:
        found = get(api, number, "/evidence")
        assert (found["response"], found["baseline_response"], found["judgements"]) == (None, None, [])
        told = get(api, number)
        assert all(gate["passed"] for gate in told["gates"])  # of what is stored with the value
        assert api.http.get(f"/axes/axis/measurements/{number}", headers={"accept": "text/html"}).status_code == 200


def test_every_other_measurement_is_there_to_compare_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of its own and one whose preload was set on purpose; then more than the list holds."""
    rng = np.random.default_rng(7)
    with running_service(tmp_path / "var") as api:
        api.register("axis", **CONFIGURATION)
        api.calibrate("axis")

        def taken(day: int, set_preload: float | None) -> None:
            at = START + timedelta(days=day)
            api.accept("axis", simulated_measurement(
                rng, f"m{day}", n_windows=4, started_at=at, set_preload=set_preload
            ))  # fmt: skip

        taken(0, None)
        taken(1, 250.0)
        own, on_purpose = (point["measurement_id"] for point in api.trend("axis"))
        address = f"/axes/axis/measurements/{own}"
        (listed,) = re.findall(r'<option value="(\d+)">(.*)</option>', api.http.get(address).text)
        assert int(listed[0]) == on_purpose
        assert listed[1].endswith("set to 250 N")
        monkeypatch.setattr(measurement_page, "MOST_SHOWN", 1)
        taken(2, None)
        taken(3, None)
        page = api.http.get(address, params={"with": on_purpose}).text
        assert re.findall(r'<option value="(\d+)" selected>', page) == [str(on_purpose)]
