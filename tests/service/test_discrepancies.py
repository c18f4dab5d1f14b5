"""Discrepancies as a job: progress, result, report, cancel, a process that dies, refusals, the page of the axis."""

import json
import multiprocessing
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.models.protocol import DriveConditions
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.model_file import parse_model, read_model_file
from monitor_core.recordings.session_hdf5 import read_session
from tests.conftest import PROJECT_ROOT, run_here
from tests.service.conftest import Api, assert_problem, running_service
from tests.service.test_identifications import peak
from tests.service.test_jobs import wait_for

MODEL = PROJECT_ROOT / "replay_data" / "models" / "receptance.toml"
TEXT = MODEL.read_text(encoding="utf-8")
UNCERTAIN = "\n[uncertain]\nbearing_stiffness_n_per_m = 0.2\nnut_stiffness_n_per_m = 0.1\n"
LUMPED = (PROJECT_ROOT / "replay_data" / "models" / "lumped.toml").read_text(encoding="utf-8")
TABLE2 = PROJECT_ROOT / "replay_data" / "published" / "nguyen_table2.csv"
N_WINDOWS = 10
SHARE = 0.001  # standard uncertainty of a frequency


def sound_peaks() -> list[dict[str, Any]]:
    """Return the mode that is monitored, as the model has it but for its uncertainty."""
    axis, rng = read_model_file(MODEL).build(), np.random.default_rng(3)
    peaks = []
    for position_mm in (600.0, 1000.0, 1600.0):
        modes = axis.natural_frequencies(DriveConditions(1e-3 * position_mm))
        frequency = next(mode.frequency for mode in modes if mode.frequency > 60.0) * (
            1.0 + SHARE * rng.standard_normal()
        )
        peaks.append(peak(position_mm, frequency, frequency_standard_uncertainty_hz=SHARE * frequency))
    return peaks


def published_peaks() -> list[dict[str, Any]]:
    """Return Nguyen's table, which takes long to explain."""
    return [
        peak(
            to_millimetres(row.position), row.frequency, preload_n=row.preload,
            frequency_standard_uncertainty_hz=row.frequency_std,
        )
        for row in read_modal_table(TABLE2)
    ]  # fmt: skip


def start(api: Api, axis: str, **body: Any) -> str:
    answer = api.http.post(f"/v1/axes/{axis}/discrepancies", json=body)
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert (job["kind"], job["axis"]) == ("discrepancy", axis)
    return str(job["id"])


def report_path(axis: str, job_id: str) -> str:
    return f"/v1/axes/{axis}/discrepancies/{job_id}/report"


def wait_until_progress(api: Api, job_id: str) -> None:
    """Wait until the process of the search says what it does."""
    deadline = time.monotonic() + 60.0
    while wait_for(api, job_id, "running", done=1)["done"] < 2:
        assert time.monotonic() < deadline
        time.sleep(0.02)


# --- the job


