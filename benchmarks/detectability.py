r"""d′: how many standard deviations the trace of a hidden effect has, when all else has taken up what it can.

.. math::

    d'^2 = \min_c \; |W (s - r(c))|^2 + |c|^2, \qquad s = \ln H_{with} - \ln H_{without}

with the truth's own plant on both sides: W weighs by the noise that was measured and the form error that a user has by
default, r is what a refit of the errors of settings and of the declared tolerances changes, c in their standard
deviations, and what else is hidden, free. No model of the product takes part. The form error of a line and channel is
one for all settings, as a model of a wrong form has it: what an effect does in all of them alike is not seen better in
thirty than in one. That error aside, lines count as independent. What depends on the amplitude scatters with the torque
that excites it, as noise does: it is computed for two torques, and d'² is the product of both remainders, which has
nothing of that scatter in the mean.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from monitor_core.fitting.conditions.settings import SettingTolerances
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.models.protocol import ResponsePoint
from tests.hidden_effects.cases import TOLERANCES, Case, part_of
from tests.hidden_effects.kinds import KINDS
from tests.hidden_effects.truth import finite_elements, transmission_line
from tests.hidden_effects.truth.axis import Axis, Hidden, Parts, Setting
from tests.hidden_effects.truth.measurement import APART, Recorder, Scatter, measure

_LEAST_SIGNAL_TO_NOISE = 8.0
_FREE = 1e3  # standard deviations that something free may have
_STEP = 1e-3
_ROUNDS = 4
_TEMPERS = (30.0, 8.0, 2.0, 1.0)
#: Of a line, in lines, and what the power of a Hann window takes from there: 1, 0.849², 0.5².
_OFFSETS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
_SHARES = np.array([0.25, 0.72, 1.0, 0.72, 0.25]) / 2.94
_TORQUES = (0, 1)
_STEPPED = ("guide_friction", "cubic_nut_stiffness", "nut_softening", "nut_backlash", "nut_contact_loss")


def detectability(case: Case, recorder: Recorder, form: ModelFormError) -> float:
    """Return d′ of the weakest thing that is hidden in a case; NaN for nothing."""
    keys = list(case.truth)
    if not keys or case.family != "receptance":
        return math.nan
    frequency = case.measured[0].frequency
    settings = case.settings
    linear = Axis(parts=case.axis.parts, hidden=replace(case.axis.hidden, **_defaults(_STEPPED)))
    weight = _Weight.of(case, form)
    here = _responses(linear, settings, frequency)
    traces = [_traces(case, key, linear, here, recorder) for key in keys]
    found = []
    for index, (key, of_torques) in enumerate(zip(keys, traces, strict=True)):
        others = [
            _flat(_FREE * weight(np.mean(other, axis=0))) for number, other in enumerate(traces) if number != index
        ]
        # a wrong part may simply be that wrong, at the price of its tolerance
        at_first = {part_of(key): case.truth[key]["ln_ratio"]} if key.startswith("wrong-parameter:") else {}
        left = [_left(_without(linear, key, case), case, weight, trace, others, at_first) for trace in of_torques]
        found.append(math.sqrt(max(float(left[0] @ left[-1]), 0.0)))
    return min(found)


def detectability_of_record(case: Case, recorder: Recorder, form: ModelFormError) -> float:
    """Return d′ of the record that is wrong beside what is hidden, which is known but for its sizes; NaN without one.

    What is wrong changes ln H of its setting, or of one channel there; its errors and all else are refitted. A position
    or a preload may simply be that wrong, at the price of its tolerance.
    """
    which, ln_factor = case.wrong_setting, case.wrong_ln_factor
    if which is None or ln_factor is None:
        return math.nan
    frequency, settings = case.measured[0].frequency, case.settings
    linear = Axis(parts=case.axis.parts, hidden=replace(case.axis.hidden, **_defaults(_STEPPED)))
    weight, here = _Weight.of(case, form), _responses(linear, settings, frequency)
    trace, price = np.zeros_like(here), math.inf
    trace[which] = ln_factor
    if not np.any(ln_factor):
        stated = case.measured[2 * which].stated
        trace[which] = np.log(here[which] / _responses(linear, [stated], frequency)[0])
        price = _price_of_tag(settings[which], stated)
    traces = [_traces(case, key, linear, here, recorder)[0] for key in case.truth]
    others = [_flat(_FREE * weight(each)) for each in traces]
    left = _left(linear, case, weight, trace, others, {})
    return min(math.sqrt(float(left @ left)), price)


def _price_of_tag(true: Setting, stated: Setting) -> float:
    """Return how many tolerances a position and a preload are off, infinitely many where another tag is."""
    if (true.payload, true.temperature_deviation) != (stated.payload, stated.temperature_deviation):
        return math.inf
    assumed = SettingTolerances()
    off = (true.position - stated.position) / assumed.position
    return math.hypot(off, math.log(true.preload / stated.preload) / assumed.preload_share)


def _left(  # noqa: PLR0917
    axis: Axis, case: Case, weight: "_Weight", trace: np.ndarray, others: list[np.ndarray], at_first: dict[str, float]
) -> np.ndarray:
    """Return what is left of a trace when an axis without it took up its share, in standard deviations.

    The axis is refitted as far as its tolerances let it.
    From ln ratios of parts ``at_first``; Gauss and Newton, tempered: as if noise were first many times as large, so
    that no resonance stands in the way.
    """
    frequency, settings = case.measured[0].frequency, case.settings
    here, n = _responses(axis, settings, frequency), len(settings)
    assumed, free = SettingTolerances(), 4 * n + len(TOLERANCES)

    def refitted(taken: np.ndarray) -> tuple[Axis, list[Setting]]:
        moved = [
            replace(setting, position=setting.position + assumed.position * errors[0],
                    preload=setting.preload * math.exp(assumed.preload_share * errors[1]))
            for setting, errors in zip(settings, taken[: 4 * n].reshape(n, 4), strict=True)
        ]  # fmt: skip
        changed = axis
        for (part, tolerance), by in zip(TOLERANCES.items(), taken[4 * n : free], strict=True):
            changed = _with_part(changed, part, tolerance * by)
        return changed, moved

    def slopes(taken: np.ndarray) -> np.ndarray:
        changed, moved = refitted(taken)
        there = _responses(changed, moved, frequency)
        columns = _settings_columns(changed, moved, frequency, there, weight) + [
            weight(np.log(_responses(_with_part(changed, part, tolerance * _STEP), moved, frequency) / there) / _STEP)
            for part, tolerance in TOLERANCES.items()
        ]
        return np.array([_flat(column) for column in columns] + others).T

    def left(taken: np.ndarray) -> np.ndarray:
        try:
            taken_up = np.log(_responses(*refitted(taken), frequency) / here)
        except (ValueError, OverflowError):  # off the screw, no preload left, or an overflow: a step too far
            return np.full(2 * here.size, 1e6)
        taken_up = taken_up + assumed.gain_share * taken[: 4 * n].reshape(n, 4)[:, 2:, None]
        return _flat(weight(trace - taken_up)) - sum(
            (by * other for by, other in zip(taken[free:], others, strict=True)), 0.0
        )

    taken = np.zeros(free + len(others))
    for part, by in at_first.items():
        taken[4 * n + list(TOLERANCES).index(part)] = by / TOLERANCES[part]
    for temper in _TEMPERS:
        steep, identity = slopes(taken) / temper, np.eye(taken.size)
        for _ in range(_ROUNDS):
            misfit = np.r_[left(taken) / temper, -taken]
            step, *_ = np.linalg.lstsq(np.vstack([steep, identity]), misfit)
            for share in (1.0, 0.4, 0.15):
                trial = taken + share * step
                tried = np.r_[left(trial) / temper, -trial]
                if tried @ tried < misfit @ misfit:
                    taken = trial
                    break
            else:
                break
            if tried @ tried > 0.98 * (misfit @ misfit):
                break
    return np.r_[left(taken), taken]


def _without(axis: Axis, key: str, case: Case) -> Axis:
    """Return the axis without one of the things that are hidden in it."""
    if key.startswith("wrong-parameter:"):
        return _with_part(axis, part_of(key), -case.truth[key]["ln_ratio"])
    mechanism, _ = KINDS[key].build(KINDS[key].sizes[0], np.random.default_rng(0))
    return replace(axis, hidden=replace(axis.hidden, **_defaults(mechanism)))


def _traces(case: Case, key: str, linear: Axis, here: np.ndarray, recorder: Recorder) -> list[np.ndarray]:
    """Return what an effect changes of the logarithms, shape (n_settings, 2, n_lines), under one torque or several."""
    frequency, settings = case.measured[0].frequency, case.settings
    if not key.startswith("wrong-parameter:"):
        mechanism, _ = KINDS[key].build(KINDS[key].sizes[0], np.random.default_rng(0))
        if any(name in _STEPPED for name in mechanism):
            both = case.axis, _without(case.axis, key, case)
            pairs = [[_measured(axis, settings, recorder, torque) for axis in both] for torque in _TORQUES]
            return [np.asarray(np.log(there / without)) for there, without in pairs]
    return [np.asarray(np.log(here / _responses(_without(linear, key, case), settings, frequency)))]


@dataclass(frozen=True, slots=True, eq=False)
class _Weight:
    """What turns logarithms of shape (n_settings, 2, n_lines) into standard deviations."""

    of_line: np.ndarray  # one over the standard deviation of each line; 0 where noise hides it
    along: np.ndarray  # the form error that all settings share, in these standard deviations

    @classmethod
    def of(cls, case: Case, form: ModelFormError) -> "_Weight":
        """Return the weight of what was measured in a case."""
        weights, shared = [], []
        for frf in case.measured:
            relative = frf.standard_deviation / np.abs(frf.response)
            deviation = form.of(ResponsePoint(frf.output)).relative_deviation(frf.frequency, frf.response)
            seen = relative * _LEAST_SIGNAL_TO_NOISE < 1.0
            weights.append(np.where(seen, 1.0 / np.hypot(relative, deviation), 0.0))
            shared.append(weights[-1] * deviation)
        shape = (len(case.settings), 2, -1)
        return cls(np.array(weights).reshape(shape), np.array(shared).reshape(shape))

    def __call__(self, logarithm: np.ndarray) -> np.ndarray:
        """Return (I + a aᵀ)^(-1/2) of the weighed values of each line and channel, a along the error they share."""
        values = self.of_line * logarithm
        power = np.sum(self.along**2, axis=0)
        shrink = 1.0 / (1.0 + power + np.sqrt(1.0 + power))
        return np.asarray(values - self.along * (shrink * np.sum(self.along * values, axis=0)))


def _settings_columns(
    axis: Axis, settings: Sequence[Setting], frequency: np.ndarray, here: np.ndarray, weight: _Weight
) -> list[np.ndarray]:
    """Return what an error of each setting changes, per standard deviation that is assumed by default."""
    assumed, columns = SettingTolerances(), []
    for index, setting in enumerate(settings):
        changes = []
        for name, deviation in (("position", assumed.position), ("preload", assumed.preload_share * setting.preload)):
            moved = replace(setting, **{name: getattr(setting, name) + _STEP * deviation})
            changes.append(np.log(_responses(axis, [moved], frequency)[0] / here[index]) / _STEP)
        changes += [assumed.gain_share * np.eye(2)[:, [channel]] for channel in (0, 1)]
        for change in changes:
            column = np.zeros_like(here)
            column[index] = change
            columns.append(weight(column))
    return columns


def _responses(axis: Axis, settings: Sequence[Setting], frequency: np.ndarray) -> np.ndarray:
    """Return responses as averages in Hann windows show them, which fill notches, shape (n_settings, 2, n_lines)."""
    offset = _OFFSETS * (np.min(np.diff(frequency)) / APART)
    fine = (frequency[:, None] + offset).ravel()
    answers = [transmission_line.frequency_response(axis, setting, fine) for setting in settings]
    return np.array(answers).reshape(len(settings), 2, frequency.size, offset.size) @ _SHARES


def _measured(axis: Axis, settings: Sequence[Setting], recorder: Recorder, torque: int) -> np.ndarray:
    """Return estimates without noise, under one of many random torques."""
    hidden = replace(axis.hidden, **_defaults(("constant_loss_factor",)))
    undisturbed = Recorder(recorder.sample_rate)
    exact = Scatter(sensor_noise=0.0, gain=0.0)
    rng = np.random.default_rng(torque)
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
