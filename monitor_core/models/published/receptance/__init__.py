"""Receptance-coupling model (Tian et al.): distributed screw, four joints, the table anywhere on the screw.

``closed_form`` gives what coupling the substructures as the paper does gives, fast and with its gradient; ``modes``
finds the poles from the starts of ``chain``.
"""

from monitor_core.models.published.receptance.model import ReceptanceModel as ReceptanceModel
from monitor_core.models.published.receptance.parameters import (
    JOINT_NAMES as JOINT_NAMES,
    JointParameters as JointParameters,
    ReceptanceParameters as ReceptanceParameters,
)
