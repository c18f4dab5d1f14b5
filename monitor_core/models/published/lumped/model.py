"""The lumped model as a drive: one spring, one moving mass, and the preload in the spring."""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import ComplexArray
from monitor_core.models.bracket import BeyondContacts, beyond_contacts
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.lumped.parameters import LumpedParameters
from monitor_core.models.published.lumped.stiffness import axial_stiffness, rotational_stiffness
from monitor_core.models.published.second_order import SecondOrderSystem
from monitor_core.models.published.small_drive import DriveEquations, SmallDrive


@dataclass(frozen=True, slots=True)
class LumpedModel(SmallDrive):
    r"""The drive of Nguyen et al. (2018): moving mass on a spring, the torsion of the screw put into that spring.

    With the motor end *clamped*, which is the paper's case, the modes are Eqs. (6) and (7),

    .. math::

        f_{ax} = \frac{1}{2\pi} \sqrt{\frac{k_{ax}}{m_{table} + m_{screw} + m_{nut} + m_{payload}}}, \qquad
        f_{rot} = \frac{1}{2\pi} \sqrt{\frac{k_{rot}}{J_s}}

    each without regard to the other: the rotational mode moves neither table nor motor, and the receptance at the table
    is :math:`1/(k_{ax}(1 + j\eta_e) + j\omega c_t - \omega^2 \Sigma m)`.

    With an end that turns, the same spring lies between an inertia J and the table, :math:`q = (\theta, x_t)`:

    .. math::

        \mathbf M = \begin{bmatrix} J & 0 \\ 0 & \Sigma m \end{bmatrix}, \qquad
        \mathbf K = k_{ax} \begin{bmatrix} i^2 & -i \\ -i & 1 \end{bmatrix}

    *Free*: J is of motor, coupling and screw. *Prescribed* torque at the screw: J is the screw's, and the coupling is
    not in the spring. Without inertias of motor and coupling the two differ by the coupling's compliance alone, which
    the first keeps between J and the table; they meet where the coupling is rigid.

    Notes
    -----
    An accelerometer on the nut has the screw's mass behind the bracket, with the table, as Σm has it.

    Neglected: the mass of the screw between bearing and nut as such (all of it travels with the table in Σm, although
    it is held axially by the bearing; all of its inertia turns with the motor end), the free rotation of the far end
    (Eq. 3 holds it), the far bearing, bending, and every mode beyond the first axial one. The paper gives no damping
    values; the dampers of its Fig. 2 are replaced by a loss factor of the joints and a damper at the guides.
    """

    paper_motor_end = MotorEnd.CLAMPED
    parameters: LumpedParameters

    def equations(self, conditions: DriveConditions, motor_end: MotorEnd = MotorEnd.CLAMPED) -> DriveEquations:
        """Return the matrices: q = (x_t, φ) with a clamped motor end, (θ, x_t) otherwise [m], [rad]."""
        p, i = self.parameters, self.parameters.transmission_ratio
        mass = p.moving_mass(conditions.payload_mass)
        k = axial_stiffness(p, conditions, coupling=motor_end is not MotorEnd.PRESCRIBED)
        if motor_end is MotorEnd.CLAMPED:
            system = SecondOrderSystem(
                np.diag([mass, p.screw_inertia]),
                np.diag([p.table_damping, 0.0]),
                np.diag([k, rotational_stiffness(p, conditions.position)]),
            )
            return DriveEquations(system, np.array([0.0, 0.0]), np.array([1.0, 0.0]))
        motor = p.motor_inertia + p.coupling_inertia if motor_end is MotorEnd.FREE else 0.0
        system = SecondOrderSystem(
            np.diag([motor + p.screw_inertia, mass]),
            np.diag([0.0, p.table_damping]),
            k * np.array([[i**2, -i], [-i, 1.0]]),
        )
        return DriveEquations(system, np.array([1.0, 0.0]), np.array([0.0, 1.0]))

    def beyond_contacts(self, s: ComplexArray, conditions: DriveConditions) -> BeyondContacts:
        """Return what the contacts of the nut carry: table and screw, behind the bracket, and the nut's own mass."""
        p = self.parameters
        return beyond_contacts(
            s,
            table_mass=p.table_mass + p.screw_mass + conditions.payload_mass,
            nut_mass=p.nut_mass,
            table_damping=p.table_damping,
            bracket_stiffness=p.bracket_stiffness,
            loss_factor=p.loss_factor,
        )
