r"""Let one quantity vary freely from setting to setting: what each setting would have, and what that would leave.

A model with the quantity multiplied by :math:`e^\theta` is evaluated at a few θ for all settings at once. Of each
setting this gives the misfit, whitened by its condition errors, as a function of its own θ: settings do not share
anything else here. The quantity whose variation takes most of the misfit away says where something is missing; the
values that it would need say how that behaves. (A random effect of the setting; the pulls of position, preload and
gains are the special cases that every fit has.)

Where no law holds, these values are all that can be said. They are judged by data that they were not found from: of
each setting one half of the lines, in short runs that alternate, gives θ, and the other half what that leaves.
"""

from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.discrepancy.description.quantities import Quantity
from monitor_core.effects import ConditionAxis
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Setting
from monitor_core.fitting.solver.costs_of_settings import fitted_numbers, squares_of_values, summed_by_setting
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.models.extended import AxisPhysics, AxisSetting

_COARSE = np.array([0.03, 0.07, 0.12, 0.2, 0.3, 0.45, 0.7, 1.1, 1.6, 2.3, 3.2, 4.2])
_FEW = _COARSE[1::3]
#: A resonance of its own is narrow: of a damping ratio of a few per cent no step may lie far from the next.
_FINE = np.concatenate([np.arange(0.015, 0.3, 0.015), [0.36, 0.44, 0.54]])
#: Values one after the other that are in one half: neighbours are alike.
_RUN = 4


@dataclass(frozen=True, slots=True, eq=False)
class FreeVariation:
    """The misfit of each setting as a function of the quantity there."""

    quantity: Quantity
    ln_factor: FloatArray  # θ, rising, shape (n_values,)
    cost: FloatArray  # χ² of each fitted setting at each θ, shape (n_settings, n_values)
    half: FloatArray  # of that, what one half of the lines adds

    def __post_init__(self) -> None:
        object.__setattr__(self, "ln_factor", read_only(self.ln_factor))
        object.__setattr__(self, "cost", read_only(self.cost))
        object.__setattr__(self, "half", read_only(self.half))

    @property
    def alike(self) -> float:
        """χ² with the quantity as it is best for all settings alike."""
        return float(np.min(np.sum(self.cost, axis=0)))

    @property
    def free(self) -> float:
        """χ² with the quantity as it is best for each setting."""
        return float(np.sum(np.min(self.cost, axis=1)))

    @property
    def judged(self) -> float:
        """χ² with the quantity as the other half of the lines of each setting has it best."""
        other, settings = self.cost - self.half, np.arange(self.cost.shape[0])
        return float(
            np.sum(self.half[settings, np.argmin(other, axis=1)] + other[settings, np.argmin(self.half, axis=1)])
        )

    @property
    def factors(self) -> FloatArray:
        """What the quantity is multiplied by where it is best for each setting, shape (n_settings,)."""
        return np.asarray(np.exp(self.ln_factor[np.argmin(self.cost, axis=1)]))

    def at(self, theta: FloatArray) -> FloatArray:
        """Return χ² of all settings at values of each, of shape (…, n_settings); what lies beyond is as at the end."""
        place = np.clip(np.searchsorted(self.ln_factor, theta) - 1, 0, self.ln_factor.size - 2)
        low, high = self.ln_factor[place], self.ln_factor[place + 1]
        share = np.clip((theta - low) / (high - low), 0.0, 1.0)
        settings = np.arange(self.cost.shape[0])
        cost = (1.0 - share) * self.cost[settings, place] + share * self.cost[settings, place + 1]
        return np.asarray(np.sum(cost, axis=-1))


def vary_freely(fitted: Fitted[AxisPhysics], quantity: Quantity, *, roughly: bool = False) -> FreeVariation | None:
    """Return what the settings that were fitted leave with a quantity of their own; None where there is no answer.

    Seen ``roughly`` it varies by a few values only, enough to tell what may be worth a closer look.
    """
    steps = _FINE if quantity.is_frequency else _FEW if roughly else _COARSE
    grid, costs = np.concatenate([-steps[::-1], [0.0], steps]), []
    here = fitted.physics()
    for theta in grid:
        costs.append((theta, _squares(fitted, quantity, here, theta)))
    answered = [(theta, squares) for theta, squares in costs if squares is not None]
    if len(answered) < 3:
        return None
    one_half = np.arange(fitted.comparison.layout.n_values) // _RUN % 2 == 0
    whole, half = (
        np.array([summed_by_setting(fitted, squares * chosen) for _, squares in answered]).T
        for chosen in (np.ones_like(one_half), one_half)
    )
    return FreeVariation(quantity, np.array([theta for theta, _ in answered]), whole, half)


def fitted_settings(fitted: Fitted[AxisPhysics]) -> tuple[AxisSetting, ...]:
    """Return how the axis was set in each of the settings that were fitted, as stated."""
    layout = fitted.comparison.layout
    last = max(len(layout.settings) - 1, 1)
    return tuple(_setting(layout.settings[number], number / last) for number in fitted_numbers(fitted).tolist())


def _setting(stated: Setting, order: float) -> AxisSetting:
    values = stated.values
    return AxisSetting(
        position=values.get(ConditionAxis.POSITION, 0.0),
        preload=values.get(ConditionAxis.PRELOAD, 0.0),
        payload_mass=values.get(ConditionAxis.PAYLOAD, 0.0),
        temperature_deviation=values.get(ConditionAxis.TEMPERATURE, 0.0),
        excitation_level=values.get(ConditionAxis.LEVEL, 0.0),
        order=order,
    )


def _squares(fitted: Fitted[AxisPhysics], quantity: Quantity, here: AxisPhysics, theta: float) -> FloatArray | None:
    record = getattr(here, quantity.record)
    try:
        moved = replace(record, **{quantity.field: np.exp(theta) * quantity.of(here)})
        return squares_of_values(fitted, replace(here, **{quantity.record: moved}))
    except OutsideValidityError:
        return None
