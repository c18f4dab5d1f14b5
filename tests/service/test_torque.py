"""Drag torque and orders of the screw in the service: sent, charted against their own past, shown on the page."""

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import PROJECT_ROOT
from tests.preload.test_torque_windows import write_log
from tests.service.conftest import START, Api, assert_problem
from tests.service.test_page_forms import sent as sent_form

HEALTHY = 24


def reading(rng: np.random.Generator, day: float, quantity: str, level: float, **stated: Any) -> dict[str, Any]:
    value = level * rng.normal(1.0, 0.02)
    return {
        "at": (START + timedelta(days=day)).isoformat(), "measurement": f"day-{day:g}", "position_mm": 150.0,
        "speed_mm_per_s": 100.0,
        "quantity": quantity, "value": value, "unit": "N·m", "standard_uncertainty": 0.005 * level,
        "interval_95": [value - 0.01 * level, value + 0.01 * level], "n_repeats": 4,
    } | stated  # fmt: skip


def send(api: Api, axis: str, readings: list[dict[str, Any]]) -> dict[str, Any]:
    return api.http.post(f"/v1/axes/{axis}/torque", json={"readings": readings}).raise_for_status().json()


def told(api: Api, axis: str, quantity: str) -> dict[str, Any]:
    return api.http.get(f"/v1/axes/{axis}/torque/{quantity}").raise_for_status().json()


def test_each_quantity_is_charted_against_its_own_past(shared_api: Api) -> None:
    """Drag torque that falls is seen, and a ripple that rises; what goes the other way, or stays, is none."""
    shared_api.register("mill")
    rng, sent = np.random.default_rng(1), list[dict[str, Any]]()
    for day in range(HEALTHY + 16):
        lost = 1.0 - 0.02 * max(day - HEALTHY, 0)
        sent.append(reading(rng, day, "drag-torque", 0.8 * lost))
        sent.append(reading(rng, day, "screw-order", 0.03))
        sent.append(reading(rng, day, "ball-pass-order", 0.01 * (2.0 - lost)))
    assert send(shared_api, "mill", sent) == {"accepted": len(sent), "already_there": 0}
    assert send(shared_api, "mill", sent[:9]) == {"accepted": 0, "already_there": 9}
    drag, screw, balls = (told(shared_api, "mill", of) for of in ("drag-torque", "screw-order", "ball-pass-order"))
    assert [drag["state"], screw["state"], balls["state"]] == ["alarm", "normal", "alarm"]
    states = [point["state"] for point in drag["points"]]
    assert states[:8] == ["learning"] * 7 + ["normal"]
    assert HEALTHY < states.index("alarm") < HEALTHY + 16
    assert drag["baseline"] == pytest.approx(0.8, rel=0.02)
    low, high = drag["prediction_interval_95"]
    assert low < 0.8 < high
    baseline = re.escape(f"{drag['baseline']:.3g}")
    sentence = rf"It has fallen since (.*): it is 0\.5\d* N·m now, the baseline is {baseline} N·m\."
    (since,) = re.findall(sentence, drag["sentence"])
    assert re.match(r"It has risen since .* N·m now, the baseline is", balls["sentence"])
    assert abs(datetime.fromisoformat(since).replace(tzinfo=UTC) - START - timedelta(days=HEALTHY)) < timedelta(days=6)
    assert screw["sentence"].startswith("It is as it was learnt: 0.0")
    page = shared_api.http.get("/axes/mill").text
    for quantity in ("drag-torque", "screw-order", "ball-pass-order"):
        assert f'<section id="{quantity}">' in page
    assert 'aria-label="Drag torque over time"' in page
    # the preload was not looked at, and no alarm is raised beside its own
    assert shared_api.axis("mill")["open_alarms"] == 0
    assert shared_api.axis("mill")["lost_motion"] is None
    assert told(shared_api, "mill", "drag-torque")["false_alarms_per_year"] > 0.0


def test_a_new_nut_begins_the_charts_anew(shared_api: Api) -> None:
    shared_api.register("nut")
    rng = np.random.default_rng(2)
    send(shared_api, "nut", [reading(rng, day, "drag-torque", 0.8) for day in range(12)])
    assert told(shared_api, "nut", "drag-torque")["baseline"] is not None
    entry = {"at": (START + timedelta(days=11.5)).isoformat(), "who": "Anna", "kind": "nut-replaced"}
    shared_api.http.post("/v1/axes/nut/maintenance", json=entry).raise_for_status()
    send(shared_api, "nut", [reading(rng, 12, "drag-torque", 1.2)])
    now = told(shared_api, "nut", "drag-torque")
    assert (now["state"], now["baseline"]) == ("learning", None)
    send(shared_api, "nut", [reading(rng, 11.7, "screw-order", 0.03), reading(rng, 11.2, "screw-order", 0.1, unit="A")])
    assert 'aria-label="Drag torque over time"' in shared_api.http.get("/axes/nut").text


