"""The way to a calibration over HTTP: a drive of catalogue data, an upload looked into, a plan, a fit."""

import itertools
import math
import re
import threading
import time
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from pydantic import TypeAdapter

from monitor_core.models.extended import elastic_frequencies
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.preload import ModalReading, PreloadEstimate, estimate_preload
from monitor_core.recording import Conditions, ExcitationSource, Session, Window
from monitor_core.recordings.calibration_file import calibration_from_document
from monitor_core.recordings.model_file import model_file_text, parse_model
from monitor_core.recordings.raw.inspection import read_as_proposed
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map
from monitor_core.recordings.session_hdf5 import write_session
from monitor_core.uncertainty import Estimate
from service.documents.map_form import FieldTable, filled_map, map_fields
from service.operations.calibrating import fit_job
from service.operations.calibrating.fit_job import CalibrationJobIn
from service.operations.own_process import Progress
from service.operations.recordings import file_check
from service.operations.recordings.upload import MOST_FILES
from service.store.database import Database
from tests.conftest import canary
from tests.identification.test_described_calibration import AXES, SCATTER, Plant
from tests.recordings.test_drive_signals import drive_log
from tests.service import stand_in_readers as stand_ins
from tests.service.conftest import (
    CONFIGURATION,
    START,
    Api,
    axial_frequency,
    running_service,
    simulated_measurement,
    simulated_window,
)
from tests.service.test_jobs import wait_for

SETTINGS = list(itertools.product((200.0, 400.0, 600.0, 800.0), (100.0, 200.0, 300.0)))
RATE = 1024


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with running_service(tmp_path / "var") as served:
        served.register("axis", **CONFIGURATION | {"windows_per_measurement": 4})
        yield served


def measure(api: Api, settings: list[tuple[float, float]] = SETTINGS) -> None:
    for number, (place, preload) in enumerate(settings):
        windows = simulated_measurement(
            np.random.default_rng(number), f"setting-{number}", preload=preload, position_mm=place, n_windows=4,
            started_at=START + timedelta(minutes=number), set_preload=preload,
        )  # fmt: skip
        api.accept("axis", windows)


def refused_with(answer: httpx.Response, status: int, *, says: str = "") -> None:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert says in answer.text


def start(api: Api, **body: Any) -> dict[str, Any]:
    answer = api.http.post("/v1/axes/axis/calibration-jobs", json=body)
    assert answer.status_code == 202, answer.text
    assert answer.headers["location"] == f"/v1/jobs/{answer.json()['id']}"
    job: dict[str, Any] = answer.json()
    return job


def upload(api: Api, *files: tuple[str, bytes]) -> tuple[int, dict[str, Any]]:
    """Upload files to be looked into; return the number of the recording, and the job that has looked."""
    answer = api.http.post(
        "/v1/axes/axis/recordings", params={"check_only": True}, files=[("file", each) for each in files]
    )
    assert answer.status_code == 202, answer.text
    return answer.json()["arguments"]["recording"], wait_for(api, answer.json()["id"], "done", "failed")


def session_bytes(tmp_path: Path) -> bytes:
    windows = simulated_measurement(np.random.default_rng(1), "m", n_windows=4, set_preload=300.0)
    write_session(tmp_path / "made.session.h5", Session("axis", tuple(windows)))
    return (tmp_path / "made.session.h5").read_bytes()


def table() -> bytes:
    torque, acceleration = _signals()
    rows = [f"{i / RATE:.6f},{t:.6g},{a:.6g}" for i, (t, a) in enumerate(zip(torque, acceleration, strict=True))]
    return "\n".join(["Time [s],Motor torque [Nm],Acc nut [m/s2]", *rows]).encode()


def _signals() -> tuple[list[float], list[float]]:
    windows = simulated_measurement(np.random.default_rng(2), "m", n_windows=4)
    return [float(v) for w in windows for v in w.excitation], [float(v) for w in windows for v in w.response]


