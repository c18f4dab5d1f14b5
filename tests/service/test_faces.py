"""All faces of an axis say the same of it: fleet, axis, alarm, calibrate page and the API, over states that are drawn.

A few axes are brought into states that nothing but measuring leads to; what else a state has is drawn on top of them.
"""

import html
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from service.documents.change import NotExamined, not_examined
from service.operations.monitoring.alarms import EXPLANATION
from service.store.database import Database
from service.store.tables import AlarmEventRow, AlarmRow, AxisRow, JobRow, MeasurementDocumentRow
from tests.browser import states
from tests.service.conftest import Api, running_service
from tests.service.test_alarm_explanations import MODEL

SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.release) for seed in range(1, 21))]
N_STATES = 100  # for each seed
UNCALIBRATED = ("bare", "frequency", "frequency-alarm", "frequency-stored")
AXES = (*UNCALIBRATED, "never", "learning", "normal", "alert", "alarm", "cleared")
ALARMED = ("alarm", "frequency-alarm")


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """Serve axes in states that nothing but measuring leads to."""
    with running_service(tmp_path_factory.mktemp("faces") / "var") as api:
        for axis in AXES:
            api.register(axis, **states.CONFIGURATION)
            if axis not in UNCALIBRATED:
                api.calibrate(axis)
            if axis not in ("bare", "never"):
                states.measure(api, axis, range(3 if axis == "learning" else 9))
        states.measure(api, "alert", range(9, 12), states.TOO_HIGH)
        for axis in (*ALARMED, "cleared"):
            states.measure(api, axis, range(9, 13), states.WORN)
        (alarm,) = api.http.get("/v1/alarms", params={"axis": "cleared"}).json()["alarms"]
        states.say(api, alarm["id"], "clear", "nut was tightened")
        fitted = api.http.get("/v1/axes/normal/calibrations").json()["calibrations"][0]
        document = {"document": fitted["document"], "comment": "of a sister"}
        api.http.post("/v1/axes/frequency-stored/calibrations", json=document).raise_for_status()
        yield api


@dataclass(frozen=True)
class Drawn:
    """What is drawn of a state."""

    axis: str
    has_model: bool
    has_friction: bool
    is_silent: bool
    is_judged_anew: bool
    status: str  # of the alarm
    owner: str | None
    is_shelved: bool
    cause: str  # refused, examined or none of both
    job: str | None  # that looks for the cause


def draw(rng: np.random.Generator) -> Drawn:
    def any_of(*options: Any) -> Any:
        return options[rng.integers(len(options))]

    status = any_of("active", "acknowledged")
    return Drawn(
        axis=any_of(*AXES, *ALARMED, *ALARMED),
        has_model=any_of(True, False),
        has_friction=any_of(True, False),
        is_silent=any_of(True, False),
        is_judged_anew=any_of(True, False, False),
        status=status,
        owner=any_of("Anna", "Bert") if status == "acknowledged" else None,
        is_shelved=any_of(True, False, False),
        cause=any_of("none", "none", "refused"),
        job=any_of(None, "queued", "failed"),
    )


