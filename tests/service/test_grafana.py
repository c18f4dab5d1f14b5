"""The dashboard for Grafana is one by Grafana's own schemas, and asks for metrics that the service has."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft7Validator

from service.observability import AxisReading, FleetGauges, ReceiverReading
from tests.conftest import PROJECT_ROOT
from tests.service.conftest import START, Api, simulated_measurement

DASHBOARD: dict[str, Any] = json.loads(
    (PROJECT_ROOT / "deploy" / "grafana" / "preload-monitor.json").read_text(encoding="utf-8")
)
PANELS: list[dict[str, Any]] = DASHBOARD["panels"]


def schema(name: str, definition: str) -> Draft7Validator:
    document = json.loads((Path(__file__).parent / "schemas" / f"grafana-{name}.json").read_text(encoding="utf-8"))
    return Draft7Validator({"definitions": document["definitions"], "$ref": f"#/definitions/{definition}"})


def test_the_dashboard_is_valid() -> None:
    schema("dashboard", "Dashboard").validate(DASHBOARD)


def test_each_panel_is_valid_for_its_kind(subtests: pytest.Subtests) -> None:
    for panel in PANELS:
        with subtests.test(panel=panel):
            kind = panel["type"].replace("-", "")
            schema(kind, "Options").validate(panel["options"])
            if "custom" in panel["fieldConfig"]["defaults"]:
                schema(kind, "FieldConfig").validate(panel["fieldConfig"]["defaults"]["custom"])
            for target in panel["targets"]:
                schema("prometheus", "Dataquery").validate(target)


def test_the_schemas_refuse_what_is_none() -> None:
    assert not schema("dashboard", "Dashboard").is_valid({**DASHBOARD, "panels": [{"title": "of no kind"}]})
    assert not schema("prometheus", "Dataquery").is_valid({"refId": "A"})


def test_panels_do_not_overlap_and_have_their_own_numbers() -> None:
    places = [
        (panel["gridPos"]["x"], panel["gridPos"]["y"], panel["gridPos"]["w"], panel["gridPos"]["h"]) for panel in PANELS
    ]
    cells = [(x + i, y + j) for x, y, w, h in places for i in range(w) for j in range(h)]
    assert len(cells) == len(set(cells))
    assert max(x for x, _ in cells) < 24
    assert len({panel["id"] for panel in PANELS}) == len(PANELS)


def test_it_asks_for_metrics_and_labels_that_there_are(shared_api: Api) -> None:
    shared_api.register("mill")
    shared_api.calibrate("mill")
    shared_api.accept("mill", simulated_measurement(np.random.default_rng(1), "m", n_windows=4), complete=True)
    answer = shared_api.http.get("/metrics").text
    there = set(re.findall(r"^# TYPE (preload_[a-z_]+)", answer, flags=re.MULTILINE))
    there |= {f"{name}_bucket" for name in there}
    asked = re.findall(r"preload_[a-z_]+", json.dumps([panel["targets"] for panel in PANELS]))
    assert asked
    assert set(asked) <= there
    point = shared_api.trend("mill")[0]
    assert f'preload_axis_newtons{{axis="mill"}} {point["preload_n"]!r}' in answer
    assert f'preload_axis_lower_newtons{{axis="mill"}} {point["interval_95_n"][0]!r}' in answer
    measured = re.search(r'^preload_axis_measured_timestamp_seconds{axis="mill"} (.*)$', answer, flags=re.MULTILINE)
    assert measured
    assert float(measured[1]) == START.timestamp()
    assert 'preload_axis_state{axis="mill",state="learning"} 1.0' in answer
    assert 'preload_axes{state="learning"} 1.0' in answer
    assert 'preload_axes{state="alarm"} 0.0' in answer


def test_prometheus_reads_every_question(tmp_path: Path) -> None:
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("promtool is not installed")
    asked = [target["expr"] for panel in PANELS for target in panel["targets"]]
    asked += [annotation["expr"] for annotation in DASHBOARD["annotations"]["list"]]
    filled = [re.sub(r"\$__(rate_)?interval", "5m", expression).replace("$axis", ".*") for expression in asked]
    rules = [{"record": f"asked:{i}", "expr": expression} for i, expression in enumerate(filled)]
    file = tmp_path / "rules.yml"
    file.write_text(json.dumps({"groups": [{"name": "asked", "rules": rules}]}), encoding="utf-8")
    checked = subprocess.run([promtool, "check", "rules", str(file)], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr + checked.stdout


def test_a_large_fleet_has_bounded_metrics() -> None:
    axes = [AxisReading(f"{i:05}", "normal", 0, START, 300.0, (290.0, None)) for i in range(5000)]
    receivers = [ReceiverReading("desk", True, 3)]
    gauges = FleetGauges(["normal"], axes, 1, {("replay", "queued"): 3}, receivers)
    found = {metric.name: metric.samples for metric in gauges.collect()}
    assert found["preload_axes"][0].value == 5000
    assert max(len(samples) for samples in found.values()) == 2000
    assert found["preload_axis_upper_newtons"] == []  # an open end is none, not a number
    assert found["preload_jobs"][0].labels == {"kind": "replay", "status": "queued"}
    assert found["preload_receiver_waiting"][0].value == 3
