r"""Compare the ratio of current to reference response per position and band; the model-form error cancels.

With the misfit :math:`\rho = \ln H - \ln Y` of model over measurement, what is compared in a cell is

.. math::

    m = \overline{\rho}_{now} - \overline{\rho}_{then}
      = \ln\frac{H_{now}}{H_{then}} - \ln\frac{Y_{now}}{Y_{then}}, \qquad
    \sigma^2 = \sigma_{now}^2 + \sigma_{then}^2 + \sigma_0^2
             + \left( \varepsilon \left| \ln\frac{Y_{now}}{Y_{then}} \right| \right)^2

Whatever the model is wrong in before and after alike drops out: form, friction, gain or polarity. What is left of it
grows with the change, by a share ε of it; σ_0 stands for what comes and goes from day to day.

Positions need not be the same in both: each response is compared with the model under its own conditions and on its
own lines, and only misfits are put together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.change.cells import (
    CELL_ERRORS,
    ChangeTolerances,
    Side,
    SideInCells,
    cells_of,
    common_cells,
    in_cells,
    moved,
    positions_of,
    side_of,
    spacings,
)
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.comparison import (
    AsMeasured,
    GapInSigma,
    Layout,
    Setting,
    WithoutOtherConditions,
    amplitude_panels,
)
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.lines import with_phase_within_half_a_turn
from monitor_core.models.extended import AxisPhysics
from monitor_core.shown import Panel

_STEP = 0.1  # of a standard deviation, for the condition errors
#: Share of the cells of wide bands that narrow ones must keep.
_ENOUGH_LINES = 0.5
#: With fewer, a comparison tells nothing of what differs over positions.
FEWEST_POSITIONS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ThenAndNow:
    """An axis before and after a change; what is not known of the axis is the same in both."""

    then: AxisPhysics
    now: AxisPhysics
    log_gain: float = 0.0  # ln of the gain of the measuring chain now over then [-]


@dataclass(frozen=True, eq=False)
class ReferenceRatio(AsMeasured, WithoutOtherConditions, GapInSigma):
    """Reference and present of an axis, or its reference alone.

    What short windows do to responses is part of the stated tolerances; a running axis is measured as it runs.
    """

    layout: Layout
    then: SideInCells
    now: SideInCells | None  # None: the reference against the model
    order: Indices  # from real parts of all cells, then imaginary parts, to the order of the values, (n_values,)
    spread: FloatArray  # deviation of the mean of a position over that of one measurement, shape (n_positions,) [-]
    tolerances: ChangeTolerances

    unit = "sigma"
    noise_floor = 1.0
    least_delta_bic = 50.0  # thousands of lines
    condition_error_names = CELL_ERRORS

    def misfit(self, physics: ThenAndNow) -> FloatArray:
        """Return Re and Im of the misfit of every cell, shape (n_values,)."""
        misfit = _of_reference(self.then, physics.then)
        if self.now is not None:
            misfit = self.now.misfit(physics.now) + physics.log_gain - misfit
        return self._values(misfit)

    def condition_errors(self, physics: ThenAndNow, misfit: FloatArray) -> FloatArray:
        """Return the change of the misfit by position, preload, temperature, gain and delay at a position."""
        rows = []
        for column in range(CELL_ERRORS.index("gain")):
            errors = np.zeros((self.spread.size, len(self.condition_error_names)))
            errors[:, column] = _STEP
            rows.append(self.layout.difference(self.shifted(errors).misfit(physics), misfit) / _STEP)
        spread, amplitude = self.spread[self.layout.setting], self.layout.channel == 0
        rows.append(np.where(amplitude, self.tolerances.gain_share * spread, 0.0))
        turned = -2.0 * np.pi * self.layout.frequency * self.tolerances.delay
        rows.append(np.where(amplitude, 0.0, turned * spread))
        return np.array(rows)

    def shifted(self, errors: FloatArray) -> "ReferenceRatio":
        """Return the comparison with the errors of all positions taken into account, shape (n_positions, n_errors)."""
        shown = self.then if self.now is None else self.now
        shown = replace(shown, side=moved(shown.side, errors * self.spread[:, None], self.tolerances))
        return replace(self, then=shown) if self.now is None else replace(self, now=shown)

    def panels(self, models: Mapping[str, ThenAndNow]) -> tuple[Panel, ...]:
        """Return the amplitude now over that of the reference at every position, measured and modelled."""
        measured, amplitudes = self.measured_change(), self.layout.channel == 0
        return amplitude_panels(
            [
                (setting.name, (self.layout.setting == index) & amplitudes)
                for index, setting in enumerate(self.layout.settings)
            ],
            "amplitude now over reference",
            self.layout.frequency,
            np.exp(measured),
            {name: np.exp(measured + self.misfit(physics)) for name, physics in models.items()},
        )

    def measured_change(self) -> FloatArray:
        """Return Re and Im of ln(Y_now/Y_then), of ln Y where there is one time only, shape (n_values,)."""
        then = self.then.measured
        return self._values(then if self.now is None else self.now.measured - then)

    def _values(self, of_cells: ComplexArray) -> FloatArray:
        """Return real and imaginary parts in the order of the values; phases within ±π."""
        wrapped = with_phase_within_half_a_turn(of_cells)
        return np.concatenate([wrapped.real, wrapped.imag])[self.order]


@lru_cache(maxsize=2)
def _of_reference(then: SideInCells, axis: AxisPhysics) -> ComplexArray:
    """Return the misfit of every cell at the time of the reference, which all changes share, shape (n_cells,)."""
    misfit = then.misfit(axis)
    misfit.setflags(write=False)
    return misfit


def compare_reference(
    reference: Sequence[FrequencyResponseObservation], tolerances: ChangeTolerances
) -> ReferenceRatio:
    """Compare the reference of an axis with a model of it.

    Raises NotIdentifiableError if no line stands above its noise.
    """
    positions, width = _positions(reference), max(spacings(reference))
    side = side_of(reference, positions, width)
    cells = cells_of(side)
    then = in_cells(side, cells)
    return ReferenceRatio(
        layout=_layout(positions, cells, np.sqrt(then.means.variance + tolerances.form**2), width),
        then=then,
        now=None,
        order=_order(cells),
        spread=1.0 / np.sqrt(then.measurements_per_position(positions.size)),
        tolerances=tolerances,
    )


def compare_times(
    reference: Sequence[FrequencyResponseObservation],
    recent: Sequence[FrequencyResponseObservation],
    tolerances: ChangeTolerances,
) -> ReferenceRatio:
    """Compare what an axis is now with its reference.

    Raises NotIdentifiableError if fewer than three positions were measured at both times, or no line stands above its
    noise.
    """
    positions = _positions(recent)
    at_both_times = np.unique(_in_common(reference, recent, positions)[2][:, 0])
    _require_positions(at_both_times.size)
    positions = positions[at_both_times]
    before, after, cells, width = _in_common(reference, recent, positions)
    then, now = in_cells(before, cells), in_cells(after, cells)
    change = np.abs(now.measured - then.measured)
    variance = then.means.variance + now.means.variance + tolerances.relative**2
    counts = [side.measurements_per_position(positions.size) for side in (then, now)]
    return ReferenceRatio(
        layout=_layout(positions, cells, np.sqrt(variance + (tolerances.share_of_change * change) ** 2), width),
        then=then,
        now=now,
        order=_order(cells),
        spread=np.sqrt(1.0 / counts[0] + 1.0 / counts[1]),
        tolerances=tolerances,
    )


def _in_common(
    reference: Sequence[FrequencyResponseObservation],
    recent: Sequence[FrequencyResponseObservation],
    positions: FloatArray,
) -> tuple[Side, Side, Indices, float]:
    """Return both sides, the cells that have lines of both, and the width of their bands.

    Bands as narrow as the closest lines hold equal frequencies only, and nothing rests on the model's slope between
    them. Where the lines of the two times differ, bands are as wide as the widest spacing.
    """
    found = []
    for width in spacings([*reference, *recent]):
        then, now = side_of(reference, positions, width), side_of(recent, positions, width)
        found.append((then, now, common_cells(then, now), width))
    narrow, wide = found
    return narrow if len(narrow[2]) > _ENOUGH_LINES * len(wide[2]) else wide


def _positions(observations: Sequence[FrequencyResponseObservation]) -> FloatArray:
    return positions_of(np.array([observation.conditions.position for observation in observations]))


def _require_positions(n_positions: int) -> None:
    if n_positions < FEWEST_POSITIONS:
        raise NotIdentifiableError(
            f"changes are distinguished by how they differ over positions: expected {FEWEST_POSITIONS} positions or "
            f"more at both times; got {n_positions}"
        )


def _order(cells: Indices) -> Indices:
    """Return the order of the values: by position, there amplitudes before phases, those by frequency."""
    position, imaginary = np.tile(cells[:, 0], 2), np.repeat([0, 1], len(cells))
    return np.lexsort((np.tile(cells[:, 1], 2), imaginary, position))


def _layout(positions: FloatArray, cells: Indices, deviation: FloatArray, width: float) -> Layout:
    order = _order(cells)
    imaginary = np.repeat([0, 1], len(cells))[order]
    return Layout(
        settings=tuple(
            Setting(f"{1e3 * position:.0f} mm", {ConditionAxis.POSITION: float(position)}) for position in positions
        ),
        setting=np.tile(cells[:, 0], 2)[order],
        channel=imaginary,
        channels=("amplitude", "phase"),
        frequency=np.tile(cells[:, 1] * width, 2)[order],
        standard_deviation=np.tile(deviation, 2)[order],
        period=np.where(imaginary == 1, 2.0 * np.pi, np.inf),
    )
