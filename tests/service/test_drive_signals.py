"""Windows of a control over HTTP: current and scale in, a frequency out; what does not fit is refused in a sentence."""

import base64
from dataclasses import replace
from datetime import timedelta

import msgpack
import numpy as np
import pytest

import preload_client.routes
from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.recording import Conditions, ExcitationQuantity, ExcitationSource, ResponseQuantity, Window
from service.cli.remote.client import window_document
from tests.plant.drive import Drive, quantised, run
from tests.plant.speed_loop import SpeedLoop
from tests.service.conftest import START, Api

DRIVE = Drive(damping=5e-5)
PLACE, PRELOAD = 0.4, 200.0


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    rng = np.random.default_rng(12)
    log = run(DRIVE, PLACE, PRELOAD, n_windows=6, n_samples=2000, rng=rng, disturbance=1.0)
    # counts from the end of the guide, where single precision would leave 30 nm
    scale = quantised(0.5 + log.table, 1e-8, rng)
    return [
        Window(current, table, DRIVE.sample_rate, START + timedelta(seconds=3 * k), Conditions(PLACE), "log",
               ExcitationQuantity.CURRENT, ExcitationSource.DRIVE, position_span=1e-3,
               response_quantity=ResponseQuantity.DISPLACEMENT, response_resolution=1e-8)
        for k, (current, table) in enumerate(zip(log.current, scale, strict=True))
    ]  # fmt: skip


def test_current_and_scale_are_posted_judged_and_shown(shared_api: Api, windows: list[Window]) -> None:
    shared_api.register("cnc", search_band_hz=[90, 220])
    body = {"windows": [window_document(window) for window in windows], "complete": True}
    answer = shared_api.http.post(
        "/v1/axes/cnc/windows", content=msgpack.packb(body), headers={"content-type": "application/msgpack"}
    )
    assert answer.status_code == 201, answer.text
    assert answer.json()["accepted"] == len(windows)
    (outcome,) = answer.json()["measurements"]
    assert not outcome["refused"]
    (point,) = shared_api.trend("cnc")
    truth = DRIVE.poles(PLACE, PRELOAD)[0]
    assert point["frequency_hz"] == pytest.approx(truth, abs=4.0 * outcome["frequency_standard_uncertainty_hz"])
    assert outcome["frequency_standard_uncertainty_hz"] < 1e-3 * truth
    page = shared_api.http.get(f"/axes/cnc/measurements/{point['measurement_id']}")
    assert page.status_code == 200
    assert "Displacement, m" in page.text
    assert "Current, A" in page.text
    table = shared_api.http.get(
        f"/v1/axes/cnc/measurements/{point['measurement_id']}/windows", params={"format": "csv"}
    ).text
    assert table.splitlines()[0] == "window,time_s,current_a,displacement_m"


def test_a_reference_is_posted_kept_and_used(shared_api: Api) -> None:
    """The friction of the motor moves H1 by a hertz; what is answered is what the core says with the reference."""
    drive = Drive(damping=1.5e-4)
    reference, current, table = SpeedLoop(drive).logged(
        PLACE, PRELOAD, n_windows=24, n_samples=2000, rng=np.random.default_rng(5), commanded=1.0, friction=0.15
    )
    windows = [
        Window(u.astype("f4"), y, DRIVE.sample_rate, START + timedelta(seconds=3 * k), Conditions(PLACE), "log",
               ExcitationQuantity.CURRENT, ExcitationSource.DRIVE, reference=r.astype("f4"),
               response_quantity=ResponseQuantity.DISPLACEMENT, response_resolution=1e-10)
        for k, (u, y, r) in enumerate(zip(current, table, reference, strict=True))
    ]  # fmt: skip
    shared_api.register("loop", search_band_hz=[90, 220])
    body = {"windows": [window_document(window) for window in windows], "complete": True}
    answer = shared_api.http.post(
        "/v1/axes/loop/windows", content=msgpack.packb(body), headers={"content-type": "application/msgpack"}
    )
    (outcome,) = answer.json()["measurements"]
    assert not outcome["refused"], outcome
    of_core, by_h1 = (
        measure_mode(chosen, band=(90.0, 220.0), gate=ModeGate())
        for chosen in (windows, [replace(window, reference=None) for window in windows])
    )
    assert isinstance(of_core, ModalMeasurement)
    (point,) = shared_api.trend("loop")
    assert point["frequency_hz"] == pytest.approx(of_core.mode.frequency.value, rel=1e-5)
    assert not isinstance(by_h1, ModalMeasurement) or abs(by_h1.mode.frequency.value - point["frequency_hz"]) > 0.1
    rows = shared_api.http.get(
        f"/v1/axes/loop/measurements/{point['measurement_id']}/windows", params={"format": "csv"}
    ).text.splitlines()
    assert rows[0] == "window,time_s,current_a,displacement_m,reference"
    # from its first sample on
    assert float(rows[2].split(",")[-1]) == pytest.approx(reference[0, 1] - reference[0, 0], abs=1e-6)


def test_a_unit_that_is_not_of_the_quantity_is_refused(shared_api: Api, windows: list[Window]) -> None:
    shared_api.register("cnc-2")
    for changed, sentence in (
        ({"response_unit": "m/s2"}, "response_unit of a displacement must be m; got m/s2"),
        ({"excitation_unit": "N.m"}, "excitation_unit of a current must be A; got N.m"),
    ):
        document = window_document(windows[0]) | changed
        answer = shared_api.http.post(
            "/v1/axes/cnc-2/windows", content=msgpack.packb(document), headers={"content-type": "application/msgpack"}
        )
        assert answer.status_code == 422
        assert sentence in answer.text


def test_the_client_sends_a_position_from_its_first_sample_on(windows: list[Window]) -> None:
    scale = windows[0].response
    sent = preload_client.routes._window(
        {
            "started_at": START,
            "response": scale,
            "response_quantity": "displacement",
            "excitation": windows[0].excitation,
        }
    )
    decoded = np.frombuffer(base64.b64decode(sent["response"]), "<f4")
    assert np.abs(decoded - (scale - scale[0])).max() < 1e-10
