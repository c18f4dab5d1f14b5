"""A drive as a control sees it: motor current, commanded acceleration, motor angle and linear scale, in closed loop.

Three degrees of freedom, integrated exactly over each sample (zero-order hold): the turning motor and screw, the screw
along its axis, and the table. It shares no code with the other plant, whose truth is a finite-element chain.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Drive:
    """A small axis of 12 mm lead under a cascaded controller that holds motor angle and motor speed."""

    lead: float = 0.012  # [m]
    inertia: float = 6e-4  # of motor and screw [kg·m²]
    screw_mass: float = 2.0  # [kg]
    table_mass: float = 24.0  # [kg]
    bearing_stiffness: float = 60e6  # [N/m]
    screw_stiffness: float = 48e6  # E·A [N]
    bracket_stiffness: float = 40e6  # [N/m]
    nut_stiffness: float = 120e6  # at the rated preload [N/m]
    rated_preload: float = 400.0  # [N]
    damping: float = 1.1e-4  # stiffness-proportional: seconds times each stiffness [s]
    guide_damping: float = 150.0  # [N·s/m]
    torque_constant: float = 0.4  # [N·m/A]
    speed_bandwidth: float = 150.0  # of the controller [rad/s]
    position_gain: float = 30.0  # [1/s]
    sample_rate: float = 2000.0  # [Hz]

    @property
    def transmission(self) -> float:
        """Travel per radian [m/rad]."""
        return self.lead / (2.0 * np.pi)

    def axial_stiffness(self, position: float, preload: float) -> tuple[float, float]:
        """Return stiffness of bearing and screw, and of nut and bracket [N/m]."""
        screw = 1.0 / (1.0 / self.bearing_stiffness + position / self.screw_stiffness)
        nut = self.nut_stiffness * np.cbrt(preload / self.rated_preload)
        return screw, 1.0 / (1.0 / nut + 1.0 / self.bracket_stiffness)

    def matrices(self, position: float, preload: float, payload: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return A and B of motor angle, screw, table and their speeds; inputs: torque, force on the table."""
        screw, nut = self.axial_stiffness(position, preload)
        i = self.transmission
        mass = np.diag([self.inertia, self.screw_mass, self.table_mass + payload])
        of_nut, of_screw = np.array([i, 1.0, -1.0]), np.array([0.0, 1.0, 0.0])
        stiffness = nut * np.outer(of_nut, of_nut) + screw * np.outer(of_screw, of_screw)
        dashpots = self.damping * stiffness + np.diag([0.0, 0.0, self.guide_damping])
        inverse = np.linalg.inv(mass)
        a = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ stiffness, -inverse @ dashpots]])
        b = np.vstack([np.zeros((3, 2)), inverse @ np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])])
        return a, b

    def sampled(self, position: float, preload: float, payload: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return what takes states and inputs that are held over a sample to the next."""
        a, b = self.matrices(position, preload, payload)
        whole = np.zeros((8, 8))
        whole[:6, :6], whole[:6, 6:] = a, b
        exact = linalg.expm(whole / self.sample_rate)
        return exact[:6, :6], exact[:6, 6:]

    def feedback(self) -> FloatArray:
        """Return torque per state: of motor angle and speed."""
        turning = self.inertia + self.table_mass * self.transmission**2
        speed_gain = turning * self.speed_bandwidth
        return np.array([-speed_gain * self.position_gain, 0.0, 0.0, -speed_gain, 0.0, 0.0])

    def poles(self, position: float, preload: float, payload: float = 0.0, *, closed: bool = False) -> FloatArray:
        """Return natural frequencies [Hz] by rising frequency: of current to motion, or, closed, of what is commanded.

        Closed, they are those of the sampled loop.
        """
        f, g = self.sampled(position, preload, payload)
        if closed:
            f = f + np.outer(g[:, 0], self.feedback())
        poles = np.log(linalg.eigvals(f).astype(complex)) * self.sample_rate
        natural = np.abs(poles[poles.imag > 2.0 * np.pi])
        return np.sort(natural) / (2.0 * np.pi)

    def held(self, position: float, preload: float, payload: float = 0.0) -> float:
        """Return the frequency of screw and table with the motor held: the zero of current to motor angle [Hz]."""
        a, _ = self.matrices(position, preload, payload)
        kept = [1, 2, 4, 5]
        poles = linalg.eigvals(a[np.ix_(kept, kept)])
        return float(np.abs(poles[poles.imag > 0.0]).min() / (2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """What the control logs of windows, each of shape (n_windows, n_samples), without errors of its sensors."""

    current: FloatArray  # [A]
    commanded: FloatArray  # acceleration [m/s²]
    motor_angle: FloatArray  # [rad]
    table: FloatArray  # displacement [m]
    table_acceleration: FloatArray  # as an accelerometer samples it, in the mean over the sample [m/s²]


def run(
    drive: Drive,
    position: float,
    preload: float,
    *,
    n_windows: int,
    n_samples: int,
    rng: np.random.Generator,
    payload: float = 0.0,
    torque: float = 0.3,  # random, added to what the controller asks for [N·m rms]
    acceleration: float = 0.0,  # random, commanded [m/s² rms]
    travel: float = 5e-4,  # of a slow motion that goes on over the ends of the windows [m]
    disturbance: float = 0.0,  # random force on the table [N rms]
) -> Log:
    """Move and excite the axis; windows are cut out of long motions, and ring at both ends."""
    f, g = drive.sampled(position, preload, payload)
    back = drive.feedback()
    before = int(0.5 * drive.sample_rate)
    steps = before + n_samples
    time = np.arange(steps) / drive.sample_rate
    # without what is slow: twice integrated it would go away
    high = signal.butter(2, 20.0, "highpass", fs=drive.sample_rate, output="sos")
    commanded = acceleration * signal.sosfilt(high, rng.normal(size=(n_windows, steps)), axis=1)
    slow = 2.0 * np.pi * rng.uniform(0.2, 0.6, (n_windows, 1))
    phase = rng.uniform(0.0, 2.0 * np.pi, (n_windows, 1))
    travelled = travel * np.sin(slow * time + phase)
    wanted = travelled + np.cumsum(np.cumsum(commanded, axis=1), axis=1) / drive.sample_rate**2
    wanted -= wanted[:, :1]
    speed = np.gradient(wanted, 1.0 / drive.sample_rate, axis=1)
    turning = drive.inertia + (drive.table_mass + payload) * drive.transmission**2
    push = torque * rng.normal(size=(n_windows, steps))
    ahead = turning * commanded / drive.transmission
    force = disturbance * rng.normal(size=(n_windows, steps))
    state = np.zeros((6, n_windows))
    kept = np.zeros((steps, 4, n_windows))
    for k in range(steps):
        error = state.copy()
        error[0] -= wanted[:, k] / drive.transmission
        error[3] -= speed[:, k] / drive.transmission
        asked = back @ error + ahead[:, k] + push[:, k]
        after = f @ state + g @ np.array([asked, force[:, k]])
        kept[k] = asked, state[0], state[2], (after[5] - state[5]) * drive.sample_rate
        state = after
    asked, angle, table, mean_acceleration = np.moveaxis(kept, 1, 0)[:, before:].transpose(0, 2, 1)
    return Log(asked / drive.torque_constant, commanded[:, before:], angle, table, mean_acceleration)


def quantised(samples: FloatArray, step: float, rng: np.random.Generator) -> FloatArray:
    """Return samples as a scale or an encoder counts them, from an origin of its own in each window."""
    origin = rng.uniform(0.0, step, (samples.shape[0], 1))
    return step * np.floor((samples + origin) / step)


def delayed(samples: FloatArray, by: float) -> FloatArray:
    """Return samples so many of them later, whole or not; the first is held before."""
    n = np.arange(samples.shape[1])
    return np.array([np.interp(n - by, n, row) for row in samples])
