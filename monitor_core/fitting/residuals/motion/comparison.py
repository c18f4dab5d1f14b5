"""Compare a motion record with the motor force that a rigid axis needs for it.

The force is judged. In closed loop the position follows the reference whatever the model of the axis, so that a model
without friction would seem right to a hundredth of a percent. A motion is cut into strokes, from one reversal to the
next.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import AsMeasured, Layout, Setting, WithoutOtherConditions
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.fitting.residuals.motion.sampling import MotionSampling, force_noise, sampling_of
from monitor_core.models.motion import Kinematics, MotionParameters, MotionPhysics, forces, kinematics_of
from monitor_core.recording import ExcitationQuantity, MotionRecord
from monitor_core.shown import Panel

#: A way back that is shorter is a hesitation and no reversal, as a share of the whole way.
_HESITATION = 0.01


def strokes_of(position: FloatArray) -> tuple[Indices, tuple[int, ...]]:
    """Cut a motion at its reversals: the first value of each stroke, and its direction.

    The first stroke begins with value 0. A direction is +1 towards higher positions, −1 towards lower ones.
    """
    shortest = _HESITATION * float(np.ptp(position))
    first, directions, furthest = [0], [0], 0
    for now, x in enumerate(position.tolist()):
        way = x - float(position[furthest])
        if way * directions[-1] > 0.0:
            furthest = now
        elif abs(way) > shortest:
            direction = 1 if way > 0.0 else -1
            if directions == [0]:  # what comes before the first stroke belongs to it
                directions = [direction]
            else:
                first.append(furthest)
                directions.append(direction)
            furthest = now
    return np.array(first, dtype=np.intp), tuple(directions)


def stroke_settings(time: FloatArray, first: Indices, directions: Sequence[int]) -> tuple[Setting, ...]:
    """Return each stroke as a setting: a stretch of time [s] and a direction."""
    last = np.r_[first[1:], time.size] - 1
    return tuple(
        Setting(
            f"stroke {number} ({time[start]:.3g} s to {time[stop]:.3g} s)", {ConditionAxis.DIRECTION: float(direction)}
        )
        for number, (start, stop, direction) in enumerate(zip(first, last, directions, strict=True), 1)
    )


_CHANNEL = "motor force"
#: Values in a picture over time: six seconds at 100 Hz, in which strokes can still be told apart.
_READABLE = 600
#: Bins of velocity in the other picture.
_BINS = 60


@dataclass(frozen=True, eq=False)
class MotionComparison(AsMeasured, WithoutOtherConditions):
    """A motion, and how far the force of a rigid axis is from the measured force."""

    layout: Layout
    motion: Kinematics
    sampling: MotionSampling
    force: FloatArray  # values of the measured force, shape (n_values,) [N]

    unit = "%"
    least_delta_bic = 25.0  # its values are correlated, but no form error is in all of them alike
    condition_error_names = ()  # a motion is set to nothing that could be wrong

    @classmethod
    def of(cls, record: MotionRecord, parameters: MotionParameters) -> Self:
        """Prepare a record: kinematics, values, strokes, noise; the second half is held out.

        Raises OutsideValidityError if torque was recorded and the lead of the screw is not stated, no force was
        recorded, or the axis does not move long enough.
        """
        is_torque = record.quantity is ExcitationQuantity.TORQUE
        force = parameters.force_of_torque(record.drive) if is_torque else record.drive
        if not np.any(force):
            raise OutsideValidityError("a motion to be compared needs a motor force; got 0 N in every sample")
        motion = kinematics_of(record.position, record.sample_rate)
        sampling = sampling_of(motion)
        layout = _layout(sampling, sampling.instants(record.position), force_noise(record, force, sampling))
        return cls(layout, motion, sampling, sampling.values(force))

    @property
    def noise_floor(self) -> float:
        """Relative force error that the noise alone leaves [%]."""
        deviation = self.layout.standard_deviation
        return self.gap(deviation, deviation, np.ones(deviation.size, dtype=np.bool_))

    def misfit(self, physics: MotionPhysics) -> FloatArray:
        """Return predicted less measured force, shape (n_values,) [N]."""
        longest = self.sampling.end
        if abs(physics.force_delay) > longest:
            raise OutsideValidityError(
                f"force_delay must lie within ±{longest:g} s, the ends of the record that are not compared; "
                f"got {physics.force_delay:g} s"
            )
        return self.sampling.values(forces(physics, self.motion)) - self.force

    def condition_errors(self, physics: MotionPhysics, misfit: FloatArray) -> FloatArray:
        """Return none, shape (0, n_values)."""
        del physics, misfit
        return np.zeros((0, self.force.size))

    def shifted(self, errors: FloatArray) -> Self:
        """Return the comparison as it is."""
        del errors
        return self

    def gap(self, misfit: FloatArray, standardised: FloatArray, chosen: BoolArray) -> float:
        """Return the relative force error, 100 ‖misfit‖/‖force‖, over the chosen values [%]."""
        del standardised
        return 100.0 * float(np.linalg.norm(misfit[chosen]) / np.linalg.norm(self.force[chosen]))

    def panels(self, models: Mapping[str, MotionPhysics]) -> tuple[Panel, ...]:
        """Return pictures of the force on the held-out half: over time, and over the velocity."""
        predicted = {name: self.misfit(physics) + self.force for name, physics in models.items()}
        (held_out,) = self.layout.held_out
        return (self._over_time(predicted, held_out), self._over_velocity(predicted, held_out))

    def _over_time(self, predicted: Mapping[str, FloatArray], held_out: BoolArray) -> Panel:
        shown = np.flatnonzero(held_out)[:_READABLE]
        return Panel(
            title="Motor force on held-out motion",
            x_name="time [s]",
            y_name="force [N]",
            x=self.sampling.time[shown],
            measured=self.force[shown],
            models={name: force[shown] for name, force in predicted.items()},
            held_out=True,
        )

    def _over_velocity(self, predicted: Mapping[str, FloatArray], held_out: BoolArray) -> Panel:
        """Average over bins of velocity, of the steadier half of the motion alone: there friction is what is left."""
        hurry = np.abs(self.sampling.values(self.motion.acceleration))
        steady = held_out & (hurry <= np.median(hurry[held_out]))
        velocity = self.sampling.values(self.motion.velocity)[steady]
        edges = np.linspace(np.min(velocity), np.max(velocity), _BINS + 1)[1:-1]
        _, bins, number = np.unique(np.searchsorted(edges, velocity), return_inverse=True, return_counts=True)

        def mean(values: FloatArray) -> FloatArray:
            return np.bincount(bins, weights=values) / number

        return Panel(
            title="Mean motor force of steady motion, held out",
            x_name="velocity [m/s]",
            y_name="force [N]",
            x=mean(velocity),
            measured=mean(self.force[steady]),
            models={name: mean(force[steady]) for name, force in predicted.items()},
            held_out=True,
        )


def _layout(sampling: MotionSampling, position: FloatArray, noise: float) -> Layout:
    n = position.size
    first, directions = strokes_of(position)
    return Layout(
        settings=stroke_settings(sampling.time, first, directions),
        setting=np.searchsorted(first, np.arange(n), side="right") - 1,
        channel=np.zeros(n, dtype=np.intp),
        channels=(_CHANNEL,),
        frequency=np.full(n, np.nan),
        standard_deviation=np.full(n, noise),
        period=np.full(n, np.inf),
        held_out=(np.arange(n) >= n // 2,),
    )
