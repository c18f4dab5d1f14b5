"""Identify the joints of an axis: what the data determine, how well, and what they do not see.

``identify`` asks the whole question; ``joint_fit`` searches and fits, ``identifiability`` and ``profiles`` say how well
each joint is known, ``sensitivity`` and ``advice`` which mode to watch and where to measure next.
"""

from monitor_core.fitting.residuals.peaks import Weighting as Weighting
from monitor_core.fitting.solver.global_search import MapFunction as MapFunction
from monitor_core.identification.answer import (
    FitQuality as FitQuality,
    FromPositions as FromPositions,
    FurtherPosition as FurtherPosition,
    HeldOutErrors as HeldOutErrors,
    IdentifiedJoint as IdentifiedJoint,
    IdentifiedJoints as IdentifiedJoints,
    KnownSum as KnownSum,
)
from monitor_core.identification.cases import DroppedPeak as DroppedPeak, PredictionError as PredictionError
from monitor_core.identification.described_calibration import (
    law_of_drive as law_of_drive,
    prior_of_drive as prior_of_drive,
    usual_preload_of as usual_preload_of,
)
from monitor_core.identification.identify_joints import (
    IdentifyOptions as IdentifyOptions,
    identify as identify,
    require_identifiable as require_identifiable,
)
from monitor_core.identification.predicted_calibration import (
    PredictionRequest as PredictionRequest,
    readings_expected_of as readings_expected_of,
)
from monitor_core.identification.sensitivity import Detectability as Detectability
