"""Identification of joints as a job: from posted peaks and from stored measurements, progress, cancel, refusals."""

import re
import time
from pathlib import Path
from typing import Any

import pytest

from monitor_core.fitting.residuals.peak_search import Place, find_peaks, peak_grid
from monitor_core.identification.sensitivity import peak_sensitivities
from monitor_core.models.protocol import DriveConditions
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.session_hdf5 import read_session
from tests.conftest import run_here
from tests.identification import tian
from tests.service.conftest import Api, assert_problem
from tests.service.test_cli_identify import MODEL, PEAKS, STIFFNESSES, identified, model_file
from tests.service.test_jobs import wait_for

TEXT = MODEL.read_text(encoding="utf-8")
ADDED_MASS = "\n[effects.added-mass]\nmass_kg = 3\n"
NUT = TEXT + "\n[uncertain]\nnut_stiffness_n_per_m = 0.5\n"
N_WINDOWS = 10


def published_peaks() -> list[dict[str, Any]]:
    return [
        {
            "position_mm": to_millimetres(row.position),
            "frequency_hz": row.frequency,
            "amplitude_m_per_n": row.amplitude,
        }
        for row in read_modal_table(PEAKS)
    ]


def peak(position_mm: float, frequency_hz: float, **more: Any) -> dict[str, Any]:
    return {"position_mm": position_mm, "frequency_hz": frequency_hz, **more}


def start(api: Api, axis: str, **body: Any) -> dict[str, Any]:
    answer = api.http.post(f"/v1/axes/{axis}/identifications", json=body)
    assert answer.status_code == 202, answer.text
    job: dict[str, Any] = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert (job["kind"], job["axis"]) == ("identification", axis)
    return job


# --- the job


def test_result_is_the_json_of_the_command(shared_api: Api, tmp_path: Path) -> None:
    shared_api.register("peaks")
    model = model_file(tmp_path, "nut.toml", "nut_stiffness_n_per_m")
    job = start(
        shared_api,
        "peaks",
        model=model.read_text(encoding="utf-8"),
        peaks=published_peaks(),
        hold_out_mm=[800.0, 1300.0, 1900.0],
        limits={"nut_stiffness_n_per_m": [1e8, 3e9]},
        seed=3,
    )
    seen = []
    while (now := shared_api.http.get(f"/v1/jobs/{job['id']}").json())["status"] in ("queued", "running"):
        seen.append((now["done"], now["total"]))
        time.sleep(0.05)
    assert now["status"] == "done", now["error"]
    seen.append((now["done"], now["total"]))
    assert now["done"] == now["total"] > 1
    done = [n_done for n_done, _ in seen]
    assert done == sorted(done)
    assert {total for _, total in seen} <= {None, now["total"]}
    # the same data, model and seed in another process
    assert now["result"] == identified(
        PEAKS, "--model", model, "--hold-out-mm", 800, 1300, 1900, "--seed", 3,
        "--limit", "nut_stiffness_n_per_m", 1e8, 3e9,
    )  # fmt: skip


def test_the_page_says_in_german_why_a_peak_was_left_out(shared_api: Api, tmp_path: Path) -> None:
    shared_api.register("dropped")
    model = model_file(tmp_path, "nut.toml", "nut_stiffness_n_per_m").read_text(encoding="utf-8")
    # between modes 2 and 3, which have their own there
    job = start(shared_api, "dropped", model=model, peaks=[*published_peaks(), peak(1000, 200)], seed=3)
    wait_for(shared_api, job["id"], "done")
    page = shared_api.http.get(f"/jobs/{job['id']}", headers={"accept-language": "de"}).text
    dropped = "die Spitze bei 200 Hz an 1000 mm ist keine axiale Mode: keine andere Position"
    assert page.count(dropped) == 1
    assert page.count("; Moden 2 und 3 haben ihre eigenen</p>") == 1
    assert re.findall(r"Mode 3 bei \d+ Hz hat keine Spitze bei 1300 mm: Der Tisch steht in ihrem Knoten", page)


