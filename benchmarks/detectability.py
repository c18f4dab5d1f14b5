r"""d′: how many standard deviations the trace of a hidden effect has, when all else has taken up what it can.

.. math::

    d'^2 = \min_c \; |W (s - J c)|^2 + |c|^2, \qquad s = \ln H_{with} - \ln H_{without}

with the truth's own plant on both sides: W weighs by the noise that was measured and the form error that a user has by
default, J holds the errors of settings and the declared tolerances, each per standard deviation, and what else is
hidden, free. No model of the product takes part. Lines count as independent.
"""

import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from monitor_core.fitting.conditions.settings import SettingTolerances
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.models.protocol import ResponsePoint
from tests.hidden_effects.cases import TOLERANCES, Case, part_of
from tests.hidden_effects.kinds import KINDS
from tests.hidden_effects.truth import finite_elements, transmission_line
from tests.hidden_effects.truth.axis import Axis, Hidden, Parts, Setting
from tests.hidden_effects.truth.measurement import Recorder, Scatter, measure

_LEAST_SIGNAL_TO_NOISE = 8.0
_FREE = 1e3  # standard deviations that something free may have
_STEP = 1e-3
_STEPPED = ("guide_friction", "cubic_nut_stiffness", "nut_softening", "nut_backlash", "nut_contact_loss")


def detectability(case: Case, recorder: Recorder, form: ModelFormError) -> float:
    """Return d′ of the weakest thing that is hidden in a case; NaN for nothing."""
    keys = list(case.truth)
    if not keys or case.family != "receptance":
        return math.nan
    frequency = case.measured[0].frequency
    settings = case.settings
    linear = Axis(parts=case.axis.parts, hidden=replace(case.axis.hidden, **_defaults(_STEPPED)))
    here = _responses(linear, settings, frequency)
    weight = _weights(case, form)
    columns = _settings_columns(linear, case, here, weight) + [
        weight * np.log(_responses(_with_part(linear, part, tolerance * _STEP), settings, frequency) / here) / _STEP
        for part, tolerance in TOLERANCES.items()
    ]
    traces = [weight * _trace(case, key, linear, here, recorder) for key in keys]
    found = []
    for index, trace in enumerate(traces):
        others = [_FREE * other for number, other in enumerate(traces) if number != index]
        jacobian = np.array([_flat(column) for column in columns + others]).T
        augmented = np.vstack([jacobian, np.eye(jacobian.shape[1])])
        aim = np.r_[_flat(trace), np.zeros(jacobian.shape[1])]
        taken, *_ = np.linalg.lstsq(augmented, aim)
        found.append(float(np.linalg.norm(aim - augmented @ taken)))
    return min(found)


def _trace(case: Case, key: str, linear: Axis, here: np.ndarray, recorder: Recorder) -> np.ndarray:
    """Return what one effect changes of the logarithms, shape (n_settings, 2, n_lines)."""
    frequency, settings = case.measured[0].frequency, case.settings
    if key.startswith("wrong-parameter:"):
        ln_ratio = case.truth[key]["ln_ratio"]
        return np.asarray(np.log(here / _responses(_with_part(linear, part_of(key), -ln_ratio), settings, frequency)))
    mechanism, _ = KINDS[key].build(KINDS[key].sizes[0], np.random.default_rng(0))
    absent = _defaults(mechanism)
    if any(name in _STEPPED for name in mechanism):
        without = replace(case.axis, hidden=replace(case.axis.hidden, **absent))
        return np.asarray(np.log(_measured(case.axis, settings, recorder) / _measured(without, settings, recorder)))
    without = replace(linear, hidden=replace(linear.hidden, **absent))
    return np.asarray(np.log(here / _responses(without, settings, frequency)))


def _weights(case: Case, form: ModelFormError) -> np.ndarray:
    """Return one over the standard deviation of each line; 0 where noise hides it, shape (n_settings, 2, n_lines)."""
    weights = []
    for frf in case.measured:
        relative = frf.standard_deviation / np.abs(frf.response)
        deviation = form.of(ResponsePoint(frf.output)).relative_deviation(frf.frequency, frf.response)
        seen = relative * _LEAST_SIGNAL_TO_NOISE < 1.0
        weights.append(np.where(seen, 1.0 / np.hypot(relative, deviation), 0.0))
    return np.array(weights).reshape(len(case.settings), 2, -1)


def _settings_columns(axis: Axis, case: Case, here: np.ndarray, weight: np.ndarray) -> list[np.ndarray]:
    """Return what an error of each setting changes, per standard deviation that is assumed by default."""
    assumed, frequency, columns = SettingTolerances(), case.measured[0].frequency, []
    for index, setting in enumerate(case.settings):
        changes = []
        for name, deviation in (("position", assumed.position), ("preload", assumed.preload_share * setting.preload)):
            moved = replace(setting, **{name: getattr(setting, name) + _STEP * deviation})
            changes.append(np.log(_responses(axis, [moved], frequency)[0] / here[index]) / _STEP)
        changes += [np.array([[share], [assumed.gain_share - share]]) for share in (0.0, assumed.gain_share)]
        for change in changes:
            column = np.zeros_like(here)
            column[index] = weight[index] * change
            columns.append(column)
    return columns


def _responses(axis: Axis, settings: Sequence[Setting], frequency: np.ndarray) -> np.ndarray:
    answers = [transmission_line.frequency_response(axis, setting, frequency) for setting in settings]
    return np.array(answers)


def _measured(axis: Axis, settings: Sequence[Setting], recorder: Recorder) -> np.ndarray:
    """Return the logarithms of estimates without noise, under the same torque each time."""
    hidden = replace(axis.hidden, **_defaults(("constant_loss_factor",)))
    undisturbed = Recorder(recorder.sample_rate)
    exact = Scatter(sensor_noise=0.0, gain=0.0)
    rng = np.random.default_rng(0)
    seen = measure(
        replace(axis, hidden=hidden), settings, settings, exact, rng,
        respond=finite_elements.respond, recorder=undisturbed,
    )  # fmt: skip
    return np.array([frf.response for frf in seen]).reshape(len(settings), 2, -1)


def _with_part(axis: Axis, part: str, ln_ratio: float) -> Axis:
    value = getattr(axis.parts, part) * math.exp(ln_ratio)
    parts: Parts = replace(axis.parts, **{part: value})
    return replace(axis, parts=parts)


def _defaults(names: "Sequence[str] | dict[str, float]") -> dict[str, float]:
    return {item.name: item.default for item in fields(Hidden) if item.name in names}  # type: ignore[misc]


def _flat(values: np.ndarray) -> np.ndarray:
    """Return real and imaginary parts; a turn of phase between the two is none."""
    return np.r_[values.real.ravel(), values.imag.ravel()]
