"""What the wire can do a person can do from a page: purge, remove a recording, replay a session, enter lost motion."""

from pathlib import Path

import numpy as np
import pytest

from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from service.api.access import scopes_of
from service.app import create_app
from service.operations.access.scopes import Scope
from service.settings import Settings
from service.web.pages import PAGES
from tests.service.conftest import START, Api, running_service, simulated_measurement
from tests.service.test_jobs import wait_for

AXIS = "/v1/axes/{axis}"
#: What each form of a page asks for, as programs do.
OF_FORM = {
    "/alarms/{alarm}/acknowledge": ("POST", "/v1/alarms/{alarm}/acknowledge"),
    "/alarms/{alarm}/clear": ("POST", "/v1/alarms/{alarm}/clear"),
    "/alarms/{alarm}/comment": ("POST", "/v1/alarms/{alarm}/comment"),
    "/alarms/{alarm}/explanations": ("POST", "/v1/alarms/{alarm}/explanations"),
    "/alarms/{alarm}/shelve": ("POST", "/v1/alarms/{alarm}/shelve"),
    "/axes/new": ("PUT", AXIS),
    "/axes/{axis}/archive": ("POST", f"{AXIS}/archive"),
    "/axes/{axis}/calibrate": ("POST", f"{AXIS}/calibration-jobs"),
    "/axes/{axis}/calibrate/{job}/cancel": ("POST", "/v1/jobs/{job}/cancel"),
    "/axes/{axis}/calibrations/{calibration}/activate": ("POST", f"{AXIS}/calibrations/{{calibration}}/activate"),
    "/axes/{axis}/discrepancies": ("POST", f"{AXIS}/discrepancies"),
    "/axes/{axis}/identifications": ("POST", f"{AXIS}/identifications"),
    "/axes/{axis}/import": ("POST", f"{AXIS}/recordings"),
    "/axes/{axis}/import/{recording}": ("POST", f"{AXIS}/recordings/{{recording}}/import"),
    "/axes/{axis}/import/{recording}/remove": ("DELETE", f"{AXIS}/recordings/{{recording}}"),
    "/axes/{axis}/lost-motion": ("POST", f"{AXIS}/lost-motion"),
    "/axes/{axis}/torque/{quantity}/found-in-order": ("POST", f"{AXIS}/torque/{{quantity}}/found-in-order"),
    "/axes/{axis}/settings": ("PUT", AXIS),
    "/axes/{axis}/settings/review": ("PUT", AXIS),
    "/axes/{axis}/stored/pins": ("POST", f"{AXIS}/pins"),
    "/axes/{axis}/stored/rejudgements": ("POST", f"{AXIS}/rejudgements"),
    "/axes/{axis}/stored/replays": ("POST", f"{AXIS}/replays"),
    "/axes/{axis}/stored/unpin": ("DELETE", f"{AXIS}/pins/{{pin}}"),
    "/axes/{axis}/unarchive": ("DELETE", f"{AXIS}/archive"),
    "/axes/{axis}/work": ("POST", f"{AXIS}/maintenance"),
    "/jobs/{job}/cancel": ("POST", "/v1/jobs/{job}/cancel"),
    "/system/purges": ("POST", "/v1/retention/purges"),
    "/trials": ("POST", "/v1/trials"),
    "/trials/end": ("POST", f"{AXIS}/archive"),
}  # fmt: skip


def sent(api: Api, path: str, **fields: object) -> str:
    """Send a form, and return where it leads."""
    answer = api.http.post(path, data=fields, headers={"accept": "text/html"}, follow_redirects=False)
    assert answer.status_code == 303, answer.text
    return answer.headers["location"]


def recorded(path: Path) -> Path:
    """Write a session of one measurement."""
    windows = simulated_measurement(np.random.default_rng(1), "m", n_windows=2)
    write_session(path, Session("axis", tuple(windows)))
    return path


def test_a_form_needs_what_its_route_for_programs_needs() -> None:
    forms = scopes_of(route for router in PAGES for route in router.routes)
    of_api = scopes_of(create_app(Settings()).routes)
    said = {path: scope for (method, path), scope in forms.items() if method == "POST"}
    assert said == {path: of_api.get(same, Scope.ADMIN) for path, same in OF_FORM.items()}