def test_catalogue_data_become_a_drive_that_an_axis_is_registered_with(api: Api) -> None:
    found = api.http.get("/v1/drive-model", params={"moved_mass_kg": 40, "bearings": "fixed-fixed"}).json()
    low, high = found["search_band_hz"]
    for item in found["expected"]:
        assert low - 1 <= item["lower_hz"] < item["frequency_hz"] < item["upper_hz"] <= high + 1
    assert parse_model(found["drive_model"], "model").parameters["table_mass_kg"] == 40.0
    configuration = {"drive_model": found["drive_model"], "search_band_hz": found["search_band_hz"]}
    answer = api.http.put("/v1/axes/fresh", json={"name": "Fresh", "configuration": configuration})
    assert answer.status_code == 201, answer.text
    plan = api.http.get("/v1/axes/fresh/calibration-plan").json()
    assert plan["scatter_from"] == "model"
    assert plan["positions_mm"] == [97.0, 291.0, 486.0, 680.0, 874.0]


def test_a_plan_says_preloads_as_makers_and_mechanics_know_them(api: Api) -> None:
    """Nut and bolts of Nguyen et al. (2018): 100, 200, 300 N are 2.5, 5, 7.5 % of 4000 N; M4, two of them."""
    found = api.http.get("/v1/drive-model", params={"dynamic_load_rating_n": 4000}).json()
    configuration = {"drive_model": found["drive_model"], "search_band_hz": found["search_band_hz"]}
    api.http.put("/v1/axes/rated", json={"name": "Rated", "configuration": configuration}).raise_for_status()

    def preloads(axis: str, **asked: float) -> list[dict[str, Any]]:
        answer = api.http.get(f"/v1/axes/{axis}/calibration-plan", params={"highest_n": 300, **asked})
        answer.raise_for_status()
        of_plan: list[dict[str, Any]] = answer.json()["preloads"]
        return of_plan

    with_bolts = preloads("rated", bolt_mm=4)
    assert [item["preload_n"] for item in with_bolts] == [100.0, 200.0, 300.0]
    assert [item["level"] for item in with_bolts] == ["slight", "normal", "tight"]
    assert [item["share_of_rating"] for item in with_bolts] == pytest.approx([0.025, 0.05, 0.075], rel=1e-12)
    assert [item["bolt_torque_nm"] for item in with_bolts] == pytest.approx([0.04, 0.08, 0.12], rel=1e-12)
    assert preloads("rated", bolt_mm=4, bolts=4)[0]["bolt_torque_nm"] == pytest.approx(0.02)
    assert [item["level"] for item in preloads("rated", highest_n=600)] == ["normal", "tight", None]  # above 10 %
    unrated = preloads("axis")
    assert [(item["share_of_rating"], item["level"], item["bolt_torque_nm"]) for item in unrated] == 3 * [(None,) * 3]
    for wrong in ({"bolt_mm": 0}, {"bolts": 0}, {"bolts": 1.5}):
        refused_with(api.http.get("/v1/axes/rated/calibration-plan", params=wrong), 422)


def test_catalogue_data_that_are_no_axis_are_refused(api: Api) -> None:
    answer = api.http.get("/v1/drive-model", params={"screw_diameter_mm": -1})
    refused_with(answer, 422)


def test_a_plan_counts_down_and_says_what_it_rests_on(api: Api) -> None:
    def plan(**asked: float) -> dict[str, Any]:
        found: dict[str, Any] = api.http.get("/v1/axes/axis/calibration-plan", params=asked).json()
        return found

    empty = plan()
    assert empty["scatter_from"] == "none"
    assert empty["smallest_loss_n"] is None
    assert empty["measurements_left"] == len(empty["holes"]) == 15
    measure(api, SETTINGS[:2])
    assert len(plan()["measured"]) == 2
    measure(api, SETTINGS)
    done = plan()
    assert done["scatter_from"] == "measured"
    assert done["holes"] == []
    assert 0.0 < done["smallest_loss_then_n"] <= done["smallest_loss_n"]
    assert plan(wished_loss_n=done["smallest_loss_n"] + 1.0)["measurements_left"] == 0
    assert plan(wished_loss_n=0.9 * done["smallest_loss_n"])["measurements_left"] != 0
    refused_with(api.http.get("/v1/axes/axis/calibration-plan", params={"from_mm": 5, "to_mm": 1}), 422)
    refused_with(api.http.get("/v1/axes/nobody/calibration-plan"), 404)


