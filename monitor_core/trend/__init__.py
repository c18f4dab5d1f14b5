"""Judge the trend and state of an axis: baseline, intervals, charts, detector (ISO 13374: SD)."""

from monitor_core.trend.baseline import Baseline, learn_baseline
from monitor_core.trend.belief import Belief, Prior
from monitor_core.trend.bootstrap import FEWEST_SESSIONS, FoundRate, found_rate, healthy_sessions
from monitor_core.trend.charts import (
    DetectionDelay,
    DetectorDesign,
    DetectorSettings,
    LossDirection,
    design_detector,
    detection_delay,
)
from monitor_core.trend.detector import ClosedSession, closed_session, reset, step
from monitor_core.trend.intervals import (
    PaperRule,
    confidence_interval_of_mean,
    paper_rule,
)
from monitor_core.trend.line import FEWEST_READINGS, Projection, TrendLine, project, trend_line
from monitor_core.trend.observation import Observation, Session
from monitor_core.trend.sisters import prior_from
from monitor_core.trend.state import Chart, Charts, DetectorState, Evidence, Run, TrendStatus, state_at

__all__ = [
    "FEWEST_READINGS",
    "FEWEST_SESSIONS",
    "Baseline",
    "Belief",
    "Chart",
    "Charts",
    "ClosedSession",
    "DetectionDelay",
    "DetectorDesign",
    "DetectorSettings",
    "DetectorState",
    "Evidence",
    "FoundRate",
    "LossDirection",
    "Observation",
    "PaperRule",
    "Prior",
    "Projection",
    "Run",
    "Session",
    "TrendLine",
    "TrendStatus",
    "closed_session",
    "confidence_interval_of_mean",
    "design_detector",
    "detection_delay",
    "found_rate",
    "healthy_sessions",
    "learn_baseline",
    "paper_rule",
    "prior_from",
    "project",
    "reset",
    "state_at",
    "step",
    "trend_line",
]
