"""Identify the joints of an axis: what the data determine, how well, and what they do not see.

``identify`` asks the whole question; ``joint_fit`` searches and fits, ``identifiability`` and ``profiles`` say how well
each joint is known, ``sensitivity`` and ``advice`` which mode to watch and where to measure next.
"""

from monitor_core.identification.identified_joints import IdentifiedJoint, IdentifiedJoints
from monitor_core.identification.identify import identify, require_identifiable
from monitor_core.identification.predicted_calibration import PredictionRequest
from monitor_core.identification.question import IdentifyOptions

__all__ = [
    "IdentifiedJoint",
    "IdentifiedJoints",
    "IdentifyOptions",
    "PredictionRequest",
    "identify",
    "require_identifiable",
]