@pytest.mark.release
def test_stated_uncertainty_of_peaks_reaches_the_result(shared_api: Api) -> None:
    shared_api.register("stated")
    axis, fourth = tian.axis(), []
    for x in (0.6, 1.0, 1.6):
        place = DriveConditions(x)
        top = find_peaks(peak_grid(axis, [Place(place, tian.BANDS[4])]), axis.joints(place))
        fourth.append((1e3 * x, float(top.frequency[0])))
    share = 5e-4
    peaks = [peak(x, f, frequency_standard_uncertainty_hz=share * f) for x, f in fourth]
    job = start(shared_api, "stated", model=NUT.replace("= 0.5", "= 9"), peaks=peaks)
    job = wait_for(shared_api, job["id"], "done", "failed")
    assert job["status"] == "done", job["error"]
    # of one joint alone: u(ln k) = u(ln f)/√ΣS², with S = ∂ ln f/∂ ln k; the prior of 9 adds nothing
    sensitivity = [
        at_peak.of_frequency
        for at_peak in peak_sensitivities(axis, [DriveConditions(1e-3 * x) for x, _ in fourth], {4: tian.BANDS[4]})
    ]
    nut = job["result"]["parameters"]["nut_stiffness_n_per_m"]
    expected = share / sum(slope**2 for slope in sensitivity) ** 0.5
    assert nut["standard_uncertainty"] / nut["value"] == pytest.approx(expected, rel=1e-3)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a session of Tian's axis at three positions."""
    path = tmp_path_factory.mktemp("session") / "axis.session.h5"
    words = ("simulate", MODEL, "--out", path, "--position-mm", 600, 1000, 1600, "--windows", N_WINDOWS)
    assert run_here(*words) == 0
    return path


@pytest.mark.release
def test_joints_from_stored_measurements_are_those_of_the_session(
    shared_api: Api, session: Path, tmp_path: Path
) -> None:
    shared_api.register("stored", windows_per_measurement=N_WINDOWS, search_band_hz=[60, 250])
    shared_api.accept("stored", list(read_session(session).windows))
    model = model_file(tmp_path, "stiff.toml", "nut_stiffness_n_per_m")
    text = model.read_text(encoding="utf-8")
    job = start(shared_api, "stored", model=text, measurements={}, hold_out_mm=[600.0])
    job = wait_for(shared_api, job["id"], "done", "failed")
    assert job["status"] == "done", job["error"]
    by_command = identified(session, "--model", model, "--band-hz", 60, 250, "--hold-out-mm", 600)
    assert job["result"].keys() == by_command.keys()
    assert job["result"]["objective"]["kind"] == "whole responses"
    for name, parameter in by_command["parameters"].items():
        # what is posted is single precision
        assert job["result"]["parameters"][name]["value"] == pytest.approx(parameter["value"], rel=1e-5)
    some = start(shared_api, "stored", model=text, measurements={"to": "2025-01-01T00:00:30Z"}, hold_out_mm=[1600.0])
    failed = wait_for(shared_api, some["id"], "failed")
    assert "must be a measured one" in failed["error"]
    assert "got 1600 mm" in failed["error"]


@pytest.mark.release
def test_cancelled_identification_makes_room(shared_api: Api) -> None:
    shared_api.register("cancelled")
    job = start(shared_api, "cancelled", model=TEXT, peaks=published_peaks())
    wait_for(shared_api, job["id"], "running", done=1)
    assert shared_api.http.post(f"/v1/jobs/{job['id']}/cancel").json()["status"] == "cancelled"
    other = start(shared_api, "cancelled", model=NUT, peaks=published_peaks(), hold_out_mm=[800.0])
    assert wait_for(shared_api, other["id"], "done", "failed")["status"] == "done"
    first = shared_api.http.get(f"/v1/jobs/{job['id']}").json()
    assert first["status"] == "cancelled"
    assert "parameters" not in (first["result"] or {})