def test_a_fit_is_a_job_with_the_readings_it_rests_on(api: Api) -> None:
    measure(api)
    job = wait_for(api, start(api, comment="guided")["id"], "done")
    assert (job["done"], job["total"]) == (13, 13)
    stored = api.http.get(f"/v1/axes/axis/calibrations/{job['result']['calibration']}").json()
    assert stored["comment"] == "guided"
    assert not stored["active"]
    at_once = api.http.post("/v1/axes/axis/calibrations", json={"measurements": {}}).json()
    assert stored["document"] == at_once["document"]
    left = [reading["residual_hz"] for reading in job["result"]["readings"]]
    assert np.sqrt(np.mean(np.square(left))) == pytest.approx(stored["document"]["residual_rms_hz"], rel=1e-6)


@pytest.mark.parametrize(("scatter", "apart"), [(0.1, True), (1.0, False)])
def test_regions_of_three_levels_hold_what_is_measured_there(api: Api, scatter: float, *, apart: bool) -> None:
    rng = np.random.default_rng(8)

    def measured(preload: float, position_mm: float) -> float:
        return axial_frequency(preload, 1e-3 * position_mm) + rng.normal(0.0, scatter)

    places, preloads = (300.0, 400.0, 500.0, 600.0, 700.0), (100.0, 200.0, 300.0, 400.0)
    readings = [
        {"position_mm": x, "preload_n": preload, "frequency_hz": measured(preload, x)}
        for x in places
        for preload in preloads
    ]
    stored = api.http.post("/v1/axes/axis/calibrations", json={"readings": readings}).json()
    page = api.http.get(f"/axes/axis/calibrations/{stored['id']}").text
    assert page.count('class="band"') == 2 * 3  # wide and narrow
    rows = re.findall(r"<tr>(.*?)</tr>", page.split('id="region-table"')[1])
    levels = [float(level) for level in re.findall(r">(\d+) N<", rows[0])]
    assert levels == [100.0, 250.0, 400.0]
    cells = [[float(n) for n in re.findall(r"[>\s](\d+\.?\d*)(?= (?:mm|…|N))", row)] for row in rows[1:]]
    table = np.array(cells)
    position, lower, upper = table[:, 0], table[:, 1::2], table[:, 2::2]
    k1, k2, k3, k4 = stored["document"]["coefficients"].values()
    x = 1e-3 * position
    inside = []
    for _ in range(100):
        f = np.array([[measured(level, at) for level in levels] for at in position])
        read = (k3 / (f**-2 - (k1 * x**2 + k2 * x + k4)[:, np.newaxis])) ** 3  # Eq. (8), solved
        inside.append((lower < read) & (read < upper))
    # 16 degrees of freedom: 2.12 standard deviations, of which each is known to 18 %, are 1.36 to 2.88 of them
    assert 0.82 < np.mean(inside) < 0.997
    assert np.all(upper[:, :-1] < lower[:, 1:]) == apart
    assert ("No regions overlap" in page) is apart


def test_a_prior_that_does_not_answer_is_refused(api: Api) -> None:
    number, path = api.calibrate("axis"), "/v1/axes/axis/calibrations"
    document = api.http.get(f"{path}/{number}").json()["document"]
    readings = [
        {"position_mm": 1e3 * x, "preload_n": force, "frequency_hz": axial_frequency(force, x)}
        for x in (0.3, 0.5, 0.7)
        for force in (150.0, 300.0)
    ]
    assert api.http.post(path, json={"readings": readings, "prior": document}).status_code == 201
    document["coefficients"]["k4_s2"] = 1e300
    answer = api.http.post(path, json={"readings": readings, "prior": document})
    refused_with(answer, 422, says="expected a calibration that answers")


