"""Machines own axes, an axis is archived and taken back, and what is left of the commissioned preload is said."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from service.cli.main import command_named
from tests.service.conftest import Api, assert_problem, readings, simulated_measurement


def listed(api: Api, **query: Any) -> list[str]:
    return [axis["id"] for axis in api.http.get("/v1/axes", params=query).json()["axes"]]


def measured(api: Api, axis: str) -> None:
    api.accept(axis, simulated_measurement(np.random.default_rng(1), "m", preload=240.0), complete=True)


def test_a_machine_is_as_well_as_the_worst_of_its_axes(api: Api) -> None:
    api.register("x", machine="Mill 3", machine_place="Hall 2")
    api.register("y", machine="Mill 3", machine_place="Hall 2")
    api.register("z", machine="Lathe")
    api.register("alone")
    api.calibrate("y")
    measured(api, "y")
    api.calibrate("z")
    measured(api, "z")
    assert api.http.get("/v1/machines").json()["machines"] == [
        {"machine": "Lathe", "place": None, "state": "learning", "open_alarms": 0, "axes": ["z"]},
        {"machine": "Mill 3", "place": "Hall 2", "state": "unknown", "open_alarms": 0, "axes": ["x", "y"]},
    ]
    assert listed(api, machine="Mill 3") == ["x", "y"]
    assert listed(api, machine="Press") == []
    configuration = {"machine_place": "Hall 2"}
    refused = api.http.put("/v1/axes/x", json={"name": "x", "configuration": configuration})
    assert_problem(refused, 422, "invalid-request")


def test_an_archived_axis_is_hidden_and_takes_no_windows_until_it_is_taken_back(api: Api) -> None:
    api.register("old", machine="Mill 3")
    api.register("new")
    api.calibrate("old")
    measured(api, "old")
    before = api.trend("old")
    first, again = (api.http.post("/v1/axes/old/archive").json() for _ in range(2))
    assert first["archived_at"] is not None
    assert again == first
    assert (listed(api), listed(api, archived=True)) == (["new"], ["new", "old"])
    assert api.http.get("/v1/machines").json()["machines"] == []
    windows = simulated_measurement(np.random.default_rng(2), "late", n_windows=2)
    refusal = assert_problem(api.post("old", windows), 409, "conflict")["detail"]
    assert "is archived since" in refusal
    assert "DELETE /v1/axes/old/archive" in refusal
    assert api.trend("old") == before
    assert api.http.delete("/v1/axes/old/archive").json()["archived_at"] is None
    assert listed(api) == ["new", "old"]
    measured(api, "old")  # the same windows again
    assert api.trend("old") == before


def test_what_is_left_of_the_commissioned_preload_has_an_interval(api: Api) -> None:
    api.register("axis", commissioned_preload_n=300.0, commissioned_at="2026-01-01T00:00:00Z")
    assert api.axis("axis")["preload_left"] is None
    api.calibrate("axis")
    measured(api, "axis")
    said = api.axis("axis")
    left, last = said["preload_left"], said["last_measurement"]
    assert left["share"] == pytest.approx(0.8, abs=0.05)  # 240 of 300 N, as well as the axis is calibrated
    assert left["share"] * 300.0 == pytest.approx(last["preload_n"])
    assert [end * 300.0 for end in left["interval_95"]] == pytest.approx(last["interval_95_n"])
    assert api.http.get("/v1/axes").json()["axes"][0]["preload_left"] == left
    alone = api.http.put("/v1/axes/axis", json={"name": "a", "configuration": {"commissioned_preload_n": 300.0}})
    assert_problem(alone, 422, "invalid-request")


def test_the_command_line_compares_and_judges_anew(api: Api, tmp_path: Path) -> None:
    del tmp_path
    api.register("axis")
    api.calibrate("axis")
    measured(api, "axis")
    higher = [row | {"preload_n": 1.1 * row["preload_n"]} for row in readings()]
    api.http.post("/v1/axes/axis/calibrations", json={"readings": higher}).raise_for_status()
    words = ["--url", str(api.http.base_url), "--axis", "axis", "--calibration", "2"]

    def run(*more: str) -> str:
        found = CliRunner().invoke(command_named("rejudge"), [*words, *more], catch_exceptions=False)
        assert found.exit_code == 0, found.output
        return found.stdout

    compared = json.loads(run("--dry-run", "--json"))
    assert compared["new"]["median_preload_n"] == pytest.approx(1.1 * compared["old"]["median_preload_n"], rel=1e-6)
    assert api.axis("axis")["active_calibration"] == 1
    printed = run()
    assert "calibration 1" in printed
    assert "the same measurements raise alarms" in printed
    assert api.axis("axis")["active_calibration"] == 2
    assert api.http.get("/v1/axes/axis/calibrations").json()["history"][0]["reason"] == "the history was judged anew"