def bring_about(database: Database, drawn: Drawn) -> None:
    """Store what was drawn."""
    at = datetime.now(UTC)
    with database.write() as session:
        session.query(JobRow).delete()
        axis = session.get_one(AxisRow, drawn.axis)
        axis.configuration = axis.configuration | {
            "drive_model": MODEL if drawn.has_model else None, "silent_after_hours": 1.0 if drawn.is_silent else 1e6,
        }  # fmt: skip
        if axis.last_measurement_id is not None:
            last = session.get_one(MeasurementDocumentRow, axis.last_measurement_id)
            last.outcome = last.outcome | {"friction_torque_nm": 0.011 if drawn.has_friction else None}
        times = {"done": 0, "created_at": at, "updated_at": at, "owner": "x", "lease_until": at + timedelta(days=1)}
        if drawn.is_judged_anew:
            asked = {"calibration": 7, "dry_run": False}
            job = {"id": "anew", "kind": "rejudgement", "axis_id": axis.id, "arguments": asked, "status": "running"}
            session.add(JobRow(**job, **times))
        alarm = session.query(AlarmRow).filter_by(axis_id=axis.id).one_or_none()
        if alarm is None or axis.id not in ALARMED:
            return
        alarm.status = drawn.status
        alarm.shelved_until = at + timedelta(days=2) if drawn.is_shelved else None
        session.query(AlarmEventRow).filter_by(alarm_id=alarm.id, new_status="acknowledged").delete()
        if drawn.owner is not None:
            seen = {"alarm_id": alarm.id, "old_status": "active", "new_status": "acknowledged", "who": drawn.owner}
            session.add(AlarmEventRow(at=at, reason="seen", **seen))
        alarm.explanation = not_examined(NotExamined.NOT_YET)
        if drawn.cause == "refused":
            recent = {"n_measurements": 3, "first_at": "2026-03-01T00:00:00Z", "last_at": "2026-03-03T00:00:00Z"}
            refused = {"reason": "refused", "sentence": "cause not examined: of a test", "recent": recent}
            alarm.explanation = alarm.explanation | refused
        if drawn.job is not None:
            asked = {"alarm": alarm.id}
            job = {"id": "cause", "kind": EXPLANATION, "axis_id": axis.id, "arguments": asked, "status": drawn.job}
            session.add(JobRow(**job, **times))


def text_of(page: str) -> str:
    """Return what a person reads of a page."""
    body = re.sub(r"<(script|style|svg|pre)\b.*?</\1>", " ", page[page.index("<main") :], flags=re.DOTALL)
    return re.sub(r" (?=[.,;:])", "", " ".join(html.unescape(re.sub(r"<[^>]+>", " ", body)).split()))