@pytest.mark.parametrize(
    ("form", "typed", "member"),
    [
        ("lost-motion", {"reversal_value_um": "7", "half_interval_um": "-1"}, "reversal_value_interval_95_um"),
        ("stored/replays", {"session": "short", "speed": "-1"}, "speed"),
        ("work", {"kind": "other", "set_preload_n": "-5"}, "set_preload_n"),
    ],
)
def test_what_was_typed_wrong_is_said_in_a_sentence(api: Api, form: str, typed: dict[str, str], member: str) -> None:
    api.register("axis")
    also = {"measurement": "m", "position_mm": "1", "standard_uncertainty_um": "1", "n_reversals": "9"}
    fields = {"at": START.strftime("%Y-%m-%dT%H:%M"), **also, **typed}
    answer = api.http.post(f"/axes/axis/{form}", data=fields, headers={"accept": "text/html"})
    assert answer.status_code == 422
    assert f"<p>{member}: " in answer.text


def test_lost_motion_is_entered_from_the_page_of_the_axis(api: Api) -> None:
    api.register("axis")
    assert 'action="/axes/axis/lost-motion"' in api.http.get("/axes/axis").text
    fields = {
        "at": START.strftime("%Y-%m-%dT%H:%M"), "measurement": "by hand", "position_mm": "500",
        "reversal_value_um": "7,5", "standard_uncertainty_um": "0,2", "half_interval_um": "0,5", "n_reversals": "9",
    }  # fmt: skip
    assert sent(api, "/axes/axis/lost-motion", **fields) == "/axes/axis?done=lost-motion-entered"
    (reading,) = api.http.get("/v1/axes/axis/lost-motion").json()["points"]
    assert (reading["reversal_value_um"], reading["reversal_value_interval_95_um"]) == (7.5, [7.0, 8.0])
    assert "Umkehrspanne" in api.http.get("/axes/axis", headers={"accept-language": "de"}).text


def test_the_files_of_a_recording_are_removed_from_its_page(api: Api, tmp_path: Path) -> None:
    api.register("axis")
    session = recorded(tmp_path / "a.session.h5")
    job = api.http.post("/v1/axes/axis/recordings", files={"file": (session.name, session.read_bytes())}).json()
    wait_for(api, job["id"], "done")
    (uploaded,) = api.http.get("/v1/axes/axis/recordings").json()["recordings"]
    number = uploaded["id"]
    page = f"/axes/axis/import/{number}"
    assert api.http.post(f"{page}/remove").status_code == 422  # no tick
    assert sent(api, f"{page}/remove", known="true") == "/axes/axis/import?done=removed"
    assert api.http.get(f"/v1/axes/axis/recordings/{number}").status_code == 404


def test_a_session_is_replayed_from_the_page_of_stored_periods(tmp_path: Path) -> None:
    folder = tmp_path / "replay"
    folder.mkdir()
    recorded(folder / "short.session.h5")
    with running_service(tmp_path / "var", replay_dir=folder) as api:
        api.register("axis", windows_per_measurement=2)
        assert "<option>short</option>" in api.http.get("/axes/axis/stored").text
        job = sent(api, "/axes/axis/stored/replays", session="short", speed="")
        assert api.http.get(f"/v1{job.partition('?')[0]}").json()["kind"] == "replay"
        assert api.http.post("/axes/axis/stored/replays", data={"session": "none"}).status_code == 404


@pytest.mark.parametrize("days", [None, 30])
def test_a_purge_is_begun_from_the_page_of_the_system(tmp_path: Path, days: int | None) -> None:
    with running_service(tmp_path, keep_raw_days=days) as api:
        assert "/system/purges" not in api.http.get("/system").text  # nothing is old enough
        assert api.http.post("/system/purges", data={"windows": "0"}).status_code == 422  # no tick
        asked = {"windows": "1", "known": "true"}
        refused = api.http.post("/system/purges", data=asked, headers={"accept": "text/html", "accept-language": "de"})
        assert refused.status_code == 409
        assert "jetzt sind es 0" in refused.text
        if days is None:
            assert api.http.post("/system/purges", data={"windows": "0", "known": "true"}).status_code == 409
        else:
            job = sent(api, "/system/purges", windows=0, known="true")
            assert api.http.get(f"/v1{job.partition('?')[0]}").json()["kind"] == "purge"
