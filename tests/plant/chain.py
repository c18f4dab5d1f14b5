"""Finite-element chain of a ball-screw axis: screw, bearings, nut, bracket and table, axially and in torsion.

Rod elements with linear shape functions and consistent masses; a mesh node always lies under the nut. (With the nut
inside an element the missing kink makes the axis too stiff by up to a quarter of the element's compliance: 0.3 % of the
frequency with 40 mm elements, which is as much as the whole effect of the preload.)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

FloatArray = NDArray[np.float64]

#: Mesh elements on either side of the nut: the first mode is then converged to some parts per million.
ELEMENTS_PER_SIDE = 16


@dataclass(frozen=True, slots=True)
class Condition:
    """What a measurement is taken at."""

    position: float  # nut position from the fixed bearing [m]
    preload: float = 300.0  # [N]
    payload: float = 0.0  # [kg]
    temperature: float = 20.0  # [°C]
    friction_scale: float = 1.0  # lubrication: scales all Coulomb friction [-]
    guide_friction_scale: float = 1.0  # of the rail guides alone [-]
    bracket_scale: float = 1.0  # how firmly the nut is mounted [-]


@dataclass(frozen=True, slots=True)
class Axis:
    """A ball-screw axis with the dimensions of Nguyen et al. (2018), Table 1, where it states them.

    Not stated there and chosen: shear modulus, motor and coupling inertia, far bearing, loss factors, temperature
    coefficients. The bracket is 4.5e7 N/m: with it the axis lies at
    the measured 175 to 197 Hz; the printed 2.1e7 N/m does not reach them.
    """

    table_mass: float = 20.54  # [kg]
    nut_mass: float = 1.3  # [kg]
    screw_mass: float = 2.024  # [kg]
    screw_inertia: float = 1.169e-4  # [kg·m²]
    screw_length: float = 0.971  # [m]
    screw_minor_diameter: float = 0.0172  # carries the load [m]
    screw_diameter: float = 0.020  # pitch circle, for the lead angle [m]
    lead: float = 0.006  # [m]
    youngs_modulus: float = 206e9  # [Pa]
    shear_modulus: float = 79.5e9  # [Pa]
    bearing_stiffness: float = 100e6  # fixed bearing, axial [N/m]
    far_bearing_stiffness: float = 30e6  # supported end, axial [N/m]
    bracket_stiffness: float = 45e6  # between nut and table [N/m]
    nut_rigidity: float = 470e6  # catalogue K [N/m]
    rated_preload: float = 400.0  # 0.1 Ca [N]
    coupling_stiffness: float = 849.0  # [N·m/rad]
    coupling_damping: float = 0.015  # [N·m·s/rad]
    coupling_inertia: float = 2e-5  # half on the screw, behind the torque sensor [kg·m²]
    motor_inertia: float = 1.6e-4  # with the other half of the coupling [kg·m²]
    screw_loss_factor: float = 0.004  # energy loss factors; a mode gets half their strain-energy mean as its ζ [-]
    joint_loss_factor: float = 0.04
    reference_temperature: float = 20.0  # [°C]
    modulus_temperature_coefficient: float = -2.6e-4  # of E and G, hence also of the nut's ball contacts [1/K]
    joint_temperature_coefficient: float = -3.0e-4  # of bearings and bracket [1/K]

    @property
    def transmission(self) -> float:
        """Travel per radian [m/rad]."""
        return self.lead / (2.0 * np.pi)

    def nut_stiffness(self, preload: float) -> float:
        """Return the axial stiffness of the preloaded nut (THK: 0.8 K (P / 0.1 Ca)^(1/3)) [N/m]."""
        return float(0.8 * self.nut_rigidity * (preload / self.rated_preload) ** (1.0 / 3.0))

    def nut_drag_torque(self, preload: float) -> float:
        """Return the Coulomb drag torque of the preloaded nut (THK: 0.05 (tan β)^(-1/2) P l / 2π) [N·m]."""
        tan_lead_angle = self.lead / (np.pi * self.screw_diameter)
        return float(0.05 * tan_lead_angle**-0.5 * preload * self.transmission)


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Matrices of the screw side, free to turn at its driven end: [axial nodes, torsional nodes, nut, table]."""

    mass: FloatArray  # shape (n_dof, n_dof)
    stiffness: FloatArray  # shape (n_dof, n_dof)
    loss: FloatArray  # stiffness of each part times its loss factor, shape (n_dof, n_dof)
    drive_rotation: int  # dof at which the coupling acts
    nut_rotation: int  # screw rotation under the nut
    nut: int
    table: int

    def modes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return natural frequencies [Hz], mass-normalised shapes (n_dof, n_modes) and damping ratios [-].

        Damping by modal strain energy: ζ = ½ Σ η_part U_part / U. The rigid-body mode (the screw turns and the table
        follows) has neither stiffness nor damping.
        """
        eigenvalues, shapes = linalg.eigh(self.stiffness, self.mass)
        eigenvalues[0] = 0.0
        strain = np.einsum("im,ij,jm->m", shapes, self.loss, shapes)
        damping = np.divide(0.5 * strain, eigenvalues, out=np.zeros_like(strain), where=eigenvalues > 0.0)
        return np.sqrt(eigenvalues) / (2.0 * np.pi), shapes, damping


def assemble_chain(axis: Axis, condition: Condition, elements_per_side: int = ELEMENTS_PER_SIDE) -> Chain:
    """Assemble the screw side of the axis with a mesh node under the nut."""
    x, length = condition.position, axis.screw_length
    if not 0.0 < x < length:
        raise ValueError(f"position must lie on the screw, 0 to {length} m; got {x} m")
    nodes = np.concatenate(
        [np.linspace(0.0, x, elements_per_side + 1), np.linspace(x, length, elements_per_side + 1)[1:]]
    )
    n, under_nut = len(nodes), elements_per_side
    nut, table = 2 * n, 2 * n + 1
    heating = condition.temperature - axis.reference_temperature
    soft = 1.0 + axis.modulus_temperature_coefficient * heating
    joint = 1.0 + axis.joint_temperature_coefficient * heating

    mass, stiffness, loss = (np.zeros((2 * n + 2, 2 * n + 2)) for _ in range(3))
    area = np.pi / 4.0 * axis.screw_minor_diameter**2
    polar_moment = np.pi / 32.0 * axis.screw_minor_diameter**4
    for offset, rigidity, density in (
        (0, soft * axis.youngs_modulus * area, axis.screw_mass / length),
        (n, soft * axis.shear_modulus * polar_moment, axis.screw_inertia / length),
    ):
        for e, h in enumerate(np.diff(nodes)):
            dof = np.ix_([offset + e, offset + e + 1], [offset + e, offset + e + 1])
            element = rigidity / h * np.array([[1.0, -1.0], [-1.0, 1.0]])
            stiffness[dof] += element
            loss[dof] += axis.screw_loss_factor * element
            mass[dof] += density * h / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])

    mass[n, n] += axis.coupling_inertia
    mass[nut, nut] += axis.nut_mass
    mass[table, table] += axis.table_mass + condition.payload
    for spring, elongation in (
        (joint * axis.bearing_stiffness, {0: 1.0}),
        (joint * axis.far_bearing_stiffness, {n - 1: 1.0}),
        (soft * axis.nut_stiffness(condition.preload), {under_nut: 1.0, n + under_nut: axis.transmission, nut: -1.0}),
        (joint * axis.bracket_stiffness * condition.bracket_scale, {nut: 1.0, table: -1.0}),
    ):
        direction = np.zeros(2 * n + 2)
        direction[list(elongation)] = list(elongation.values())
        stiffness += spring * np.outer(direction, direction)
        loss += axis.joint_loss_factor * spring * np.outer(direction, direction)
    return Chain(mass, stiffness, loss, drive_rotation=n, nut_rotation=n + under_nut, nut=nut, table=table)


def with_motor(axis: Axis, chain: Chain) -> Chain:
    """Return the chain with coupling and free motor: its poles are those of the torque command."""
    n = chain.mass.shape[0]
    mass, stiffness, loss = (np.pad(matrix, (0, 1)) for matrix in (chain.mass, chain.stiffness, chain.loss))
    mass[n, n] = axis.motor_inertia
    twist = np.zeros(n + 1)
    twist[[n, chain.drive_rotation]] = 1.0, -1.0
    stiffness += axis.coupling_stiffness * np.outer(twist, twist)
    return Chain(mass, stiffness, loss, n, chain.nut_rotation, chain.nut, chain.table)


def natural_frequency(
    position: ArrayLike,
    preload: ArrayLike = 300.0,
    payload: ArrayLike = 0.0,
    temperature: ArrayLike = 20.0,
    *,
    axis: Axis | None = None,
    drive: bool = False,
) -> FloatArray:
    """Return the axial natural frequency of the linear, frictionless axis in hertz.

    Parameters
    ----------
    position, preload, payload, temperature : array_like
        Broadcast against each other. [m], [N], [kg], [°C]
    axis : Axis, optional
        By default the axis of the recorded sessions.
    drive : bool
        Pole of the response to the motor's torque instead of the torque at the sensor.

    Returns
    -------
    ndarray
        First natural frequency above the rigid-body motion. [Hz]
    """
    axis = axis or Axis()
    arrays = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in (position, preload, payload, temperature)))
    frequency = np.empty(arrays[0].shape)
    for index in np.ndindex(frequency.shape):
        chain = assemble_chain(axis, Condition(*(float(a[index]) for a in arrays)))
        chain = with_motor(axis, chain) if drive else chain
        eigenvalue = linalg.eigh(chain.stiffness, chain.mass, eigvals_only=True, subset_by_index=[1, 1])
        frequency[index] = np.sqrt(eigenvalue[0]) / (2.0 * np.pi)
    return frequency
