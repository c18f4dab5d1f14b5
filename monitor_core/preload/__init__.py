"""Estimate the preload (ISO 13374: HA): its feature, the calibration, newtons with a coverage interval."""

from monitor_core.preload.bolts import PositioningBolts as PositioningBolts
from monitor_core.preload.budget import (
    SHOWN_BY_SESSIONS as SHOWN_BY_SESSIONS,
    VarianceShares as VarianceShares,
    excess_variance_of as excess_variance_of,
    systematic_uncertainty_between as systematic_uncertainty_between,
    widened as widened,
    widened_ends as widened_ends,
    with_history as with_history,
)
from monitor_core.preload.calibration import (
    Calibration as Calibration,
    ModalReading as ModalReading,
    PositionError as PositionError,
    ValidRange as ValidRange,
    Weighting as Weighting,
    expected_band as expected_band,
    expected_frequency as expected_frequency,
    minimum_detectable_loss as minimum_detectable_loss,
)
from monitor_core.preload.doubts import PlaceReading as PlaceReading, Places as Places
from monitor_core.preload.drag_torque import DragTorque as DragTorque, Friction as Friction
from monitor_core.preload.estimate import (
    IfStated as IfStated,
    PreloadEstimate as PreloadEstimate,
    PreloadLadder as PreloadLadder,
    SessionPreload as SessionPreload,
    estimate_preload as estimate_preload,
    friction_amplification as friction_amplification,
    place_reading as place_reading,
    preload_ladder as preload_ladder,
    session_preload as session_preload,
)
from monitor_core.preload.feature import (
    InfluenceCoefficients as InfluenceCoefficients,
    PreloadFeatureCoefficients as PreloadFeatureCoefficients,
    axial_frequency as axial_frequency,
    position_part as position_part,
    preload_feature as preload_feature,
    preload_from_feature as preload_from_feature,
    preload_sensitivity as preload_sensitivity,
)
from monitor_core.preload.fit import calibrate as calibrate
from monitor_core.preload.plan import (
    USUAL_SCATTER as USUAL_SCATTER,
    CalibrationPlan as CalibrationPlan,
    ExpectedReadings as ExpectedReadings,
    PlannedSetting as PlannedSetting,
    plan_calibration as plan_calibration,
    smallest_loss as smallest_loss,
)
from monitor_core.preload.prior import (
    CoefficientPrior as CoefficientPrior,
    calibration_from_prior as calibration_from_prior,
    log_preload as log_preload,
    prior_from_calibration as prior_from_calibration,
    with_unset_preload as with_unset_preload,
)
from monitor_core.preload.relative import (
    UNSTATED_SHARE as UNSTATED_SHARE,
    ConditionLaw as ConditionLaw,
    DriveLaw as DriveLaw,
    SessionSums as SessionSums,
    learn_law as learn_law,
    preload_lost as preload_lost,
    preload_lost_interval as preload_lost_interval,
)
from monitor_core.preload.verification import verify_calibration as verify_calibration