def test_a_prior_lets_fewer_measurements_do(api: Api) -> None:
    prior = api.calibrate("axis")
    measure(api, SETTINGS[:2])
    assert wait_for(api, start(api)["id"], "done", "failed")["status"] == "failed"
    job = wait_for(api, start(api, prior=prior)["id"], "done", "failed")
    assert job["status"] == "done", job["error"]


@pytest.mark.release
def test_a_drive_model_calibrates_where_no_preload_is_known(tmp_path: Path) -> None:
    """A finite-element axis drawn from its model: to a factor of two, or as well as the preload at first is known.

    A later preload, of which a third is lost, is in both intervals.
    """
    plant, by_model = Plant(AXES["small"], np.random.default_rng(11)), {"by_drive_model": True}
    with running_service(tmp_path / "var") as api:
        settings = CONFIGURATION | {"windows_per_measurement": 4, "search_band_hz": [120, 300]}
        api.register("axis", **settings)
        for number, share in enumerate((0.3, 0.5, 0.7)):
            api.accept("axis", windows_of(plant.reading(share), number))
        refused_with(api.http.post("/v1/axes/axis/calibration-jobs", json=by_model), 422, says="expected drive_model")
        assert "by-drive-model" not in api.http.get("/axes/axis/calibrate").text
        api.register("axis", **settings | {"drive_model": model_file_text(AXES["small"])})
        assert "to a factor of 1.9 at best" in api.http.get("/axes/axis/calibrate").text

        job = wait_for(api, start(api, **by_model)["id"], "done", "failed")
        assert job["status"] == "done", job["error"]
        typed = {**by_model, "preload_n": f"{plant.preload:g}", "preload_standard_uncertainty_n": ""}
        assert api.http.post("/axes/axis/calibrate", data=typed).status_code == 422
        typed["preload_standard_uncertainty_n"] = f"{0.05 * plant.preload:g}"
        assert api.http.post("/axes/axis/calibrate", data=typed, follow_redirects=False).status_code == 303
        known = next(job for job in api.http.get("/v1/jobs").json()["jobs"] if job["arguments"].get("preload_n"))
        assert wait_for(api, known["id"], "done", "failed")["status"] == "done"

        later, factors = plant.reading(0.6, 0.67), []
        frequency = Estimate(later.frequency, SCATTER * later.frequency)
        for number in (1, 2):
            document = api.http.get(f"/v1/axes/axis/calibrations/{number}").json()["document"]
            assert "3 readings at a preload of" in document["prior"]
            told = estimate_preload(frequency, later.conditions, calibration_from_document(document))
            assert isinstance(told, PreloadEstimate)
            assert told.interval.covers(0.67 * plant.preload)
            factors.append(told.interval.upper / told.interval.lower)
        assert factors[0] > 1.86**2 > factors[1] > math.exp(2 * 1.96 * 0.05)


