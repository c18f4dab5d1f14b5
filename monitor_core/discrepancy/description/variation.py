r"""Let one quantity of a drive vary freely from setting to setting, and find the law by which it follows the setting.

A model with the quantity multiplied by :math:`e^\theta` is evaluated at a few θ for all settings at once. Of each
setting this gives the misfit, whitened by its condition errors, as a function of its own θ: settings do not share
anything else here. The quantity whose variation takes most of the misfit away says where something is missing; the
values that it would need say how that behaves. (A random effect of the setting; the pulls of position, preload and
gains are the special cases that every fit has.)

Where no law holds, these values are all that can be said. They are judged by data that they were not found from: of
each setting one half of the lines, in short runs that alternate, gives θ, and the other half what that leaves.
"""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.effects import ConditionAxis
from monitor_core.effects.variation import Form, Law, Variable
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Setting
from monitor_core.fitting.solver.costs_of_settings import fitted_numbers, squares_of_values, summed_by_setting
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.models.extended import AxisPhysics, AxisSetting
from monitor_core.models.parameters import name_in_file


class Place(StrEnum):
    """A place of a drive, by its name in files."""

    TABLE = "table"
    NUT = "nut"
    SCREW = "screw"
    SCREW_END = "screw end"
    BEARING = "bearing"
    MOTOR = "motor"
    BASE = "base"
    SENSOR = "sensor"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity of one of the records of a drive."""

    record: str
    field: str
    place: Place
    name: str  # in files, with its unit

    def of(self, axis: AxisPhysics) -> float:
        """Return its value."""
        return float(getattr(getattr(axis, self.record), self.field))

    @property
    def is_frequency(self) -> bool:
        """Whether it is a frequency of its own, as that of an absorber."""
        return self.name.endswith("_hz")


def _stated(record: str, field: str, place: Place) -> Quantity:
    return Quantity(record, field, place, name_in_file(field))


QUANTITIES = (
    _stated("joints", "nut_stiffness", Place.NUT),
    _stated("joints", "nut_damping", Place.NUT),
    _stated("joints", "bracket_stiffness", Place.NUT),
    _stated("joints", "bearing_stiffness", Place.BEARING),
    _stated("joints", "bearing_damping", Place.BEARING),
    _stated("joints", "far_bearing_stiffness", Place.BEARING),
    _stated("joints", "coupling_stiffness", Place.MOTOR),
    _stated("joints", "coupling_damping", Place.MOTOR),
    Quantity("bodies", "rotor_inertia", Place.MOTOR, "motor_inertia_kg_m2"),
    _stated("bodies", "motor_damping", Place.MOTOR),
    _stated("bodies", "table_mass", Place.TABLE),
    _stated("bodies", "table_damping", Place.TABLE),
    Quantity("screw", "axial_rigidity", Place.SCREW, "screw_axial_rigidity_n"),
    Quantity("screw", "torsional_rigidity", Place.SCREW, "screw_torsional_rigidity_nm2"),
    Quantity("added", "table_absorber_frequency", Place.TABLE, "frequency_hz"),
    Quantity("added", "table_absorber_mass", Place.TABLE, "mass_kg"),
    Quantity("added", "nut_absorber_frequency", Place.NUT, "frequency_hz"),
    Quantity("added", "nut_absorber_mass", Place.NUT, "mass_kg"),
    Quantity("added", "rotor_absorber_frequency", Place.MOTOR, "frequency_hz"),
    Quantity("added", "rotor_absorber_inertia", Place.MOTOR, "inertia_kg_m2"),
    Quantity("added", "screw_end_absorber_frequency", Place.SCREW_END, "frequency_hz"),
    Quantity("added", "screw_end_absorber_mass", Place.SCREW_END, "mass_kg"),
    Quantity("added", "guide_stiffness", Place.TABLE, "guide_stiffness_n_per_m"),
    Quantity("added", "base_frequency", Place.BASE, "frequency_hz"),
    Quantity("bending", "frequency", Place.SCREW, "frequency_hz"),
    Quantity("bending", "compliance", Place.SCREW, "compliance_m_per_n"),
)


#: Frequencies that stand for nothing without a size.
_OF_SIZE = {
    "table_absorber_frequency": "table_absorber_mass",
    "nut_absorber_frequency": "nut_absorber_mass",
    "rotor_absorber_frequency": "rotor_absorber_inertia",
    "screw_end_absorber_frequency": "screw_end_absorber_mass",
    "base_frequency": "base_compliance",
}
_OF_BENDING = "frequency"


#: What stands in series, so that responses hardly tell which of the two varies: the solid part, and the contacts.
_CONTACTS = {"bracket_stiffness": "nut_stiffness"}


def contacts_for(quantity: Quantity) -> Quantity | None:
    """Return the quantity of contacts in series with that of a solid part, which a law is believed of first."""
    field = _CONTACTS.get(quantity.field)
    return next((other for other in QUANTITIES if other.field == field), None)


def hung_elsewhere(quantity: Quantity) -> Quantity | None:
    """Return the same quantity of what hangs on the table in place of the nut, or the other way round."""
    of_nut, of_table = ("nut_absorber", "table_absorber")
    field = quantity.field
    other = field.replace(of_nut, of_table) if field.startswith(of_nut) else field.replace(of_table, of_nut)
    return next((each for each in QUANTITIES if each.field == other and other != field), None)


def quantities_of(axis: AxisPhysics) -> tuple[Quantity, ...]:
    """Return the quantities that a drive has; what is zero or infinite plays no part in it."""
    absent = {frequency for frequency, size in _OF_SIZE.items() if not getattr(axis.added, size)}
    absent |= set() if axis.bending.compliance else {_OF_BENDING}
    present = [quantity for quantity in QUANTITIES if quantity.field not in absent]
    return tuple(quantity for quantity in present if math.isfinite(value := quantity.of(axis)) and value != 0.0)


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


#: Levels of a variable that a form of one coefficient, and one of two, needs.
_FEWEST_LEVELS = {Form.LINEAR: 2, Form.POWER: 3, Form.SATURATING: 3, Form.QUADRATIC: 4, Form.PERIODIC: 5,
                  Form.YIELDING: 4}  # fmt: skip
#: Coefficients that are tried; a refit finds what lies between them.
_CHANGES = np.concatenate([-np.geomspace(0.02, 1.2, 14)[::-1], np.geomspace(0.02, 4.0, 16)])
_EXPONENTS = np.concatenate([-np.geomspace(0.02, 1.5, 12)[::-1], np.geomspace(0.02, 1.5, 12)])
_SECOND = np.concatenate([-np.geomspace(0.03, 1.0, 7)[::-1], [0.0], np.geomspace(0.03, 1.0, 7)])
_HALF_AT = np.geomspace(0.1, 6.0, 7)
#: Of what yields: by how much and at which angles.
_AMPLITUDES, _ANGLES = np.geomspace(0.05, 18.0, 14), np.arange(0.0, 2.0 * np.pi, np.pi / 12.0)


@dataclass(frozen=True, slots=True, eq=False)
class TriedLaw:
    """A law of a quantity, at the coefficients that leave least."""

    variation: FreeVariation
    law: Law
    coefficients: tuple[float, ...]
    cost: float  # χ² over the settings that were fitted


def tried_laws(variation: FreeVariation, settings: tuple[AxisSetting, ...], lead: float) -> tuple[TriedLaw, ...]:
    """Return every law that the settings could show, at its best coefficients, least χ² with its penalty first."""
    tried = [tried_law(variation, law, settings) for law in _laws(settings, lead)]
    laws = [law for law in tried if law is not None]
    penalty = np.log(max(variation.cost.shape[0], 2))
    return tuple(sorted(laws, key=lambda tried: tried.cost + penalty * len(tried.coefficients)))


def _laws(settings: tuple[AxisSetting, ...], lead: float) -> Iterator[Law]:
    for variable in Variable:
        x = np.array([variable.of(setting) for setting in settings])
        levels, span = np.unique(np.round(x, 9)).size, float(np.ptp(x))
        if span <= 1e-6 * max(float(np.max(np.abs(x))), 1e-30):
            continue
        middle = float(np.median(x)) if variable is not Variable.ORDER else 0.0
        for form, fewest in _FEWEST_LEVELS.items():
            if levels < fewest:
                continue
            if form in (Form.PERIODIC, Form.YIELDING):
                if variable is Variable.POSITION:
                    yield Law(variable, form, 0.0, lead)
            elif form in (Form.POWER, Form.SATURATING):
                if variable in (Variable.EXCITATION, Variable.PRELOAD) and float(np.min(x)) > 0.0:
                    yield Law(variable, form, middle, middle)
            else:
                yield Law(variable, form, middle, span)


def tried_law(variation: FreeVariation, law: Law, settings: tuple[AxisSetting, ...]) -> TriedLaw | None:
    """Return a law at the best of the coefficients that are tried, beside the best level of the quantity, if any is."""
    x = np.array([law.variable.of(setting) for setting in settings])
    combinations, factors = [], []
    for coefficients in _tried(law.form):
        factor = _factors(law, x, coefficients)
        if factor is not None:
            combinations.append(coefficients)
            factors.append(factor)
    if not factors:
        return None
    theta = np.log(np.array(factors))[None]
    if law.form is not Form.YIELDING:  # which is as stated where it yields least
        theta = variation.ln_factor[:, None, None] + theta - np.mean(theta, axis=-1, keepdims=True)
    cost = variation.at(theta)
    best = int(np.argmin(np.min(cost, axis=0)))
    return TriedLaw(variation, law, tuple(map(float, combinations[best])), float(np.min(cost)))


def _factors(law: Law, x: FloatArray, coefficients: tuple[float, ...]) -> FloatArray | None:
    try:
        return np.array([law.factor(value, coefficients) for value in x.tolist()])
    except OutsideValidityError:
        return None


def _tried(form: Form) -> Iterable[tuple[float, ...]]:
    """Return the coefficients that are tried."""
    match form:
        case Form.LINEAR:
            return itertools.product(_CHANGES)
        case Form.POWER:
            return itertools.product(_EXPONENTS)
        case Form.SATURATING:
            return itertools.product(_CHANGES, _HALF_AT)
        case Form.QUADRATIC | Form.PERIODIC:
            return itertools.product(_SECOND, _SECOND)
        case Form.YIELDING:
            return ((size * np.cos(angle), size * np.sin(angle)) for size in _AMPLITUDES for angle in _ANGLES)