@pytest.mark.release
def test_result_is_the_json_of_the_command_and_the_report_stays(preload: Any, tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        api.register("peaks")
        assert "Model and measurement" not in api.http.get("/axes/peaks").text
        job_id = start(api, "peaks", baseline=TEXT, peaks=sound_peaks())
        seen = []
        while (now := api.http.get(f"/v1/jobs/{job_id}").json())["status"] in ("queued", "running"):
            seen.append(now)
            time.sleep(0.02)
        assert now["status"] == "done", now["error"]
    working = [state for state in seen if state["result"] is not None and "progress" in state["result"]]
    said = [state["result"]["progress"] for state in working]
    assert any(sentence.startswith(("0 effects found, screening", "screening ")) for sentence in said)
    assert {state["total"] for state in working} == {None}
    assert now["done"] == now["total"] >= len(set(said))
    # the same data and model in another process
    rows = [f"{p['position_mm']},{p['frequency_hz']},{p['frequency_standard_uncertainty_hz']}" for p in sound_peaks()]
    table = tmp_path / "table.csv"
    table.write_text("\n".join(["position_mm,frequency_hz,frequency_std_hz", *rows]) + "\n", encoding="utf-8")
    assert now["result"] == preload("explain", table, "--baseline", MODEL, "--json").json()
    with running_service(tmp_path / "var") as api:  # at its next start
        page = api.http.get(report_path("peaks", job_id))
        assert page.status_code == 200
        assert page.headers["content-type"] == "text/html; charset=utf-8"
        assert "Axis peaks against its receptance model" in page.text
        assert not re.search(r'(src|href)="', page.text.replace('href="data:', ""))  # nothing from outside itself
        of_axis = api.http.get("/axes/peaks").text
        assert f'<a href="{report_path("peaks", job_id)}">' in of_axis
        assert f">{now['result']['outcome']}</td>" in of_axis


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a session of Tian's axis at three positions."""
    path = tmp_path_factory.mktemp("session") / "axis.session.h5"
    words = ("simulate", MODEL, "--out", path, "--position-mm", 600, 1000, 1600, "--windows", N_WINDOWS)
    assert run_here(*words) == 0
    return path


@pytest.mark.release
def test_stored_measurements_are_explained_as_those_of_the_session(
    shared_api: Api, preload: Any, session: Path, tmp_path: Path
) -> None:
    shared_api.register("stored", windows_per_measurement=N_WINDOWS, search_band_hz=[80, 150])
    shared_api.accept("stored", list(read_session(session).windows))
    baseline = tmp_path / "baseline.toml"
    baseline.write_text(TEXT.replace("= 2.94e7", "= 1.5e7") + UNCERTAIN, encoding="utf-8")  # the far bearing
    text = baseline.read_text(encoding="utf-8")
    job_id = start(shared_api, "stored", baseline=text, measurements={}, hold_out_mm=[1000.0])
    job = wait_for(shared_api, job_id, "done", "failed")
    assert job["status"] == "done", job["error"]
    words = ("explain", session, "--baseline", baseline, "--band-hz", 80, 150, "--hold-out-mm", 1000, "--json")
    by_command = preload(*words).json()
    assert job["result"].keys() == by_command.keys()
    assert [effect["key"] for effect in job["result"]["effects"]] == [effect["key"] for effect in by_command["effects"]]
    assert job["result"]["effects"][0]["key"] == "far-bearing-stiffness"
    assert job["result"]["gap"]["before"]["held_out"] > 5.0
    for when in ("before", "after"):
        for where, value in by_command["gap"][when].items():
            # what is posted is single precision
            assert job["result"]["gap"][when][where] == pytest.approx(value, rel=1e-3)
    parse_model(job["result"]["model"], "model").build()
    keys = ", ".join(effect["key"] for effect in job["result"]["effects"])
    assert f">{keys}</td>" in shared_api.http.get("/axes/stored").text


def test_cancelled_search_ends_at_once_and_makes_room(shared_api: Api) -> None:
    shared_api.register("cancelled")
    others = set(multiprocessing.active_children())
    job_id = start(shared_api, "cancelled", baseline=LUMPED, peaks=published_peaks())
    wait_until_progress(shared_api, job_id)
    assert len(set(multiprocessing.active_children()) - others) == 1
    assert shared_api.http.post(f"/v1/jobs/{job_id}/cancel").json()["status"] == "cancelled"
    deadline = time.monotonic() + 60.0
    while set(multiprocessing.active_children()) - others:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    first = shared_api.http.get(f"/v1/jobs/{job_id}").json()
    assert first["status"] == "cancelled"
    assert first["result"].keys() == {"progress"}
    assert_problem(shared_api.http.get(report_path("cancelled", job_id)), 404, "unknown-resource")
    other = start(shared_api, "cancelled", baseline=TEXT, peaks=sound_peaks())
    wait_for(shared_api, other, "running")
    shared_api.http.post(f"/v1/jobs/{other}/cancel")


def test_search_that_is_killed_is_begun_anew_and_then_fails_its_job_with_a_sentence(shared_api: Api) -> None:
    shared_api.register("killed")
    others = set(multiprocessing.active_children())
    job_id = start(shared_api, "killed", baseline=LUMPED, peaks=published_peaks())
    wait_until_progress(shared_api, job_id)
    for _ in range(2):
        while not (processes := set(multiprocessing.active_children()) - others):
            time.sleep(0.02)
        (process,) = processes
        process.kill()
        process.join()
    failed = wait_for(shared_api, job_id, "failed", "done")
    # the signal is named in test_own_process: whoever lists children, as this test does, may take the exit code away
    assert "the process of this work was ended twice, the second time " in failed["error"]
    assert failed["error"].endswith(": most often the system does so for lack of memory")


@pytest.mark.release
def test_what_only_shows_in_the_search_fails_the_job_with_a_sentence(shared_api: Api, session: Path) -> None:
    shared_api.register("late", windows_per_measurement=N_WINDOWS, search_band_hz=[80, 150])
    shared_api.accept("late", list(read_session(session).windows))
    job_id = start(shared_api, "late", baseline=TEXT, measurements={}, hold_out_mm=[700.0])
    failed = wait_for(shared_api, job_id, "failed", "done")
    assert failed["error"].startswith("NotIdentifiableError: a position to hold out must be a measured one, 600, 1000")


# --- refusals


def test_refused_at_once_and_nothing_stored(shared_api: Api, subtests: pytest.Subtests) -> None:
    for body, name, complaint in [
        ({"peaks": sound_peaks(), "hold_out_mm": [700]}, "not-identifiable", "1600 mm; got 700 mm"),
        ({"peaks": sound_peaks(), "hold_out_mm": [600, 1000, 1600]}, "not-identifiable", "left for the fit"),
        ({"peaks": [peak(2700, 118)]}, "outside-validity", "must lie on the screw"),
        (
            {"peaks": [peak(600, 118, preload_n=300), peak(800, 118, preload_n=200)]},
            "outside-validity",
            "got measurements at 200 N, 300 N: state the rating",
        ),
        ({"baseline": LUMPED, "peaks": [peak(600, 118)]}, "outside-validity", "state the preload"),
        ({"baseline": "family = ", "peaks": sound_peaks()}, "recording-format", "baseline: expected a drive model"),
        ({"baseline": "family = ", "measurements": {}}, "recording-format", "baseline: expected a drive model in TOML"),
        (
            {"baseline": TEXT + "\n[effects.gremlin]\nsize_m = 3\n", "peaks": sound_peaks()},
            "outside-validity",
            "the key of an effect must be one of",
        ),
        (
            {"baseline": 'family = "motion"\n[parameters]\nmoving_mass_kg = 80\n', "peaks": sound_peaks()},
            "outside-validity",
            "got a motion model",
        ),
        (
            {"measurements": {}},
            "not-identifiable",
            "1 to 200 measurements that were looked at; axis 'refused' has none",
        ),
        ({}, "invalid-request", "exactly one of measurements and peaks is expected; got both or none"),
        ({"measurements": {}, "peaks": sound_peaks()}, "invalid-request", "got both or none"),
        ({"peaks": []}, "invalid-request", "peaks"),
        ({"peaks": [peak(600, -118)]}, "invalid-request", "frequency_hz"),
        ({"peaks": sound_peaks(), "effects": "own.py"}, "invalid-request", "effects"),
    ]:
        with subtests.test(body=body, name=name):
            shared_api.register("refused")
            answer = shared_api.http.post("/v1/axes/refused/discrepancies", json={"baseline": TEXT} | body)
            problem = assert_problem(answer, 422, name)
            assert complaint in problem["detail"] or any(
                complaint in f"{item['pointer']} {item['detail']}" for item in problem["errors"]
            )
            assert shared_api.http.get("/v1/jobs", params={"axis": "refused"}).json()["jobs"] == []


def test_unknown_axis_is_refused(shared_api: Api) -> None:
    for source in ({"peaks": sound_peaks()}, {"measurements": {}}):
        answer = shared_api.http.post("/v1/axes/nobody/discrepancies", json={"baseline": TEXT} | source)
        assert_problem(answer, 404, "unknown-resource")
    assert shared_api.http.get("/v1/jobs", params={"axis": "nobody"}).json()["jobs"] == []


def test_report_is_of_a_finished_discrepancy_of_this_axis(shared_api: Api) -> None:
    for axis in ("mine", "other"):
        shared_api.register(axis)
    job_id = start(shared_api, "mine", baseline=TEXT, peaks=sound_peaks())
    assert wait_for(shared_api, job_id, "done", "failed", timeout_s=300.0)["status"] == "done"
    assert shared_api.http.get(report_path("mine", job_id)).status_code == 200
    for path in (report_path("other", job_id), report_path("mine", "0" * 36)):
        assert_problem(shared_api.http.get(path), 404, "unknown-resource")
    assert_problem(shared_api.http.get(report_path("mine", "x")), 422, "invalid-request")
    (shared_api.data_dir / "reports" / f"{job_id}.html").unlink()
    problem = assert_problem(shared_api.http.get(report_path("mine", job_id)), 404, "unknown-resource")
    assert problem["detail"] == f"job '{job_id}' has no report"
    assert json.loads(shared_api.http.get(f"/v1/jobs/{job_id}").text)["status"] == "done"