def test_a_reading_from_elsewhere_is_not_said_to_be_as_learnt(shared_api: Api) -> None:
    """The sentence tells the newest that was compared, on a page without readings too."""
    shared_api.register("elsewhere")
    rng = np.random.default_rng(4)
    assert told(shared_api, "elsewhere", "drag-torque")["sentence"] == "It was not measured: nothing is known of it."
    sent = [reading(rng, day, "drag-torque", 0.8) for day in range(20)]
    other = [
        reading(rng, 20, "drag-torque", 0.1, position_mm=400.0), reading(rng, 21, "drag-torque", 0.1, speed_mm_per_s=89)
    ]  # fmt: skip
    send(shared_api, "elsewhere", [*sent, *other])
    now = told(shared_api, "elsewhere", "drag-torque")
    assert [point["uncharted"] for point in now["points"][-3:]] == [None, "other-place", "other-speed"]
    assert (now["state"], now["watched_at_mm"], now["watched_at_mm_per_s"]) == ("normal", 150.0, 100.0)
    assert f"{sent[-1]['value']:.3g} N·m" in now["sentence"]
    later = {"from": (START + timedelta(days=400)).isoformat()}
    empty = shared_api.http.get("/v1/axes/elsewhere/torque/drag-torque", params=later).json()
    assert (empty["points"], empty["sentence"]) == ([], now["sentence"])


def lubricated(api: Api, axis: str, at: datetime) -> None:
    entry = {"at": at.isoformat(), "who": "Anna", "kind": "lubricated"}
    api.http.post(f"/v1/axes/{axis}/maintenance", json=entry).raise_for_status()


def found_in_order(api: Api, axis: str, _: datetime) -> None:
    api.http.post(f"/v1/axes/{axis}/torque/drag-torque/found-in-order").raise_for_status()


def found_in_order_on_the_page(api: Api, axis: str, _: datetime) -> None:
    (address,) = re.findall(r'action="([^"]*/found-in-order)"', api.http.get(f"/axes/{axis}").text)
    assert sent_form(api, address) == f"/axes/{axis}?done=learnt-anew"


@pytest.mark.parametrize("look", [lubricated, found_in_order, found_in_order_on_the_page])
def test_an_alarm_of_torque_ends_with_grease_or_a_look(shared_api: Api, look: Callable[..., None]) -> None:
    """A fall that came once is an alarm; with the new level learnt the chart watches that."""
    axis, rng = look.__name__.replace("_", "-"), np.random.default_rng(5)
    shared_api.register(axis)
    sent = [reading(rng, day, "drag-torque", 0.8 if day < HEALTHY else 0.6) for day in range(HEALTHY + 8)]
    send(shared_api, axis, sent)
    assert told(shared_api, axis, "drag-torque")["state"] == "alarm"
    look(shared_api, axis, START + timedelta(days=HEALTHY + 7.5))
    now = told(shared_api, axis, "drag-torque")
    assert (now["state"], now["baseline"]) == ("unknown", None)
    send(shared_api, axis, [reading(rng, HEALTHY + 8 + day, "drag-torque", 0.6) for day in range(20)])
    now = told(shared_api, axis, "drag-torque")
    assert (now["state"], now["baseline"]) == ("normal", pytest.approx(0.6, rel=0.03))
    assert [point["state"] for point in now["points"]].count("alarm") > 0


def test_what_is_wrong_is_refused_whole(shared_api: Api) -> None:
    shared_api.register("refusing")
    good = reading(np.random.default_rng(3), 0, "drag-torque", 0.8)
    for wrong, status in (
        ({"quantity": "preload"}, 422),
        ({"unit": "lbf"}, 422),
        ({"measurement": "another"}, 409),
        ({"interval_95": [0.9, 1.0]}, 422),
        ({"at": START.isoformat(), "unit": "A"}, 409),
        ({"at": (START + timedelta(days=1)).isoformat(), "unit": "A"}, 422),
    ):
        answer = shared_api.http.post("/v1/axes/refusing/torque", json={"readings": [good, good | wrong]})
        assert answer.status_code == status, answer.text
        assert told(shared_api, "refusing", "drag-torque")["points"] == []
    assert_problem(shared_api.http.post("/v1/axes/none/torque", json={"readings": [good]}), 404, "unknown-resource")
    assert 'id="drag-torque"' not in shared_api.http.get("/axes/refusing").text


def test_a_log_is_read_and_sent_in_one_command(
    shared_api: Api, preload: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared_api.register("mill-x")
    page = (PROJECT_ROOT / "docs/how-to/drive-signals.md").read_text(encoding="utf-8")
    write_log(tmp_path)
    (channels,) = re.findall(r'```toml title="strokes.toml"\n(.*?)```', page, re.DOTALL)
    (tmp_path / "strokes.toml").write_text(channels.replace("position_mm = 150", "position_mm = 900"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (command,) = re.findall(r"\$ \.venv/bin/preload (torque [^\n]*)", page)
    sending = (*command.split(), "--url", str(shared_api.http.base_url))
    assert "give both" in preload(*sending).err
    assert preload(*sending, "--axis", "mill-x").out.splitlines()[-1] == "sent to axis mill-x: 3 new, 0 already there"
    (point,) = told(shared_api, "mill-x", "ball-pass-order")["points"]
    assert (point["unit"], point["position_mm"]) == ("N·m", pytest.approx(150.0, abs=5.0))
    assert point["speed_mm_per_s"] == pytest.approx(50.0, rel=0.05)
    assert point["interval_95"][0] < 0.012 < point["interval_95"][1]