def test_a_drive_model_calibrates_for_the_source_of_the_measurements(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Signals of the drive, whose motor moves freely; the settings of the axis say nothing of it."""
    monkeypatch.setattr(fit_job, "in_own_process", lambda work, report, _steps: work(report))  # none to be started
    model = AXES["small"].build()
    with running_service(tmp_path / "var") as api:
        settings = CONFIGURATION | {"windows_per_measurement": 4, "search_band_hz": [120, 300]}
        api.register("axis", **settings | {"drive_model": model_file_text(AXES["small"])})
        for number, position in enumerate((0.3, 0.5, 0.7)):
            frequency = elastic_frequencies(model, [DriveConditions(position, 200.0)], MotorEnd.FREE)[0][0]
            reading = ModalReading(frequency, Conditions(position, 0.0))
            api.accept("axis", windows_of(reading, number, ExcitationSource.DRIVE))
        job = wait_for(api, start(api, by_drive_model=True)["id"], "done", "failed")
        assert job["status"] == "done", job["error"]
        document = api.http.get("/v1/axes/axis/calibrations/1").json()["document"]
        assert document["excitation_source"] == "drive"


def test_a_drive_model_is_joined_with_measurements_of_one_nut_without_payload(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_job, "_MOST_UNSET", 2)
    for day, payload in enumerate((0.0, 50.0, 50.0, 0.0, 0.0, 0.0)):
        windows = simulated_measurement(
            np.random.default_rng(1), f"day-{day}", n_windows=4, started_at=START + timedelta(days=day)
        )
        conditions = replace(windows[0].conditions, payload_mass=payload)
        api.accept("axis", [replace(window, conditions=conditions) for window in windows])
    renewed = {"at": (START + timedelta(days=0.5)).isoformat(), "kind": "nut-replaced", "who": "A. Fitter"}
    api.http.post("/v1/axes/axis/maintenance", json=renewed).raise_for_status()
    asked = CalibrationJobIn.model_validate({"by_drive_model": True, "from": START})
    database = Database(f"sqlite:///{api.data_dir}/preload.db")
    with database.read() as session:
        assert [row.name for row in fit_job._measured(session, "axis", asked)] == ["day-3", "day-4"]
    database.close()


def windows_of(reading: ModalReading, number: int, source: ExcitationSource = ExcitationSource.SENSOR) -> list[Window]:
    """Return four windows of an axis that rings at this frequency."""
    rng, at = np.random.default_rng(number), START + timedelta(minutes=number)
    return [
        simulated_window(
            rng, reading.frequency, started_at=at + timedelta(seconds=2 * i), conditions=reading.conditions,
            measurement=f"m{number}", excitation_source=source,
        )
        for i in range(4)
    ]  # fmt: skip


def test_what_cannot_be_fitted_is_refused_before_a_job_is_made(api: Api) -> None:
    refused_with(api.http.post("/v1/axes/axis/calibration-jobs", json={}), 422, says="preload_n set")
    refused_with(api.http.post("/v1/axes/nobody/calibration-jobs", json={}), 404)
    measure(api, SETTINGS[:1])
    refused_with(api.http.post("/v1/axes/axis/calibration-jobs", json={"prior": 99}), 404)
    for wrong in ({"prior": 1, "by_drive_model": True}, {"preload_n": 300, "preload_standard_uncertainty_n": 20}):
        refused_with(api.http.post("/v1/axes/axis/calibration-jobs", json=wrong), 422)


def test_one_fit_at_a_time_which_can_be_cancelled(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    measure(api)
    go_on = threading.Event()
    measured_modes = fit_job.measured_modes

    def slowly(*arguments: Any) -> Any:
        go_on.wait(20.0)
        return measured_modes(*arguments)

    monkeypatch.setattr(fit_job, "measured_modes", slowly)
    job = start(api)
    wait_for(api, job["id"], "running")
    refused_with(api.http.post("/v1/axes/axis/calibration-jobs", json={}), 409, says="already")
    assert api.http.post(f"/v1/jobs/{job['id']}/cancel").json()["status"] == "cancelled"
    go_on.set()
    assert wait_for(api, start(api)["id"], "done")["result"]["calibration"] == 1  # the cancelled one stored none


@pytest.mark.release
def test_a_fit_that_a_stop_interrupted_is_done_after_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = threading.Event()
    measured_modes = fit_job.measured_modes

    def slowly(*arguments: Any) -> Any:
        started.set()
        time.sleep(0.3)
        return measured_modes(*arguments)

    with running_service(tmp_path / "var") as api:
        api.register("axis", **CONFIGURATION | {"windows_per_measurement": 4})
        measure(api)
        monkeypatch.setattr(fit_job, "measured_modes", slowly)
        job = start(api)
        assert started.wait(10.0)
    monkeypatch.setattr(fit_job, "measured_modes", measured_modes)
    with running_service(tmp_path / "var") as api:
        assert wait_for(api, job["id"], "done")["result"]["calibration"] == 1


def test_an_upload_is_looked_into_and_taken_when_asked_to(api: Api, tmp_path: Path) -> None:
    number, job = upload(api, ("made.session.h5", session_bytes(tmp_path)))
    assert job["kind"] == "check"
    found = job["result"]
    assert found["valid"]
    assert (found["contents"]["windows"], found["contents"]["preloads_n"]) == (4, [300.0])
    assert found["lacks_for_calibration"] == "5 measurements with preload_n; it has 1"
    assert api.http.get("/v1/axes/axis/trend").json()["points"] == []  # nothing was taken yet
    answer = api.http.post(f"/v1/axes/axis/recordings/{number}/import", json={})
    assert answer.status_code == 202, answer.text
    wait_for(api, answer.json()["id"], "done")
    stored = api.http.get(f"/v1/axes/axis/recordings/{number}").json()
    assert (stored["state"], stored["n_windows"]) == ("imported", 4)
    refused_with(api.http.post(f"/v1/axes/axis/recordings/{number}/import", json={}), 409)


def tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    torque, acceleration = _signals()
    channels = [
        nptdms.ChannelObject("Run", name, np.array(values), properties={"wf_increment": 1 / RATE, "unit_string": unit})
        for name, values, unit in (("Torque", torque, "N.m"), ("Acceleration", acceleration, "m/s^2"))
    ]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)


def mdf(path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    torque, acceleration = _signals()
    stamps = np.arange(len(torque)) / RATE
    file = asammdf.MDF(version="4.10")
    file.append(
        [
            asammdf.Signal(np.array(values), stamps, name=name, unit=unit)
            for name, values, unit in (("Torque", torque, "Nm"), ("Acceleration", acceleration, "m/s2"))
        ]
    )
    file.save(path, overwrite=True)
    file.close()


def csv(path: Path) -> None:
    path.write_bytes(table())


#: What the forms of these files leave to be said, and what is to be typed there.
TYPED = {
    "window.sample_rate_hz": str(RATE), "window.started_at": "2026-03-01T06:00:00Z", "window.position_mm": "250",
    "window.samples_per_window": str(RATE), "window.preload_n": "300",
}  # fmt: skip


@pytest.mark.parametrize(("name", "make"), canary([("run.csv", csv), ("run.tdms", tdms), ("run.mf4", mdf)]))
def test_a_raw_file_is_taken_with_the_form_that_is_proposed(api: Api, tmp_path: Path, name: str, make: Any) -> None:
    make(tmp_path / name)
    number, job = upload(api, (name, (tmp_path / name).read_bytes()))
    found = job["result"]
    assert found["valid"], found
    form = TypeAdapter(list[FieldTable]).validate_python(found["map_form"])
    fields = {field.key: field for part in form for field in part.fields}
    assert fields[".axis_id"].value == "axis"
    values = {key: field.value or TYPED.get(key, "") for key, field in fields.items()}
    assert all(values[key] for key, field in fields.items() if field.required)
    body = {"map": filled_map(form, values)}
    refused = api.http.post(f"/v1/axes/axis/recordings/{number}/import", json={"map": body["map"].replace("N.m", "kg")})
    refused_with(refused, 422, says="kg")
    assert api.http.get(f"/v1/axes/axis/recordings/{number}").json()["state"] == "uploaded"  # nothing is lost
    answer = api.http.post(f"/v1/axes/axis/recordings/{number}/import", json=body)
    assert answer.status_code == 202, answer.text
    assert wait_for(api, answer.json()["id"], "done")["result"]["windows_posted"] == 4


def drive_csv(path: Path) -> None:
    current, _, scale = drive_log(n_periods=4, noise=1e-8)
    rows = np.column_stack([0.5 * np.arange(current.size), current, 1e6 * scale])
    np.savetxt(path, rows, "%.9g", ",", header="t [ms],Motor current [A],Scale [um]", comments="")


def test_a_log_without_an_acceleration_is_taken_and_says_what_it_can_show(api: Api, tmp_path: Path) -> None:
    drive_csv(tmp_path / "log.csv")
    number, job = upload(api, ("log.csv", (tmp_path / "log.csv").read_bytes()))
    shows = "natural frequency, damping and, with a calibration, preload from the scale"
    assert shows in job["result"]["contents"]["what_it_shows"]
    page = api.http.get(f"/axes/axis/import/{number}").text
    assert shows in page
    assert 'value="displacement"' in page
    form = TypeAdapter(list[FieldTable]).validate_python(job["result"]["map_form"])
    values = {field.key: field.value or TYPED.get(field.key, "") for part in form for field in part.fields}
    answer = api.http.post(f"/v1/axes/axis/recordings/{number}/import", json={"map": filled_map(form, values)})
    assert answer.status_code == 202, answer.text
    assert wait_for(api, answer.json()["id"], "done")["result"]["windows_posted"] == 4


@pytest.mark.parametrize("make", [csv, drive_csv])
def test_the_map_of_a_form_that_nobody_touched_is_the_proposal(tmp_path: Path, make: Any) -> None:
    make(tmp_path / "run.csv")
    read = read_as_proposed(tmp_path / "run.csv", "csv")
    proposed = proposed_map(read.channels, read.layout)
    form = map_fields(proposed)
    values = {field.key: field.value for part in form for field in part.fields}
    assert tomllib.loads(filled_map(form, values)) == tomllib.loads(proposed.toml())


@pytest.mark.parametrize(
    ("name", "content"),
    canary(
        [("b.txt", b"dear diary"), ("a.csv", b""), ("c.session.h5", b"\x89HDF\r\n\x1a\n"), ("d.toml", b'axis_id = "x"')]
    ),
)
def test_a_file_that_holds_no_windows_says_what_was_expected(api: Api, name: str, content: bytes) -> None:
    number, job = upload(api, (name, content))
    assert job["status"] == "done"
    assert not job["result"]["valid"]
    (sentence,) = job["result"]["problems"]
    assert name in sentence
    refused_with(api.http.post(f"/v1/axes/axis/recordings/{number}/import", json={}), 422)
    assert api.http.delete(f"/v1/axes/axis/recordings/{number}").status_code == 200


@pytest.mark.parametrize("dated", [True, False])
def test_files_that_are_not_read_have_a_start_proposed_only_if_the_others_state_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dated: bool
) -> None:
    monkeypatch.setattr(file_check, "_MOST_READ", 2)
    form = "2025-03-01T06:00:00.{:03d}Z" if dated else "0.{:03d}"
    rows = [f"{form.format(i)},{i % 7},{i % 5}" for i in range(200)]
    paths = [tmp_path / f"2026-03-0{day}_0630.csv" for day in range(1, 5)]
    for path in paths:
        path.write_text("\n".join([f"{'time' if dated else 'Time [s]'},Torque [Nm],Acc [m/s2]", *rows]) + "\n")
    told: list[Progress] = []
    facts: Any = file_check.checked(paths, "axis", told.append)["files"]
    assert [fact["started_at"] for fact in facts] == [None if dated else path.stem[:10] + "T06:30" for path in paths]
    assert told == [Progress(0, 2), Progress(1, 2)]


def test_a_sheet_of_as_many_files_as_an_upload_may_hold_is_taken(api: Api) -> None:
    content = table()
    number, job = upload(api, *((f"{file}.csv", content) for file in range(MOST_FILES)))
    assert len(job["result"]["files"]) == MOST_FILES
    entries = ("preload_n", "payload_kg", "position_mm", "started_at")
    typed = {f"files.{file}.{entry}": "" for file in range(MOST_FILES) for entry in entries}
    typed[f"files.{MOST_FILES - 1}.preload_n"] = "much"
    answer = api.http.post(f"/axes/axis/import/{number}", data=typed)
    assert answer.status_code == 422
    assert f"{MOST_FILES - 1}.csv, preload_n" in answer.text


def test_a_look_that_a_reader_ends_says_so(api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_check, "checked", stand_ins.aborts)
    _, job = upload(api, ("made.session.h5", session_bytes(tmp_path)))
    assert not job["result"]["valid"]
    assert "made.session.h5: expected a recording that can be read" in job["result"]["problems"][0]
    assert "by signal SIGABRT" in job["result"]["problems"][0]
