r"""Responses of an axis now against those of its reference, place by place: what a model cannot say cancels.

With the misfit :math:`\rho = \ln H - \ln Y` of model over measurement, what is compared in a cell is

.. math::

    m = \overline{\rho}_{now} - \overline{\rho}_{then}
      = \ln\frac{H_{now}}{H_{then}} - \ln\frac{Y_{now}}{Y_{then}}, \qquad
    \sigma^2 = \sigma_{now}^2 + \sigma_{then}^2 + \sigma_0^2
             + \left( \varepsilon \left| \ln\frac{Y_{now}}{Y_{then}} \right| \right)^2

Whatever the model is wrong in before and after alike drops out, be it form, friction, gain or polarity. What is left of
it grows with the change: a share ε of it, and σ_0 for what comes and goes from day to day.

Positions need not be the same in both: each response is compared with the model under its own conditions and on its
own lines, and only misfits are put together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.change.cell_errors import PLACE_ERRORS, RunningTolerances, moved
from monitor_core.change.cells import (
    CellMeans,
    ComplexValues,
    Indices,
    Side,
    cell_means,
    cells_of,
    common_cells,
    measurements_per_place,
    places_of,
    side_of,
    spacings,
)
from monitor_core.change.then_and_now import ThenAndNow
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.comparison import Layout, Panel, Setting
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.clear_lines import with_phase_within_half_a_turn
from monitor_core.models.extended import AxisPhysics

_STEP = 0.1  # of a standard deviation, for the errors of the settings
#: Share of the cells of wide bands that narrow ones must keep.
_ENOUGH_LINES = 0.5
#: Below it a comparison of positions tells nothing of what differs over them.
FEWEST_PLACES = 3


@dataclass(frozen=True, eq=False)
class PlacesComparison:
    """Reference and present of an axis, or its reference alone."""

    layout: Layout
    then: Side
    then_means: CellMeans
    now: Side | None  # None: the reference against the model
    now_means: CellMeans | None
    order: Indices  # from real parts of all cells, then imaginary parts, to the order of the values, (n_values,)
    spread: FloatArray  # deviation of the mean of a place over that of one measurement, shape (n_places,) [-]
    tolerances: RunningTolerances

    unit = "sigma"
    noise_floor = 1.0
    least_delta_bic = 50.0  # thousands of lines
    setting_error_names = PLACE_ERRORS

    def misfit(self, physics: ThenAndNow) -> FloatArray:
        """Return Re and Im of the misfit of every cell, shape (n_values,)."""
        misfit = _of_reference(self.then, self.then_means, physics.then)
        if self.now is not None and self.now_means is not None:
            misfit = self.now_means(self.now.misfit(physics.now)) + physics.log_gain - misfit
        return self._values(misfit)

    def setting_errors(self, physics: ThenAndNow, misfit: FloatArray) -> FloatArray:
        """Return the change of the misfit by position, preload, temperature, gain and delay of a place."""
        rows = []
        for column in range(PLACE_ERRORS.index("gain")):
            errors = np.zeros((self.spread.size, len(self.setting_error_names)))
            errors[:, column] = _STEP
            rows.append(self.layout.difference(self.shifted(errors).misfit(physics), misfit) / _STEP)
        spread, amplitude = self.spread[self.layout.setting], self.layout.channel == 0
        rows.append(np.where(amplitude, self.tolerances.gain_share * spread, 0.0))
        turned = -2.0 * np.pi * self.layout.frequency * self.tolerances.delay
        rows.append(np.where(amplitude, 0.0, turned * spread))
        return np.array(rows)

    def shifted(self, errors: FloatArray) -> "PlacesComparison":
        """Return the comparison with all errors of its places taken into account, shape (n_places, n_errors)."""
        side = self.then if self.now is None else self.now
        side = moved(side, errors * self.spread[:, None], self.tolerances)
        return replace(self, then=side) if self.now is None else replace(self, now=side)

    def resolved(self, physics: ThenAndNow, errors: FloatArray) -> "PlacesComparison":
        """Return the comparison as it is: what short windows do to responses is part of their stated tolerances."""
        del physics, errors
        return self

    def imagined(self) -> Mapping[str, "PlacesComparison"]:
        """Return nothing: a running axis is measured as it runs."""
        return {}

    def gap(self, misfit: FloatArray, standardised: FloatArray, chosen: BoolArray) -> float:
        """Return the rms of the standardised misfit over the chosen values."""
        del misfit
        return float(np.sqrt(np.mean(standardised[chosen] ** 2)))

    def panels(self, models: Mapping[str, ThenAndNow]) -> tuple[Panel, ...]:
        """Return the amplitude now over that of the reference at every place, measured and modelled."""
        measured = self.measured_change()
        modelled = {name: measured + self.misfit(physics) for name, physics in models.items()}
        pictures = []
        for index, setting in enumerate(self.layout.settings):
            at = (self.layout.setting == index) & (self.layout.channel == 0)
            pictures.append(
                Panel(
                    title=setting.name,
                    x_name="frequency [Hz]",
                    y_name="amplitude now over reference",
                    x=self.layout.frequency[at],
                    measured=np.exp(measured[at]),
                    models={name: np.exp(change[at]) for name, change in modelled.items()},
                    logarithmic=True,
                )
            )
        return tuple(pictures)

    def measured_change(self) -> FloatArray:
        """Return Re and Im of ln(Y_now/Y_then), of ln Y where there is one time only, shape (n_values,)."""
        measured = self.then_means(self.then.measured)
        if self.now is not None and self.now_means is not None:
            measured = self.now_means(self.now.measured) - measured
        return self._values(measured)

    def _values(self, of_cells: ComplexValues) -> FloatArray:
        """Return real and imaginary parts in the order of the values; phases within ±π."""
        wrapped = with_phase_within_half_a_turn(of_cells)
        return np.concatenate([wrapped.real, wrapped.imag])[self.order]


@lru_cache(maxsize=2)
def _of_reference(then: Side, means: CellMeans, axis: AxisPhysics) -> ComplexValues:
    """Return the misfit of every cell at the time of the reference, which all changes share, shape (n_cells,)."""
    misfit = means(then.misfit(axis))
    misfit.setflags(write=False)
    return misfit


def compare_reference(
    reference: Sequence[FrequencyResponseObservation], tolerances: RunningTolerances
) -> PlacesComparison:
    """Compare the reference of an axis with a model of it.

    Parameters
    ----------
    reference : sequence of FrequencyResponseObservation
    tolerances : RunningTolerances

    Raises
    ------
    NotIdentifiableError
        If no line stands above its noise.
    """
    places = places_of(np.array([one.conditions.position for one in reference]))
    width = max(spacings(reference))
    then = side_of(reference, places, width)
    cells = cells_of(then)
    means = cell_means(then, cells)
    deviation = np.sqrt(means.variance + tolerances.form**2)
    spread = 1.0 / np.sqrt(np.maximum(measurements_per_place(then, places.size), 1.0))
    return PlacesComparison(
        layout=_layout(places, cells, deviation, width),
        then=then,
        then_means=means,
        now=None,
        now_means=None,
        order=_order(cells),
        spread=spread,
        tolerances=tolerances,
    )


def compare_times(
    reference: Sequence[FrequencyResponseObservation],
    recent: Sequence[FrequencyResponseObservation],
    tolerances: RunningTolerances,
) -> PlacesComparison:
    """Compare what an axis is now with its reference.

    Parameters
    ----------
    reference, recent : sequence of FrequencyResponseObservation
    tolerances : RunningTolerances

    Raises
    ------
    NotIdentifiableError
        If fewer than three places were measured at both times, or no line stands above its noise.
    """
    places = places_of(np.array([one.conditions.position for one in recent]))
    at_both_times = np.unique(_in_common(reference, recent, places)[2][:, 0])
    _require_places(at_both_times.size)
    places = places[at_both_times]
    then, now, cells, width = _in_common(reference, recent, places)
    then_means, now_means = cell_means(then, cells), cell_means(now, cells)
    change = np.abs(now_means(now.measured) - then_means(then.measured))
    variance = then_means.variance + now_means.variance + tolerances.relative**2
    deviation = np.sqrt(variance + (tolerances.share_of_change * change) ** 2)
    counts = [np.maximum(measurements_per_place(side, places.size), 1.0) for side in (then, now)]
    return PlacesComparison(
        layout=_layout(places, cells, deviation, width),
        then=then,
        then_means=then_means,
        now=now,
        now_means=now_means,
        order=_order(cells),
        spread=np.sqrt(1.0 / counts[0] + 1.0 / counts[1]),
        tolerances=tolerances,
    )


def _in_common(
    reference: Sequence[FrequencyResponseObservation],
    recent: Sequence[FrequencyResponseObservation],
    places: FloatArray,
) -> tuple[Side, Side, Indices, float]:
    """Return both sides, the cells that have lines of both, and the width of their bands.

    Bands as narrow as the closest lines hold equal frequencies only, and nothing rests on the model's slope between
    them. Where the lines of the two times lie beside each other, bands are as wide as the widest spacing.
    """
    found = []
    for width in spacings([*reference, *recent]):
        then, now = side_of(reference, places, width), side_of(recent, places, width)
        found.append((then, now, common_cells(then, now), width))
    narrow, wide = found
    return narrow if len(narrow[2]) > _ENOUGH_LINES * len(wide[2]) else wide


def _require_places(n_places: int) -> None:
    if n_places < FEWEST_PLACES:
        raise NotIdentifiableError(
            f"a change is told apart by how it differs over positions: expected {FEWEST_PLACES} places or more at "
            f"both times; got {n_places}"
        )


def _order(cells: Indices) -> Indices:
    """Return the order of the values: by place, there amplitudes before phases, those by frequency."""
    place, imaginary = np.tile(cells[:, 0], 2), np.repeat([0, 1], len(cells))
    return np.lexsort((np.tile(cells[:, 1], 2), imaginary, place))


def _layout(places: FloatArray, cells: Indices, deviation: FloatArray, width: float) -> Layout:
    order = _order(cells)
    imaginary = np.repeat([0, 1], len(cells))[order]
    return Layout(
        settings=tuple(Setting(f"{1e3 * one:.0f} mm", {ConditionAxis.POSITION: float(one)}) for one in places),
        setting=np.tile(cells[:, 0], 2)[order],
        channel=imaginary,
        channels=("amplitude", "phase"),
        frequency=np.tile(cells[:, 1] * width, 2)[order],
        standard_deviation=np.tile(deviation, 2)[order],
        period=np.where(imaginary == 1, 2.0 * np.pi, np.inf),
    )
