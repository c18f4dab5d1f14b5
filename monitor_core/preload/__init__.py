"""Estimate the preload (ISO 13374: HA): its feature, the calibration, newtons with a coverage interval."""

from monitor_core.preload.budget import VarianceShares, systematic_uncertainty_between, unexplained_scatter, widened
from monitor_core.preload.calibration import (
    Calibration,
    ModalReading,
    PositionError,
    ValidRange,
    Weighting,
    expected_band,
    expected_frequency,
    minimum_detectable_loss,
)
from monitor_core.preload.doubts import DoubtReason, PlaceReading, Places
from monitor_core.preload.drag_torque import DragTorque
from monitor_core.preload.estimate import (
    PreloadEstimate,
    PreloadLadder,
    estimate_preload,
    place_reading,
    preload_ladder,
)
from monitor_core.preload.feature import (
    InfluenceCoefficients,
    PreloadFeatureCoefficients,
    axial_frequency,
    preload_feature,
    preload_from_feature,
    preload_sensitivity,
)
from monitor_core.preload.fit import calibrate
from monitor_core.preload.plan import (
    USUAL_SCATTER,
    CalibrationPlan,
    ExpectedReadings,
    PlannedSetting,
    plan_calibration,
    smallest_loss,
)
from monitor_core.preload.prior import CoefficientPrior, calibration_from_prior, prior_from_calibration

__all__ = [
    "USUAL_SCATTER",
    "Calibration",
    "CalibrationPlan",
    "CoefficientPrior",
    "DoubtReason",
    "DragTorque",
    "ExpectedReadings",
    "InfluenceCoefficients",
    "ModalReading",
    "PlaceReading",
    "Places",
    "PlannedSetting",
    "PositionError",
    "PreloadEstimate",
    "PreloadFeatureCoefficients",
    "PreloadLadder",
    "ValidRange",
    "VarianceShares",
    "Weighting",
    "axial_frequency",
    "calibrate",
    "calibration_from_prior",
    "estimate_preload",
    "expected_band",
    "expected_frequency",
    "minimum_detectable_loss",
    "place_reading",
    "plan_calibration",
    "preload_feature",
    "preload_from_feature",
    "preload_ladder",
    "preload_sensitivity",
    "prior_from_calibration",
    "smallest_loss",
    "systematic_uncertainty_between",
    "unexplained_scatter",
    "widened",
]
