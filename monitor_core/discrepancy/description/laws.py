"""Find the law by which a quantity that varies from setting to setting follows how the axis is set."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.description.free_variation import FreeVariation
from monitor_core.effects.variation import Form, Law, Variable
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisSetting

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
    found = [tried_law(variation, law, settings) for law in _laws(settings, lead)]
    laws = [law for law in found if law is not None]
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
            return ((size * np.cos(at), size * np.sin(at)) for size in _AMPLITUDES for at in _ANGLES)
