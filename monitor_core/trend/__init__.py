"""Judge the trend and state of an axis: baseline, intervals, charts, detector (ISO 13374: SD)."""

from monitor_core.trend.baseline import Baseline, Observation, learn_baseline
from monitor_core.trend.design import DetectorDesign, DetectorSettings, LossDirection, design_detector
from monitor_core.trend.detector import reset, step
from monitor_core.trend.intervals import (
    PaperRule,
    confidence_interval_of_mean,
    paper_rule,
    prediction_interval_of_next,
    tolerance_interval_of_population,
)
from monitor_core.trend.state import Chart, DetectorState, Evidence, Run, TrendStatus, state_at

__all__ = [
    "Baseline",
    "Chart",
    "DetectorDesign",
    "DetectorSettings",
    "DetectorState",
    "Evidence",
    "LossDirection",
    "Observation",
    "PaperRule",
    "Run",
    "TrendStatus",
    "confidence_interval_of_mean",
    "design_detector",
    "learn_baseline",
    "paper_rule",
    "prediction_interval_of_next",
    "reset",
    "state_at",
    "step",
    "tolerance_interval_of_population",
]
