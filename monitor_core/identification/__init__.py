"""Identify the joints of an axis: what the data determine, how well, and what they do not see.

``identify`` asks the whole question; ``joint_fit`` searches and fits, ``identifiability`` and ``profiles`` say how well
each joint is known, ``sensitivity`` and ``advice`` which mode to watch and where to measure next.
"""

from monitor_core.fitting.residuals.peaks import Weighting
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.identification.answer import (
    FitQuality,
    FurtherPosition,
    HeldOutErrors,
    IdentifiedJoint,
    IdentifiedJoints,
    KnownSum,
)
from monitor_core.identification.cases import PredictionError
from monitor_core.identification.identify_joints import IdentifyOptions, identify, require_identifiable
from monitor_core.identification.predicted_calibration import PredictionRequest, readings_expected_of
from monitor_core.identification.sensitivity import Detectability

__all__ = [
    "Detectability",
    "FitQuality",
    "FurtherPosition",
    "HeldOutErrors",
    "IdentifiedJoint",
    "IdentifiedJoints",
    "IdentifyOptions",
    "KnownSum",
    "MapFunction",
    "PredictionError",
    "PredictionRequest",
    "Weighting",
    "identify",
    "readings_expected_of",
    "require_identifiable",
]