@pytest.mark.release
def test_joints_that_all_end_at_a_limit_fail_the_job_with_a_sentence(shared_api: Api) -> None:
    shared_api.register("narrow")
    limits = {"nut_stiffness_n_per_m": [1.2e9, 1.3e9]}
    job = start(shared_api, "narrow", model=NUT, peaks=published_peaks(), limits=limits, hold_out_mm=[800.0])
    failed = wait_for(shared_api, job["id"], "failed", "done")
    assert failed["error"].startswith(
        "NotIdentifiableError: at least one of nut_stiffness_n_per_m must lie within its limits"
    )
    assert "parameters" not in (failed["result"] or {})


# --- refusals


def test_refused_at_once_and_nothing_stored(shared_api: Api, subtests: pytest.Subtests) -> None:
    for body, name, complaint in [
        ({"peaks": [peak(600, 24), peak(600, 118)]}, "not-identifiable", "2 positions at least; got 1"),
        ({"peaks": [peak(600, 24), peak(800, 250)]}, "not-identifiable", "the peak at 250 Hz at 800 mm is nearest to"),
        ({"peaks": [peak(600, 118), peak(600, 119)]}, "not-identifiable", "both belong to mode 2"),
        ({"peaks": published_peaks(), "hold_out_mm": [700]}, "not-identifiable", "1900 mm; got 700 mm"),
        ({"peaks": published_peaks(), "limits": {"spring": [1, 2]}}, "not-identifiable", "got spring"),
        (
            {"peaks": published_peaks(), "limits": {STIFFNESSES[2]: [2e9, 1e9]}},
            "outside-validity",
            "positive, finite and rising; got 2e+09 and 1e+09",
        ),
        ({"peaks": [peak(600, 118), peak(2700, 118)]}, "outside-validity", "must lie on the screw"),
        ({"peaks": [peak(600, 118, preload_n=300), peak(800, 118)]}, "outside-validity", "state the rating"),
        ({"model": "family = ", "peaks": published_peaks()}, "recording-format", "model: expected a drive model"),
        (
            {"model": TEXT + "\n[effects.bearing-along]\nchange = -0.5\n", "peaks": published_peaks()},
            "outside-validity",
            "got 'bearing-along'",
        ),
        (
            {"model": TEXT + ADDED_MASS, "peaks": published_peaks(), "objective": "eq-26"},
            "not-identifiable",
            "got one with the effect",
        ),
        ({"model": "family = ", "measurements": {}}, "recording-format", "model: expected a drive model in TOML"),
        (
            {"measurements": {}},
            "not-identifiable",
            "1 to 200 measurements that were looked at; axis 'refused' has none",
        ),
        ({}, "invalid-request", "exactly one of measurements and peaks is expected; got both or none"),
        ({"measurements": {}, "peaks": published_peaks()}, "invalid-request", "got both or none"),
        ({"peaks": []}, "invalid-request", "peaks"),
        ({"peaks": [peak(600, -118)]}, "invalid-request", "frequency_hz"),
        ({"peaks": [peak(600, 118, order=2)]}, "invalid-request", "order"),
        ({"peaks": published_peaks(), "seed": -1}, "invalid-request", "seed"),
        ({"peaks": published_peaks(), "objective": "eq-27"}, "invalid-request", "objective"),
    ]:
        with subtests.test(body=body, name=name):
            shared_api.register("refused")
            answer = shared_api.http.post("/v1/axes/refused/identifications", json={"model": TEXT} | body)
            problem = assert_problem(answer, 422, name)
            assert complaint in problem["detail"] or any(
                complaint in f"{item['pointer']} {item['detail']}" for item in problem["errors"]
            )
            assert shared_api.http.get("/v1/jobs", params={"axis": "refused"}).json()["jobs"] == []


def test_unknown_axis_is_refused(shared_api: Api) -> None:
    for source in ({"peaks": published_peaks()}, {"measurements": {}}):
        answer = shared_api.http.post("/v1/axes/nobody/identifications", json={"model": TEXT} | source)
        assert_problem(answer, 404, "unknown-resource")
    assert shared_api.http.get("/v1/jobs", params={"axis": "nobody"}).json()["jobs"] == []
