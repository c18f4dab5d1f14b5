"""Judge the trend and state of an axis: baseline, intervals, charts, detector (ISO 13374: SD)."""

from monitor_core.trend.baseline import Baseline as Baseline, learn_baseline as learn_baseline
from monitor_core.trend.belief import Bank as Bank, Belief as Belief, Numbers as Numbers, Prior as Prior
from monitor_core.trend.bootstrap import (
    FEWEST_SESSIONS as FEWEST_SESSIONS,
    FoundRate as FoundRate,
    found_rate as found_rate,
    healthy_sessions as healthy_sessions,
)
from monitor_core.trend.charts import (
    LEAST_MEASUREMENTS as LEAST_MEASUREMENTS,
    LEAST_RATE as LEAST_RATE,
    MOST_BASELINE as MOST_BASELINE,
    MOST_MEASUREMENTS as MOST_MEASUREMENTS,
    MOST_RATE as MOST_RATE,
    DetectionDelay as DetectionDelay,
    DetectorDesign as DetectorDesign,
    DetectorSettings as DetectorSettings,
    LossDirection as LossDirection,
    design_detector as design_detector,
    detection_delay as detection_delay,
)
from monitor_core.trend.detector import (
    ClosedSession as ClosedSession,
    closed_session as closed_session,
    latest_difference as latest_difference,
    reset as reset,
    step as step,
)
from monitor_core.trend.intervals import (
    PaperRule as PaperRule,
    confidence_interval_of_mean as confidence_interval_of_mean,
    paper_rule as paper_rule,
)
from monitor_core.trend.joint import (
    JOINT_SHARE as JOINT_SHARE,
    JointEvidence as JointEvidence,
    JointObservation as JointObservation,
    JointState as JointState,
    NumberChange as NumberChange,
    joint_limit as joint_limit,
    joint_reset as joint_reset,
    joint_step as joint_step,
)
from monitor_core.trend.lasting_loss import Said as Said
from monitor_core.trend.line import (
    PresentTrend as PresentTrend,
    TrendLine as TrendLine,
    present_trend as present_trend,
    trend_line as trend_line,
)
from monitor_core.trend.observation import Observation as Observation, Session as Session
from monitor_core.trend.sisters import prior_from as prior_from
from monitor_core.trend.state import (
    Chart as Chart,
    Charts as Charts,
    DetectorState as DetectorState,
    Evidence as Evidence,
    Run as Run,
    TrendStatus as TrendStatus,
    state_at as state_at,
)
