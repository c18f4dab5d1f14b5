"""The alarm of several numbers together in the service: raised, shown, gone on with by the preload's own chart."""

import re
from collections.abc import Sequence
from datetime import timedelta
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import preload_client
from monitor_core.axis_state import advance_feature, inverse_square
from monitor_core.uncertainty import Estimate
from service.operations.monitoring.alarm_changes import settle_alarms
from service.operations.monitoring.intake import charts
from service.operations.monitoring.intake.charts import put_in
from service.store import intake
from service.store.database import Database
from service.store.tables import MeasurementDocumentRow, MeasurementRow
from service.store.trend.points import TrendPoint
from tests.conftest import canary
from tests.service.conftest import START, Api

#: Of them the first twenty teach the law of the axis, the next twenty what its numbers have in common.
HEALTHY = 60
Point = tuple[float, float, float]  # day, frequency [Hz], friction torque [N·m]


def wearing(seed: int, days: int) -> list[Point]:
    """Frequency and torque scatter by .3 and 2 %; then they lie .3 and 5 % lower, and fall on."""
    rng, points = np.random.default_rng(seed), []
    for day in range(days):
        gone = 0.0 if day < HEALTHY else 1.0 + 0.05 * max(day - HEALTHY - 8, 0)
        frequency = 178.0 * (1.0 + 0.003 * rng.normal() - 0.003 * gone)
        points.append((day, frequency, 0.4 * (1.0 + 0.02 * rng.normal() - 0.05 * gone)))
    return points


def judge(api: Api, axis_id: str, measured: Sequence[Point]) -> None:
    """Put measurements of an axis without a calibration into its charts, as those are that were just judged."""
    database = Database(f"sqlite:///{api.data_dir}/preload.db")
    with database.write(axis_id) as session:
        connection, new = session.connection(), []
        axis = intake.read_axis(connection, axis_id)
        for day, frequency, torque in measured:
            at = START + timedelta(days=day)
            row = MeasurementRow(
                axis_id=axis_id, name=f"day-{day}", started_at=at, ended_at=at, position_mm=500.0, status="judged",
                n_accepted=15, judged_at=at,
            )  # fmt: skip
            session.add(row)
            session.flush()
            session.add(MeasurementDocumentRow(measurement_id=row.id, outcome={"refused": False}, response=None))
            own = inverse_square(Estimate(frequency, 0.05)).standard_uncertainty
            new.append(
                TrendPoint(
                    axis_number=axis.number, at=at, measurement_id=row.id, name=row.name, position_mm=500.0,
                    set_preload_n=None, payload_kg=0.0, temperature_c=21.0, refusal_reason=None, calibration_id=None,
                    frequency_hz=frequency, preload_n=None, interval_lower_n=None, interval_upper_n=None,
                    drag_torque_nm=None, feature_s2=None, feature_uncertainty_s2=own, epoch=0, uncharted=None,
                    state="unknown", baseline_preload_n=None, friction_torque_nm=torque, frequency_uncertainty_hz=0.05,
                )
            )  # fmt: skip
        session.flush()
        before = intake.read_charts(connection, axis)
        folded = put_in(connection, axis, before, new, replaced=[], calibration=None)
        settle_alarms(connection, axis, folded)
        intake.save_charts(connection, axis, before, folded.charts)
    database.close()


def alarms_of(api: Api, axis: str) -> list[dict[str, Any]]:
    return api.http.get("/v1/alarms", params={"axis": axis}).raise_for_status().json()["alarms"]


@pytest.fixture
def raised(shared_api: Api, request: pytest.FixtureRequest) -> tuple[Api, str, list[Point]]:
    """Serve an axis whose numbers together alarm, while its preload alone does not; what comes later is not sent."""
    axis, points = re.sub(r"\W", "-", request.node.name)[:60], wearing(2, HEALTHY + 25)
    shared_api.register(axis, baseline_size=20, baseline_days=14)
    judge(shared_api, axis, points[:HEALTHY])
    assert alarms_of(shared_api, axis) == []
    later = points[HEALTHY:]
    while not alarms_of(shared_api, axis):
        judge(shared_api, axis, [later.pop(0)])
    return shared_api, axis, later


def test_several_numbers_raise_an_alarm_of_their_own_with_the_share_of_each(
    raised: tuple[Api, str, list[Point]],
) -> None:
    api, axis, _ = raised
    (alarm,) = alarms_of(api, axis)
    assert (alarm["kind"], alarm["status"], alarm["evidence"]["preload_n"]) == ("several-numbers", "active", None)
    numbers = {number["number"]: number for number in alarm["evidence"]["numbers"]}
    assert sum(number["share"] for number in numbers.values()) == pytest.approx(1.0)
    for name, percent in (("frequency", -0.3), ("friction-torque", -5.0)):
        lower, upper = numbers[name]["interval_95_percent"]
        assert lower < percent < upper
    # the preload's own chart has seen nothing, and the fleet shows the axis as one that needs somebody
    assert api.axis(axis)["state"] != "alarm"
    assert api.axis(axis)["open_alarms"] == 1
    history = api.http.get(f"/v1/axes/{axis}/history").json()["together"]
    assert [number["share"] for number in history["alarm"]["numbers"]] == [each["share"] for each in numbers.values()]
    page = api.http.get(f"/alarms/{alarm['id']}").raise_for_status().text
    assert "several numbers of" in page
    for number in numbers.values():
        assert f"{100.0 * number['share']:.2g}" in page
    assert "Several numbers together have changed since" in api.http.get(f"/axes/{axis}").text
    for path in (f"/axes/{axis}", f"/alarms/{alarm['id']}", "/alarms", "/"):
        assert not re.search(r"None\b(?! was| in force)", api.http.get(path).raise_for_status().text)
    table = api.http.get("/v1/alarms", params={"axis": axis, "format": "csv"}).raise_for_status().text
    assert "several-numbers" in table
    with preload_client.Client(str(api.http.base_url)) as client:
        assert [each["kind"] for each in client.alarms(axis=axis)] == ["several-numbers"]


