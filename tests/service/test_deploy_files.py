"""Files to begin with: they name what the service has."""

import re
from pathlib import Path

from prometheus_client import generate_latest

from service.observability import FleetGauges, Metrics

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"


def test_alerts_are_on_metrics_that_there_are() -> None:
    rules = (DEPLOY / "prometheus" / "preload-monitor.rules.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"preload_[a-z_]+", rules))
    counted = generate_latest(Metrics().registry).decode()
    there = set(re.findall(r"# TYPE (preload_[a-z_]+)", counted))
    there |= {metric.name for metric in FleetGauges((), (), 0, {}, ()).collect()}
    assert named
    assert named <= there | {f"{name}_bucket" for name in there}


def test_unit_starts_the_service_without_rights() -> None:
    unit = (DEPLOY / "systemd" / "preload-monitor.service").read_text(encoding="utf-8")
    assert "ExecStart=/opt/preload/bin/preload serve\n" in unit
    for line in ("DynamicUser=yes", "CapabilityBoundingSet=", "NoNewPrivileges=yes", "ProtectSystem=strict"):
        assert f"\n{line}\n" in unit
