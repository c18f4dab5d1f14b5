r"""A response of Tian's drive as a function of its joints alone, with its derivatives in closed form.

A fit of joints asks for the same lines thousands of times. What does not depend on the joints (the trigonometry of the
screw, the bodies) is computed once, and for table receptances the closed form has its gradient too.
"""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.parameters import DriveParameters, name_in_file
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint, motor_end_of
from monitor_core.models.published.receptance.closed_form import (
    PositionTerms,
    position_terms,
    receptance_between,
    table_receptance,
    table_receptance_gradient,
)
from monitor_core.models.published.receptance.parameters import JOINT_NAMES, JointParameters, ReceptanceParameters

#: The joints by their names in files, in the order of a gradient.
JOINT_NAMES_IN_FILE = tuple(name_in_file(name) for name in JOINT_NAMES)
_OF_TABLE = (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE)


@dataclass(frozen=True, slots=True, eq=False)
class JointResponse:
    """The lines of one response; made by :func:`joint_response`."""

    conditions: DriveConditions
    excitation: ExcitationPoint
    response_point: ResponsePoint
    terms: PositionTerms
    scale: ComplexArray  # from displacement or angle to the response: 1 or −ω², shape (n_frequencies,)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints by their names in files, in the order of a gradient."""
        return JOINT_NAMES_IN_FILE

    def at(self, parameters: DriveParameters) -> ComplexArray:
        """Return the response for an axis that differs in its joints alone, shape (n_frequencies,)."""
        joints = joints_of(parameters, self.conditions)
        if self._is_table_receptance:
            return self.scale * table_receptance(self.terms, joints)
        return self.scale * receptance_between(self.terms, joints, self.excitation, self.response_point)

    def gradient(self, parameters: DriveParameters) -> ComplexArray | None:
        """Return d H/d ln joint in the order of ``JOINT_NAMES``, shape (8, n_frequencies); None without a closed form.

        A nut whose rigidity follows the preload is proportional to its catalogue value, so the derivative with respect
        to the logarithm of either is the same.
        """
        if not self._is_table_receptance:
            return None
        joints = joints_of(parameters, self.conditions)
        _, gradient = table_receptance_gradient(self.terms, joints)
        return self.scale * gradient * joint_values(joints)[:, None]

    @property
    def _is_table_receptance(self) -> bool:
        return self.excitation is ExcitationPoint.FORCE_AT_TABLE and self.response_point in _OF_TABLE


def joint_response(
    parameters: ReceptanceParameters,
    frequency: FloatArray,
    conditions: DriveConditions,
    excitation: ExcitationPoint,
    response: ResponsePoint,
) -> JointResponse:
    """Prepare a response at frequencies [Hz], shape (n_frequencies,); the joints of the parameters are not used."""
    omega = 2.0 * np.pi * frequency
    scale = np.asarray(-(omega**2) if response.is_acceleration else np.ones_like(omega), dtype=np.complex128)
    terms = position_terms(parameters, omega, conditions, motor_end_of(excitation, MotorEnd.FREE))
    return JointResponse(conditions, excitation, response, terms, scale)


def joints_of(parameters: DriveParameters, conditions: DriveConditions) -> JointParameters:
    """Return the joints of an axis under the conditions; OutsideValidityError if it is of another family."""
    if not isinstance(parameters, ReceptanceParameters):
        raise OutsideValidityError(f"expected parameters of a receptance model; got {type(parameters).__name__}")
    return parameters.joints(conditions)


def joint_values(joints: JointParameters) -> FloatArray:
    """Return the joints in the order of ``JOINT_NAMES``, shape (8,)."""
    return np.array([getattr(joints, name) for name in JOINT_NAMES])