def test_the_preloads_own_chart_goes_on_with_the_alarm_of_several_numbers(raised: tuple[Api, str, list[Point]]) -> None:
    """One cause, one alarm: who has seen it is not asked again, and a person's clearing learns the level anew."""
    api, axis, later = raised
    (first,) = alarms_of(api, axis)
    api.http.post(f"/v1/alarms/{first['id']}/acknowledge", json={"comment": "seen"}).raise_for_status()
    while alarms_of(api, axis)[0]["kind"] == "several-numbers":
        judge(api, axis, [later.pop(0)])
    (alarm,) = alarms_of(api, axis)
    assert (alarm["id"], alarm["kind"], alarm["status"]) == (first["id"], "preload-loss", "acknowledged")
    assert alarm["events"][-1]["reason"] == "the preload's own chart raises it now, too"
    assert alarm["evidence"]["frequency_fall_percent"] > 0.0
    assert api.axis(axis)["state"] == "alarm"
    api.http.post(f"/v1/alarms/{first['id']}/clear", json={"comment": "new spacer"}).raise_for_status()
    assert api.http.get(f"/v1/axes/{axis}/history").json()["together"]["alarm"] is None


def test_late_measurements_change_which_chart_raises_the_alarm_and_not_who_has_seen_it(
    raised: tuple[Api, str, list[Point]],
) -> None:
    api, axis, later = raised
    (first,) = alarms_of(api, axis)
    api.http.post(f"/v1/alarms/{first['id']}/acknowledge", json={"comment": "seen"}).raise_for_status()

    def stands(kind: str, reason: str) -> None:
        (alarm,) = alarms_of(api, axis)
        assert (alarm["id"], alarm["kind"], alarm["status"]) == (first["id"], kind, "acknowledged")
        assert alarm["events"][-1]["reason"] == reason

    judge(api, axis, [(HEALTHY - 5.5, 178.0, 0.4), *later])  # the first comes late, with what tips the preload's chart
    stands("preload-loss", "the preload's own chart raises it now, too")
    judge(api, axis, [(day + 0.3, 179.5, torque) for day, _, torque in later])  # it was not the frequency that fell
    stands("several-numbers", "several numbers together raise it, the preload's own chart does not any more")


def test_a_late_measurement_folds_from_the_last_checkpoint_however_long_the_alarm_stands(
    raised: tuple[Api, str, list[Point]], monkeypatch: pytest.MonkeyPatch
) -> None:
    api, axis, later = raised
    rng, first = np.random.default_rng(3), int(later[0][0])
    lasting = [(day, 178.0 + 0.5 * rng.normal(), 0.35 + 0.008 * rng.normal()) for day in range(first, first + 110)]
    judge(api, axis, lasting)
    steps = Mock(wraps=advance_feature)
    monkeypatch.setattr(charts, "advance_feature", steps)
    judge(api, axis, [(first + 109.5, 178.0, 0.35), (first + 108.5, 178.0, 0.35)])
    assert [alarm["kind"] for alarm in alarms_of(api, axis)] == ["several-numbers"]
    assert api.http.get(f"/v1/axes/{axis}/history").json()["together"]["alarm"] is not None
    assert 0 < steps.call_count <= charts.CHECKPOINT_EVERY + 2


@pytest.mark.parametrize("seed", canary([2, 4]))
def test_any_order_of_arrival_gives_one_history_of_alarms(shared_api: Api, seed: int) -> None:
    points = wearing(seed, HEALTHY + 25)
    order = np.random.default_rng(seed).permutation(len(points))
    told = []
    for name, batches in (
        ("at-once", [points]),
        ("one-by-one", [points[:HEALTHY], *([point] for point in points[HEALTHY:])]),
        ("shuffled", [[points[i] for i in order[begin : begin + 17]] for begin in range(0, len(order), 17)]),
    ):
        axis = f"{name}-{seed}"
        shared_api.register(axis, baseline_size=20, baseline_days=14)
        for batch in batches:
            judge(shared_api, axis, batch)
        told.append([(alarm["kind"], alarm["evidence"]) for alarm in alarms_of(shared_api, axis)])
    assert [kind for kind, _ in told[0]] == ["preload-loss"]
    assert told[0] == told[1] == told[2]
