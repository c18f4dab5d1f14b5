"""A data folder of each landed version with a standing alarm says, opened by this one, what it said before.

``python -m tests.service.older_folder COMMIT`` makes the folder of a version, written by that version itself.
"""

import json
import math
import sqlite3
import tarfile
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.operations.monitoring.alarm_changes import settle_alarms
from service.operations.monitoring.intake.charts import Folded
from service.store import intake
from service.store.alarms import events_of, get_alarm
from service.store.database import Database, writing
from tests.service.conftest import Api, running_service, simulated_measurement
from tests.service.older_folder import ARCHIVES

VERSIONS = sorted(path.name.removesuffix(".tar.xz") for path in ARCHIVES.glob("*.tar.xz"))


def extracted(version: str, folder: Path) -> Path:
    with tarfile.open(ARCHIVES / f"{version}.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


@pytest.fixture(params=VERSIONS)
def older(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return extracted(request.param, tmp_path)


@pytest.fixture
def newest(tmp_path: Path) -> Path:
    """Return a folder that needs no step, so that a test may change it."""
    return extracted("924dedb", tmp_path)


def differences(expected: Any, got: Any, place: str = "", within: float = 0.0) -> list[str]:
    """Name what an older program said and this one says otherwise, by more than a share; it may say more."""
    if isinstance(expected, dict) and isinstance(got, dict):
        return [
            each
            for key, value in expected.items()
            for each in differences(value, got.get(key), f"{place}/{key}", within)
        ]
    if isinstance(expected, list) and isinstance(got, list) and len(expected) == len(got):
        return differences(dict(enumerate(expected)), dict(enumerate(got)), place, within)
    if isinstance(expected, float) and isinstance(got, float) and math.isclose(expected, got, rel_tol=within):
        return []
    return [] if _plain(expected) == _plain(got) else [f"{place}: {expected!r} is {got!r} now"]


def _plain(value: Any) -> Any:
    """Return a moment, which was written in two ways, as such."""
    try:
        return datetime.fromisoformat(value)
    except (TypeError, ValueError):
        return value


def said(api: Api, answers: dict[str, Any]) -> list[str]:
    return [each for path, expected in answers.items() for each in differences(expected, api.http.get(path).json())]


def notices(folder: Path) -> list[Any]:
    with closing(sqlite3.connect(folder / "var" / "preload.db")) as connection:
        return connection.execute("SELECT kind, content FROM notices ORDER BY id").fetchall()


def test_older_folder_says_what_it_said_and_nobody_is_told(older: Path) -> None:
    answers = json.loads((older / "answers.json").read_text())
    told = notices(older)
    with running_service(older / "var") as api:
        assert said(api, answers) == []
        assert api.axis("worn")["state"] == "alarm"
        assert [alarm["status"] for alarm in api.http.get("/v1/alarms?axis=worn").json()["alarms"]] == ["acknowledged"]
    assert notices(older) == told


def changed(folder: Path, *statements: str) -> None:
    """Change what is stored as an older program would have left it."""
    with closing(sqlite3.connect(folder / "var" / "preload.db")) as connection:
        for statement in statements:
            assert connection.execute(statement).rowcount > 0
        connection.commit()


#: Charts that were stored by a version before this one.
OUTDATED = "UPDATE axes SET monitor_state = json_set(monitor_state, '$.version', 4)"

#: What commit 924dedb took for an axis, and solved limits for.
OF_FEW_SESSIONS = """UPDATE axes SET configuration = json_set(configuration, '$.moving_mass_kg', 20.0,
'$.moving_mass_standard_uncertainty_kg', 0.0005, '$.measurements_per_year', 0.5, '$.false_alarms_per_year', 0.01,
'$.baseline_days', 0.0005, '$.search_band_hz[1]', 2e6), detector_design = json_set(detector_design,
'$.settings.measurements_per_year', 0.5, '$.settings.false_alarms_per_year', 0.01)"""

SEEN_LATER = """UPDATE alarms SET status = 'acknowledged', measured_at = '2026-04-05 06:00:00.000000',
epoch = (SELECT epoch FROM axes WHERE id = 'repaired') WHERE id = 2"""


def test_charts_of_an_older_version_are_folded_again(newest: Path) -> None:
    answers = json.loads((newest / "answers.json").read_text())
    told = notices(newest)
    changed(newest, OUTDATED)
    with running_service(newest / "var") as api:
        assert said(api, answers) == []
    assert notices(newest) == told


def test_numbers_that_an_older_program_took_are_taken_at_the_bounds_of_this_one(newest: Path) -> None:
    answers = json.loads((newest / "answers.json").read_text())
    changed(newest, OF_FEW_SESSIONS)
    with running_service(newest / "var") as api:
        assert said(api, {path: answer for path, answer in answers.items() if "?" in path}) == []  # trends and alarms
        configuration = api.axis("worn")["configuration"]
        assert configuration["moving_mass_standard_uncertainty_kg"] == 0.0005
        assert (configuration["measurements_per_year"], configuration["baseline_days"]) == (1.0, 0.001)
        assert configuration["search_band_hz"] == [140.0, 1e6]
        late = simulated_measurement(
            np.random.default_rng(1), "late", started_at=datetime(2026, 4, 7, 6, tzinfo=UTC), n_windows=2
        )
        assert api.accept("repaired", late)["measurements"][0]["charted"]
        sent = {"name": "worn", "configuration": configuration | {"measurements_per_year": 0.5}}
        assert api.http.put("/v1/axes/worn", json=sent).status_code == 422
    changed(newest, OUTDATED, OF_FEW_SESSIONS)
    with running_service(newest / "var") as api:
        assert api.axis("worn")["state"] == "alarm"


def test_charts_of_an_axis_whose_configuration_cannot_be_read_are_left_as_they_are(newest: Path) -> None:
    changed(
        newest,
        OUTDATED,
        "UPDATE axes SET configuration = json_set(configuration, '$.windows_per_measurement', 0)",
        "INSERT INTO chart_checkpoints SELECT axis_number, epoch, '2026-03-30 06:00:00.000000', '{}' FROM chart_epochs",
    )
    charts = [charts_of(newest)]
    with running_service(newest / "var") as api:
        charts.append(charts_of(newest))
        assert "cannot be read" in api.http.get("/v1/axes/worn").text
    assert charts[0] == charts[1]


def charts_of(folder: Path) -> list[list[Any]]:
    with closing(sqlite3.connect(folder / "var" / "preload.db")) as connection:
        return [
            connection.execute(f"SELECT * FROM {table}").fetchall()  # noqa: S608 - a name of ours
            for table in ("chart_checkpoints", "chart_epochs", "axes")
        ]


def test_only_a_person_ends_an_alarm_that_the_charts_of_this_version_do_not_raise(newest: Path) -> None:
    """Neither the start does, nor a late measurement; to clear it begins a new level, as for any other."""
    changed(newest, OUTDATED, SEEN_LATER)
    told = notices(newest)
    with running_service(newest / "var") as api:
        alarm = api.http.get("/v1/alarms/2").json()
        assert alarm["status"] == "acknowledged"
        assert alarm["events"][-1]["reason"].startswith("another version of the program does not raise it")
        assert notices(newest) == told
        late = simulated_measurement(
            np.random.default_rng(1), "late", started_at=datetime(2026, 4, 4, 18, tzinfo=UTC), n_windows=2
        )
        assert api.accept("repaired", late)["measurements"][0]["charted"]
        assert api.http.get("/v1/alarms/2").json()["status"] == "acknowledged"
        assert api.axis("repaired")["state"] == "normal"
        api.http.post("/v1/alarms/2/clear", json={"comment": "looked at"}).raise_for_status()
        api.accept("repaired", simulated_measurement(
            np.random.default_rng(2), "next", started_at=datetime(2026, 4, 7, 6, tzinfo=UTC), n_windows=2
        ))  # fmt: skip
        assert api.axis("repaired")["state"] == "learning"
    assert notices(newest)[len(told) :] != []


def test_an_alarm_that_an_older_program_withdrew_without_calibration_is_raised_again(newest: Path) -> None:
    """As commit 7bd100f left a folder of commit 5c78000: charts that know nothing, in no epoch."""
    answers = json.loads((newest / "answers.json").read_text())
    changed(
        newest,
        "UPDATE alarms SET status = 'withdrawn', epoch = 0 WHERE id = 1",
        "UPDATE axes SET monitor_state = NULL, state = 'unknown', epoch = 0",
        "UPDATE trend_points SET state = 'unknown', epoch = 0",
        "UPDATE sessions SET epoch = 0",
        "DELETE FROM chart_epochs",
    )
    with running_service(newest / "var") as api:
        (again,) = api.http.get("/v1/alarms?axis=worn").json()["alarms"]
        assert api.axis("worn")["state"] == "alarm"
        assert (again["status"], again["measurement_id"]) == ("active", 22)
        assert said(api, {path: answer for path, answer in answers.items() if "alarms" not in path}) == []
    assert [kind.rpartition(".")[2] for kind, _ in notices(newest)][-1] == "raised"


@pytest.mark.parametrize(("epochs", "status"), [(frozenset(), "acknowledged"), (frozenset((1,)), "withdrawn")])
def test_only_charts_that_watch_something_withdraw_an_alarm(newest: Path, epochs: frozenset[int], status: str) -> None:
    """The same charts, which raise none: where they watched nothing they could not have raised any."""
    database = Database(f"sqlite:///{newest}/var/preload.db")
    with database.connect() as connection, writing(connection):
        axis = intake.read_axis(connection, "worn")
        charts = intake.read_charts(connection, axis)
        folded = Folded(charts, {}, (), None, again=True, since_epoch=1, watched=epochs)
        settle_alarms(connection, axis, folded, "another calibration")
    with database.read() as session:
        assert get_alarm(session, 1).status == status
        assert events_of(session, [1])[1][-1].reason == (
            "seen, ordered a nut" if status == "acknowledged" else "with another calibration the charts raise none"
        )
    database.close()
