r"""Let one quantity of a drive vary freely from setting to setting, and find the law by which it follows the setting.

A model with the quantity multiplied by :math:`e^\theta` is evaluated at a few θ for all settings at once. Of each
setting this gives the misfit, whitened by its condition errors, as a function of its own θ: settings do not share
anything else here. The quantity whose variation takes most of the misfit away says where something is missing; the
values that it would need say how that behaves. (A random effect of the setting; the pulls of position, preload and
gains are the special cases that every fit has.)

Settings that are alike in a variable have like values where the quantity follows that variable. With the values θ that
the settings ask for, their variances v, and x of each, the evidence for that is

.. math::

    \ln p(\theta) = -\tfrac12 \ln\det S - \tfrac12 (\theta - \mu)^T S^{-1} (\theta - \mu) - \tfrac12 \ln 1^T S^{-1} 1,
    \qquad S = \mathrm{diag}(v) + a^2 \left(\rho I + (1 - \rho) e^{-(x - x')^2/2\ell^2}\right)

of a Gaussian process, averaged over its amplitude a, its length ℓ and what share ρ is each setting's own, with the best
mean μ (Rasmussen and Williams, Gaussian Processes for Machine Learning, section 5.4); without a variable that is all.
Where no law holds, these values are all that can be said. They are judged on lines that they were not found from.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.effects import ConditionAxis
from monitor_core.effects.variation import GEAR_RATIO, Form, Law, Variable, has_quantity, multiplied
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import CommonErrors, Layout, Setting
from monitor_core.fitting.conditions.groups import series_of
from monitor_core.fitting.evidence import EvidenceScale, evidence_scale
from monitor_core.fitting.solver.costs_of_settings import fitted_numbers, squares_along, summed_by_setting
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
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
    Quantity("", GEAR_RATIO, Place.MOTOR, "gear_ratio"),
    Quantity("screw", "lead", Place.SCREW, "travel_per_turn_m"),
    Quantity("added", "torque_ln_factor", Place.MOTOR, "torque_gain"),
    Quantity("added", "response_ln_factor", Place.SENSOR, "response_gain"),
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
    return tuple(quantity for quantity in present if has_quantity(axis, quantity.record, quantity.field))


#: Of χ² over θ², below which a setting asks for nothing.
_FLAT = 1e-3
_COARSE = np.array([0.03, 0.07, 0.12, 0.2, 0.3, 0.45, 0.7, 1.1, 1.6, 2.3, 3.2, 4.2])
_FEW = _COARSE[1::3]
#: A resonance of its own is narrow: of a damping ratio of a few per cent no step may lie far from the next.
_FINE = np.concatenate([np.arange(0.015, 0.3, 0.015), [0.36, 0.44, 0.54]])
#: Lines one after the other that are held out, and of how many: neighbours are alike.
_RUN, _OF_LINES = 4, 12


@dataclass(frozen=True, slots=True, eq=False)
class FreeVariation:
    """The misfit of each setting as a function of the quantity there."""

    quantity: Quantity
    ln_factor: FloatArray  # θ, rising, shape (n_values,)
    cost: FloatArray  # χ² of each fitted setting at each θ, shape (n_settings, n_values)
    held_out: FloatArray  # the same of lines of these settings that were not fitted

    def __post_init__(self) -> None:
        object.__setattr__(self, "ln_factor", read_only(self.ln_factor))
        object.__setattr__(self, "cost", read_only(self.cost))
        object.__setattr__(self, "held_out", read_only(self.held_out))

    @property
    def alike(self) -> float:
        """χ² with the quantity as it is best for all settings alike."""
        return float(np.min(np.sum(self.cost, axis=0)))

    @property
    def free(self) -> float:
        """χ² with the quantity as it is best for each setting."""
        return float(np.sum(np.min(self.cost, axis=1)))

    @property
    def alike_everywhere(self) -> float:
        """χ² of all lines, with the quantity as it is best for all settings alike."""
        return float(np.min(np.sum(self.cost + self.held_out, axis=0)))

    @property
    def judged(self) -> float:
        """χ² of all lines, each part of them with the quantity as the other part of its setting has it best.

        A setting without lines that were held out has it as is best for all settings alike.
        """
        settings = np.arange(self.cost.shape[0])
        everywhere = np.argmin(np.sum(self.cost + self.held_out, axis=0))
        of_others = np.where(np.any(self.held_out, axis=1), np.argmin(self.held_out, axis=1), everywhere)
        by_others = self.cost[settings, of_others]
        return float(np.sum(by_others + self.held_out[settings, np.argmin(self.cost, axis=1)]))

    @property
    def asked(self) -> tuple[FloatArray, FloatArray]:
        """θ that each setting asks for, and its variance for residuals of size one, each of shape (n_settings,)."""
        best = np.clip(np.argmin(self.cost, axis=1), 1, self.ln_factor.size - 2)
        near = best + np.arange(-1, 2)[:, None]
        (left, middle, right), values = self.ln_factor[near], self.cost[np.arange(best.size), near]
        before, after = np.diff(values, axis=0) / np.diff(self.ln_factor[near], axis=0)
        bend = np.maximum((after - before) / (right - left), _FLAT)
        return np.clip(0.5 * (left + middle) - 0.5 * before / bend, left, right), 1.0 / bend

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


def vary_freely(
    fitted: Fitted[AxisPhysics], quantity: Quantity, *, roughly: bool = False, here: AxisPhysics | None = None
) -> FreeVariation | None:
    """Return what the settings that were fitted leave with a quantity of their own; None where there is no answer.

    It varies about the axis as fitted, or about one ``here`` that is near to that. Seen ``roughly`` it varies by a few
    values only, enough to tell what may be worth a closer look.
    """
    steps = _FINE if quantity.is_frequency else _FEW if roughly else _COARSE
    here = here or fitted.physics()
    answered, squares = squares_along(
        fitted,
        np.concatenate([-steps[::-1], [0.0], steps]),
        lambda theta: multiplied(here, quantity.record, quantity.field, math.exp(theta)),
    )
    if answered.size < 3:
        return None
    seen = fitted.fitted.astype(np.float64)
    fitted_lines, others = (
        np.array([summed_by_setting(fitted, each * chosen) for each in squares]).T for chosen in (seen, 1.0 - seen)
    )
    return FreeVariation(quantity, answered, fitted_lines, others)


def judged_on_lines(fitted: Fitted[AxisPhysics]) -> Fitted[AxisPhysics]:
    """Return a fit to all settings, and to most of their lines, whatever was held out: the same lines of each setting.

    What is local cannot be seen, nor told, where nothing was fitted. Raises OutsideValidityError as a fit does.
    """
    layout = fitted.comparison.layout
    out = _numbers_of_lines(layout) % _OF_LINES < _RUN
    common = layout.common
    if common is not None:
        group = np.unique(np.column_stack([common.group, out]), axis=0, return_inverse=True)[1].reshape(-1)
        common = CommonErrors(group, common.deviation)
    there: Any = fitted.comparison
    comparison = replace(there, layout=replace(layout, held_out=(out,), common=common))
    return fit(comparison, fitted.hypothesis, fitted.coordinates, ~out, errors=fitted.around.errors)


def _numbers_of_lines(layout: Layout) -> npt.NDArray[np.intp]:
    """Return the place of each line on the grid of the longest response, continued at both ends, (n_values,).

    Responses may have grids that are offset from each other: neighbours of two are one line of the axis.
    """
    series, frequency = series_of(layout), layout.frequency
    grid = np.unique(frequency[series == np.argmax(np.bincount(series))])
    step = float(np.median(np.diff(grid)))  # two lines that are the same but for rounding are no step
    below = np.arange(grid[0] - step, float(np.min(frequency)) - step, -step)[::-1]
    above = np.arange(grid[-1] + step, float(np.max(frequency)) + step, step)
    grid = np.concatenate([below, grid, above])
    return np.searchsorted(0.5 * (grid[:-1] + grid[1:]), frequency)


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


#: Levels of a variable that a form needs, which are the fewer the fewer coefficients it has.
_FEWEST_LEVELS = {Form.LINEAR: 2, Form.POWER: 3, Form.SATURATING: 3, Form.QUADRATIC: 4, Form.PERIODIC: 5,
                  Form.YIELDING: 4, Form.CLIPPED: 2, Form.STEP: 3, Form.DIP: 4}  # fmt: skip
#: What is so at some levels alone; how many numbers of it, beside its coefficients, are chosen among levels.
_LOCAL = {Form.CLIPPED: 0, Form.STEP: 1, Form.DIP: 2}
_PLACES, _WIDTHS = 4, (0.3, 0.45, 0.7, 1.1)  # of a dip: for each distance of levels, and of that
_MOST_LEVELS, _KNOTS = 8, 5  # with a value of their own; of more levels, how many have one
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

    @property
    def n_chosen(self) -> int:
        """How many numbers were chosen among levels, which no refit moves."""
        return _LOCAL.get(self.law.form, 0)

    @property
    def n_found(self) -> int:
        """How many numbers the law has in all."""
        return len(self.coefficients) + self.n_chosen


#: Amplitudes of what varies over levels; lengths over which it stays alike, of the span of the levels.
_SWINGS, _LENGTHS = (0.03, 0.1, 0.3, 1.0), (0.1, 0.2, 0.4, 0.8)
_OWN = (0.0, 0.03, 0.3)  # of its variance, what is each setting's own beside that [-]


def evidence_of_variables(
    variation: FreeVariation, settings: tuple[AxisSetting, ...], factor: float
) -> dict[Variable | None, float]:
    """Return ln of the evidence that the quantity follows each variable that varies, over that for a constant.

    None is no variable: a value of its own at each setting. ``factor`` is what χ² counts for.
    """
    asked, variance = variation.asked
    variance = variance / factor
    own = np.eye(asked.size)
    alike: dict[Variable | None, FloatArray] = {None: own[None]}
    for variable in Variable:
        x = np.array([variable.of(setting) for setting in settings])
        if _varies(x):
            distance = np.subtract.outer(x, x) / np.ptp(x)
            near = np.array([np.exp(-0.5 * (distance / length) ** 2) for length in _LENGTHS])
            alike[variable] = np.concatenate([share * own + (1.0 - share) * near for share in _OWN])
    constant = _evidence(asked, np.diag(variance))
    found = dict[Variable | None, float]()
    for which, kernels in alike.items():
        each = [_evidence(asked, np.diag(variance) + a**2 * kernel) for a in _SWINGS for kernel in kernels]
        found[which] = float(scipy.special.logsumexp(each)) - math.log(len(each)) - constant
    return found


def _evidence(values: FloatArray, covariance: FloatArray) -> float:
    inverse = np.linalg.inv(covariance)
    weight = float(np.sum(inverse))
    away = values - float(np.sum(inverse @ values)) / weight
    return -0.5 * float(np.linalg.slogdet(covariance)[1] + away @ inverse @ away + math.log(weight))


def _varies(x: FloatArray) -> bool:
    """Return whether levels differ by more than they are rounded."""
    return float(np.ptp(x)) > 1e-6 * max(float(np.max(np.abs(x))), 1e-30)


def _levels(x: FloatArray) -> FloatArray:
    return np.unique(np.round(x, 9))


def constant_law(variation: FreeVariation) -> TriedLaw:
    """Return the law of a quantity that is another one at every setting alike."""
    cost = np.sum(variation.cost, axis=0)
    change = math.expm1(variation.ln_factor[int(np.argmin(cost))])
    return TriedLaw(variation, Law(Variable.NOTHING, Form.CONSTANT, 0.0, 1.0), (change,), float(np.min(cost)))


def law_of_levels(variation: FreeVariation, variable: Variable, settings: tuple[AxisSetting, ...]) -> TriedLaw:
    """Return the law with a value at each level of a variable, at those that the settings ask for."""
    x = np.array([variable.of(setting) for setting in settings])
    levels = _levels(x)
    some = np.linspace(0, levels.size - 1, _KNOTS).round().astype(int)  # a knot between levels far apart has no data
    knots = levels if levels.size <= _MOST_LEVELS else levels[some]
    asked, variance = variation.asked
    near = np.array([np.interp(x, knots, row) for row in np.eye(knots.size)]).T
    values = np.linalg.lstsq(variance[:, None] ** -0.5 * near, variance**-0.5 * asked, rcond=None)[0]
    law = Law(variable, Form.LEVELS, float(knots[0]), float(np.ptp(knots)), tuple(knots.tolist()))
    return TriedLaw(variation, law, tuple(np.expm1(values).tolist()), math.nan)


def tried_laws(
    fitted: Fitted[AxisPhysics], variation: FreeVariation, of_levels: Variable | None = None
) -> tuple[TriedLaw, ...]:
    """Return every law that the settings could show, at its best coefficients, least χ² with its penalty first.

    With ``of_levels`` they are laws of that variable, and such among them as hold at some of its levels alone.
    """
    settings, lead = fitted_settings(fitted), fitted.physics().screw.lead
    tried = [tried_law(variation, law, settings) for law in _laws(settings, lead, of_levels)]
    laws = [law for law in tried if law is not None]
    penalty = np.log(max(variation.cost.shape[0], 2))
    return tuple(sorted(laws, key=lambda tried: tried.cost + penalty * tried.n_found))


def scale_of(fitted: Fitted[AxisPhysics], variation: FreeVariation) -> EvidenceScale:
    """Return the evidence scale at which what the free variation leaves counts as noise."""
    scale = evidence_scale(fitted)
    left = variation.free / max(scale.n_values - variation.cost.shape[0], 1)
    return EvidenceScale(max(left, 1.0), scale.correlation, scale.n_values)


def _laws(settings: tuple[AxisSetting, ...], lead: float, of_levels: Variable | None) -> Iterator[Law]:
    for variable in Variable if of_levels is None else (of_levels,):
        x = np.array([variable.of(setting) for setting in settings])
        levels, span = _levels(x), float(np.ptp(x))
        if not _varies(x):
            continue
        middle = float(np.median(x)) if variable is not Variable.ORDER else 0.0
        for form, fewest in _FEWEST_LEVELS.items():
            if levels.size < fewest or (form in _LOCAL and of_levels is None):
                continue
            if form in (Form.PERIODIC, Form.YIELDING):  # a few levels do not tell a turn from the way
                if variable is Variable.POSITION and of_levels is None:
                    yield Law(variable, form, 0.0, lead)
            elif form in (Form.POWER, Form.SATURATING, Form.CLIPPED):
                if variable in (Variable.EXCITATION, Variable.PRELOAD) and float(np.min(x)) > 0.0:
                    yield Law(variable, form, middle, middle)
            elif form in _LOCAL:
                yield from _at_places(variable, form, levels)
            else:
                yield Law(variable, form, middle, span)


def _at_places(variable: Variable, form: Form, levels: FloatArray) -> Iterator[Law]:
    """Yield steps between levels, or dips of several widths at many places."""
    if form is Form.STEP:
        for low, high in itertools.pairwise(levels.tolist()):
            yield Law(variable, form, 0.5 * (low + high), 0.5 * (high - low))
        return
    n = min(levels.size - 1, _MOST_LEVELS)
    apart = float(np.ptp(levels)) / n
    for place, width in itertools.product(np.linspace(levels[0], levels[-1], _PLACES * n + 1).tolist(), _WIDTHS):
        yield Law(variable, form, place, width * apart)


def tried_law(variation: FreeVariation, law: Law, settings: tuple[AxisSetting, ...]) -> TriedLaw | None:
    """Return a law at the best of the coefficients that are tried, beside the best level of the quantity, if any is."""
    x = np.array([law.variable.of(setting) for setting in settings])
    combinations, factors = [], []
    for coefficients in _TRIED[law.form]:
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


#: Coefficients that are tried of each form.
_TRIED: Mapping[Form, Sequence[tuple[float, ...]]] = {
    **{form: tuple(itertools.product(_CHANGES)) for form in (Form.LINEAR, Form.STEP, Form.DIP)},
    Form.POWER: tuple(itertools.product(_EXPONENTS)),
    Form.SATURATING: tuple(itertools.product(_CHANGES, _HALF_AT)),
    Form.CLIPPED: tuple(itertools.product(_HALF_AT)),
    Form.QUADRATIC: tuple(itertools.product(_SECOND, _SECOND)),
    Form.PERIODIC: tuple(itertools.product(_SECOND, _SECOND)),
    Form.YIELDING: tuple((size * np.cos(angle), size * np.sin(angle)) for size in _AMPLITUDES for angle in _ANGLES),
}
