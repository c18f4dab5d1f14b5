"""Tian's model of a ball-screw axis: distributed screw, four joints, table at any position."""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.models.protocol import (
    DriveConditions,
    ExcitationPoint,
    MotorEnd,
    NaturalFrequency,
    NormalModes,
    ResponsePoint,
    motor_end_of,
    quantity_of,
    require_frequencies,
)
from monitor_core.models.published.receptance.closed_form import position_terms, receptance_between
from monitor_core.models.published.receptance.joint_response import JointResponse, joint_response
from monitor_core.models.published.receptance.modes import natural_frequencies, normal_modes
from monitor_core.models.published.receptance.parameters import ReceptanceParameters
from monitor_core.response import FrequencyResponse


@dataclass(frozen=True, slots=True)
class ReceptanceModel:
    """Substructures coupled by their receptances, after Tian et al.

    The screw is a continuous rod in tension and in torsion on both sides of the nut, held axially by its two bearings
    and in torsion by the coupling to the rotor. In the paper the rotor turns freely: ``MotorEnd.FREE``.

    The responses are the closed form of Eqs. (1)-(24), with the misprints of the paper put right
    (docs/reference/errata.md).

    """

    parameters: ReceptanceParameters

    def frequency_response(
        self,
        frequency: FloatArray,
        conditions: DriveConditions,
        *,
        excitation: ExcitationPoint,
        response: ResponsePoint,
    ) -> FrequencyResponse:
        """Return the response per unit excitation; a force at the table finds the rotor free."""
        frequency = require_frequencies(frequency)
        omega = 2.0 * np.pi * frequency
        terms = position_terms(self.parameters, omega, conditions, motor_end_of(excitation, MotorEnd.FREE))
        values = receptance_between(terms, self.parameters.joints(conditions), excitation, response)
        if response.is_acceleration:
            values = -(omega**2) * values
        return FrequencyResponse(frequency, values, quantity_of(excitation, response))

    def joint_response(
        self, frequency: FloatArray, conditions: DriveConditions, excitation: ExcitationPoint, response: ResponsePoint
    ) -> JointResponse:
        """Prepare the lines of a response as a function of the joints, with its gradient; frequencies in hertz."""
        return joint_response(self.parameters, require_frequencies(frequency), conditions, excitation, response)

    def natural_frequencies(
        self, conditions: DriveConditions, motor_end: MotorEnd | None = None
    ) -> tuple[NaturalFrequency, ...]:
        """Return the first eight poles, rigid-body mode included; they must be far enough apart to be told apart."""
        return natural_frequencies(self.parameters, conditions, motor_end or MotorEnd.FREE)

    def normal_modes(self, conditions: DriveConditions, motor_end: MotorEnd | None = None) -> NormalModes:
        """Return the first eight undamped modes, rigid-body mode included; each of them must oscillate."""
        return normal_modes(self.parameters, conditions, motor_end or MotorEnd.FREE)