def faces_of(api: Api, axis: str) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the text of each page that speaks of an axis, and what the API says of it."""
    told = {
        name: api.http.get(f"/v1/{address}").raise_for_status().json()
        for name, address in (
            ("axis", f"axes/{axis}"), ("standing", f"axes/{axis}/standing"), ("alarms", f"alarms?axis={axis}"),
        )
    }  # fmt: skip
    told["alarm"] = next((a for a in told["alarms"]["alarms"] if a["status"] in ("active", "acknowledged")), None)
    addresses = {"axis": f"/axes/{axis}", "fleet": f"/?q={axis}", "calibrate": f"/axes/{axis}/calibrate"}
    if told["alarm"] is not None:
        addresses |= {"alarm": f"/alarms/{told['alarm']['id']}", "alarms": "/alarms"}
    browser = {"accept": "text/html"}
    pages = {name: api.http.get(to, headers=browser).raise_for_status().text for name, to in addresses.items()}
    for name, link in (("fleet", f"/axes/{axis}"), ("alarms", addresses.get("alarm"))):
        if name in pages:  # its line alone: others stand otherwise
            row = re.search(rf'<tr>(?:(?!<tr>).)*?href="{link}".*?</tr>', pages[name], re.DOTALL)
            assert row is not None
            pages[name] = f"<main>{row.group()}"
    return {name: text_of(page) for name, page in pages.items()}, told


#: Of what a face may claim: how it says that it is so, and that it is not.
CLAIMS = {
    "a calibration is in force": (
        r"Calibration \d+ is in force|inside the calibration|sees [\d.]+ N and more|in force number \d+, since",
        r"[Nn]one (is )?in force|would add newtons|None is in force yet",
    ),
    "it is judged anew": (
        r"is being judged anew|comes into force when|in force when",
        r"Look at calibration \d+ and activate it|Review it and put it in force|a calibration is stored",
    ),
    "the drive model is known": (r"The axis has a drive model", r"has no drive model"),
    "the friction torque is known": (
        r"friction torque [\d.]+ N·m|compare the friction torque", r"no friction torque"
    ),
    "an alarm stands": (
        r"Nobody has the alarm|nobody has it yet|has the alarm\.|seen by|Shelved until|shelved until",
        r"None was raised|No loss|No alarm is open|Nothing is to be done",
    ),
    "somebody has the alarm": (
        r"(Anna|Bert|Somebody) has the alarm|seen by (Anna|Bert)", r"[Nn]obody has (it|the alarm) yet"
    ),
    "the alarm rests": (r"[Ss]helved until", r"[Nn]obody has (it|the alarm) yet"),
    "the last was accepted": (r"✓ accepted", r"✗ refused|the last was refused"),
    "it is silent": (
        r"Nothing is known about the preload now|Nothing was accepted since \d",
        r"No loss of preload is seen|now it loses",
    ),
}  # fmt: skip


def truth_of(drawn: Drawn, told: dict[str, Any]) -> dict[str, bool]:
    """Return what is so, by what was drawn."""
    axis, alarm = told["axis"], told["alarm"]
    return {
        "a calibration is in force": axis["active_calibration"] is not None,
        "it is judged anew": drawn.is_judged_anew,
        "the drive model is known": drawn.has_model,
        "the friction torque is known": drawn.has_friction and axis["last_measurement"] is not None,
        "an alarm stands": alarm is not None,
        "somebody has the alarm": alarm is not None and alarm["status"] == "acknowledged",
        "the alarm rests": alarm is not None and drawn.is_shelved,
        "the last was accepted": axis["last_measurement"] is not None and not axis["last_measurement"]["refused"],
        "it is silent": drawn.is_silent and axis["last_measurement"] is not None,
    }


def contradictions(drawn: Drawn, texts: dict[str, str], told: dict[str, Any]) -> Iterator[str]:
    """Yield what one face says against another one, or against what is so."""
    for claim, is_so in truth_of(drawn, told).items():
        for face, text in texts.items():
            found = re.search(CLAIMS[claim][int(is_so)], text)
            if found is not None:
                yield f"{face}: “{found.group()}”, and {claim}: {is_so}"
    standing, axis, alarm = told["standing"], told["axis"], told["alarm"]
    for sentence in (standing["sentence"], standing["next_step"]):
        if sentence not in texts["axis"]:
            yield f"API: “{sentence}”, which the page of the axis does not say"
    state = f"{axis['name']} . {axis['state']}"
    for face in ("axis", "fleet"):
        if not re.search(rf"^(\S+ )?(. )?({axis['name']} )?. ?{axis['state']}\b", texts[face]):
            yield f"{face}: {texts[face][:60]!r}, and the API: {state}"
    if standing["state"] != axis["state"]:
        yield f"API: {standing['state']} and {axis['state']}"
    if alarm is not None:
        cause = alarm["explanation"]["sentence"]
        yield from (
            f"{face} does not say “{cause}”" for face in ("axis", "alarm", "alarms") if cause not in texts[face]
        )
        if "three positions" in cause and not cause.endswith("there is one"):
            yield f"measured at one position since the onset, and “{cause}”"
    last = axis["last_measurement"]
    if last is not None and last.get("preload_n") is not None:
        value = f"{last['preload_n']:.0f} N ±"
        yield from (
            f"{face} does not say {value}" for face in ("axis", "fleet", "alarm") if value not in texts.get(face, value)
        )


@pytest.mark.parametrize("seed", SEEDS)
def test_no_face_contradicts_another_one(watched: Api, seed: int) -> None:
    database = Database(f"sqlite:///{watched.data_dir / 'preload.db'}")
    rng = np.random.default_rng(seed)
    for _ in range(N_STATES):
        drawn = draw(rng)
        bring_about(database, drawn)
        assert [drawn, *contradictions(drawn, *faces_of(watched, drawn.axis))] == [drawn]


def test_a_contradiction_is_found() -> None:
    drawn = Drawn("normal", False, False, False, False, "active", None, False, "none", None)
    told: dict[str, Any] = {
        "axis": {"active_calibration": None, "last_measurement": None, "name": "normal", "state": "normal"},
        "standing": {"sentence": "No loss of preload is seen.", "next_step": "Go on.", "state": "normal"},
        "alarm": None,
    }  # fmt: skip
    axis = "normal ● normal No loss of preload is seen. Go on. The axis has a drive model. inside the calibration"
    found = list(contradictions(drawn, {"axis": axis, "fleet": "● alert normal"}, told))
    assert len(found) == 3, found
