r"""Watch several numbers of an axis together: what none of them shows alone shows in how they differ together.

A step of the directions d of several numbers, in standard deviations of each, shows best in the combination

.. math:: x = d^\mathsf{T} \hat\Omega^{-1} y

of the numbers y (Healy, Technometrics 29 (1987) 409–412), with their correlation Ω on the baseline, shrunk towards none
as Ledoit & Wolf (J. Multivar. Anal. 88 (2004) 365–411) do. What moves all numbers at once on a healthy axis, such as a
temperature that nobody measures, is taken out where numbers can be compared. Where it is known which way numbers go as
preload is lost, there is a combination for each subset of them; of others the whitened numbers, their sums and their
differences, each up and down (as Hawkins, Technometrics 33 (1991) 61–75, compares each with the others).

Each combination is one series, predicted as in :mod:`monitor_core.trend.belief`: level, season and temperature, an
autoregression in one of several structures r, Student's t. A cause that varies slowly and moves all numbers is in each
series as an autoregression and noise, however it is shared, and structures in which it is nearly everything belong
to those believed. One series is judged by its own past,
whatever the numbers have in common. A step since
session τ, half-normal with :data:`monitor_core.trend.joint_filter.STEP` standard deviations, is weighed against none as
in :mod:`monitor_core.trend.lasting_loss`, and the combinations alike:

.. math:: R_t = \sum_{\tau < t} \frac{1}{K} \sum_{k=1}^K \sum_r w_{kr} \frac{2}{s \sqrt{\Lambda_{\tau r}'}}
    \Phi\!\left( \frac{c_{\tau kr}}{\sqrt{\Lambda_{\tau r}'}} \right) \exp \frac{c_{\tau kr}^2}{2 \Lambda_{\tau r}'},
    \qquad c_{\tau kr} = \sum_{i \ge \tau} g_{ir} z_{ikr}, \quad
    \Lambda_{\tau r}' = s^{-2} + \sum_{i \ge \tau} g_{ir}^2

with the normal scores z of the errors and what the filter has left of a unit step in g. On a healthy axis
:math:`R_t - t` is a martingale, so that the sessions until R exceeds A are A or more in the mean (Pollak, Ann. Stat. 13
(1985) 206–227). The evidence is shared out among the numbers by the correlation's inverse root (Garthwaite & Koch,
Aust. N. Z. J. Stat. 58 (2016) 99–119).

A number that a session lacks is taken as the others let it expect, which leaves the combinations of the others; such a
session teaches nothing. One without any number goes by: only that it was lubricated is remembered.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.trend import joint_filter
from monitor_core.trend.belief import DAY, KELVIN, YEAR, change_in_a_day
from monitor_core.trend.charts import SESSIONS_PER_YEAR, DetectorDesign, LossDirection
from monitor_core.trend.detector import LEVEL_SIZE, RELEASE_COUNT, RELEASE_FRACTION, WHOLE
from monitor_core.trend.joint_filter import Bank, Judged, bank_from, judge, weighed_from
from monitor_core.trend.observation import SESSION
from monitor_core.uncertainty import Estimate

#: Numbers are watched that so large a part of the baseline's sessions have.
KNOWN = 0.9
#: A baseline holds so many sessions for each number: of fewer the combinations fit its scatter, and alarm too often.
SESSIONS_PER_NUMBER = 10
#: Of the false alarms stated for an axis, so many may come on top from the numbers together.
JOINT_SHARE = 0.2
#: An alarm ends, as those of one number do, when the weighted mean of the sessions has so often in a row less than a
#: fraction of the step that raised it; the newest session has this weight in it.
NEWEST = 0.2
_SIGNS = {LossDirection.RISE: 1.0, LossDirection.FALL: -1.0, None: 0.0}


@dataclass(frozen=True, slots=True)
class JointObservation:
    """The numbers of one accepted measurement, each in a unit in which its scatter is even, such as logarithms."""

    at: datetime
    values: Mapping[str, float]  # those that are known
    temperature: float | None = None  # of the structure [°C]
    in_doubt: bool = False
    lubricated: bool = False  # since the measurement before it, as somebody said

    def __post_init__(self) -> None:
        if self.at.tzinfo is None:
            raise OutsideValidityError(f"at must carry a time zone; got {self.at.isoformat()}")
        for name, value in self.values.items():
            if not math.isfinite(value):
                raise OutsideValidityError(f"{name} must be finite; got {value}")


@dataclass(frozen=True, slots=True)
class JointSession:
    """The measurements of one session: the mean of each number."""

    started_at: datetime
    last_at: datetime
    count: int = 0
    values: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    temperature: float | None = None
    n_temperatures: int = 0
    in_doubt: bool = False
    lubricated: bool = False

    def with_observation(self, new: JointObservation) -> "JointSession":
        """Return the session with one more measurement."""
        values, counts = dict(self.values), dict(self.counts)
        for name, value in new.values.items():
            counts[name] = counts.get(name, 0) + 1
            before = values.get(name, value)
            values[name] = before + (value - before) / counts[name]
        temperature, n = self.temperature, self.n_temperatures
        if new.temperature is not None:
            n += 1
            temperature = new.temperature if temperature is None else temperature + (new.temperature - temperature) / n
        return JointSession(
            self.started_at,
            new.at,
            self.count + 1,
            values,
            counts,
            temperature,
            n,
            self.in_doubt or new.in_doubt,
            self.lubricated or new.lubricated,
        )


@dataclass(frozen=True, slots=True)
class JointBelief:
    """What was learnt of the numbers of a healthy axis; plain values only."""

    names: tuple[str, ...]
    signs: tuple[float, ...]  # 1 for a number that rises as preload is lost, -1 for one that falls, 0: not known
    zeros: tuple[float, ...]  # the numbers are counted from here, ...
    units: tuple[float, ...]  # ... in these units
    started_at: datetime
    last_at: datetime  # of the last session, learnt or not
    n_sessions: int  # learnt
    n_measurements: int
    numbers: tuple[float, ...]  # of :class:`monitor_core.trend.joint_filter.Bank`
    reference_temperature: float | None = None
    latest_temperature: float | None = None


@dataclass(frozen=True, slots=True)
class NumberChange:
    """What one number has to do with an alarm."""

    name: str
    change: Estimate  # since the onset, in the unit of the number
    share: float  # of the evidence, 0 to 1


@dataclass(frozen=True, slots=True)
class JointEvidence:
    """Why the numbers together raised an alarm: as it was then."""

    raised_at: datetime
    onset: datetime
    log_evidence: float  # ln R
    limit: float
    changes: tuple[NumberChange, ...]  # by share, the largest first
    as_loss: bool | None = None  # they go the ways in which a loss of preload moves them; None: not known


@dataclass(frozen=True, slots=True)
class JointChart:
    """What all sessions together say, and the beginnings that a change may have had."""

    beginnings: tuple[datetime, ...] = ()
    numbers: tuple[float, ...] = ()  # of each, see :class:`monitor_core.trend.joint_filter.Weighed`
    log_evidence: float | None = None  # ln R after this session; None: not judged
    alarm: JointEvidence | None = None
    series: int = 0  # combination that raised the alarm, ...
    step: float = 0.0  # ... its step, in standard deviations, ...
    recent: float = 0.0  # ... and the weighted mean of its errors since then
    quiet: int = 0


@dataclass(frozen=True, slots=True)
class JointState:
    """Everything that is remembered between measurements: the fold of :func:`joint_step` over them."""

    last_at: datetime | None = None
    first_at: datetime | None = None
    n_sessions: int = 0
    session: JointSession | None = None  # that is going on
    learning: tuple[JointSession, ...] = ()
    learnt: JointBelief | None = None
    watching: bool = False
    before: JointChart = JointChart()  # before the session that is going on, ...
    chart: JointChart = JointChart()  # ... and what is said with what it has so far
    missing: tuple[str, ...] = ()  # numbers that the session that is going on lacks
    uncompared_since: datetime | None = None  # sessions since then have no number that can be compared

    @property
    def alarm(self) -> JointEvidence | None:
        """Evidence of the alarm that stands."""
        return self.chart.alarm


def joint_step(
    state: JointState,
    observation: JointObservation,
    design: DetectorDesign,
    loss: Mapping[str, LossDirection] | None = None,
) -> JointState:
    """Carry the joint chart over one more accepted measurement, later than all before it.

    A life begins with ``JointState()``. The baseline has the size and span of the design's, sessions in doubt not
    counted, and :data:`SESSIONS_PER_NUMBER` sessions for each number, within twice its size; fewer than two numbers are
    not watched together. ``loss`` says which way numbers go as preload is lost, where that is known; it holds from the
    baseline on. No session alarms alone: it may bring half of the limit.
    ``OutsideValidityError`` for an observation that is not later than the last.
    """
    at = observation.at
    if state.last_at is not None and at <= state.last_at:
        last, got = state.last_at.isoformat(), at.isoformat()
        raise OutsideValidityError(f"observations must come in time order: expected one after {last}; got {got}")
    session = state.session
    if session is None or at - session.started_at >= SESSION:
        state, session = _closed(state, design, loss or {}), JointSession(at, at)
        first_at = at if state.first_at is None else state.first_at
        state = replace(state, first_at=first_at, n_sessions=state.n_sessions + 1)
    session = session.with_observation(observation)
    uncompared_since = None if session.values else state.uncompared_since or at
    state = replace(state, session=session, last_at=at, uncompared_since=uncompared_since)
    if not state.watching or state.learnt is None:
        return state
    learnt = state.learnt
    chart = state.before
    if session.count * learnt.n_sessions >= WHOLE * learnt.n_measurements:
        chart, _ = _carried(chart, learnt, session, joint_limit(state, design))
    chart = replace(chart, beginnings=(), numbers=())  # they go on from before the session
    return replace(state, chart=chart, missing=tuple(name for name in learnt.names if name not in session.values))


def joint_reset(state: JointState) -> JointState:
    """Learn the level anew, because a person has looked at the axis and found it in order."""
    return JointState(last_at=state.last_at, first_at=state.first_at, n_sessions=state.n_sessions, learnt=state.learnt)


def joint_limit(state: JointState, design: DetectorDesign) -> float:
    """Return the limit of ln R: the sessions between two false alarms, at the pace at which those of the axis come."""
    per_year = design.settings.sessions_per_year
    if state.first_at is not None and state.session is not None and state.session.started_at > state.first_at:
        years = (state.session.started_at - state.first_at) / timedelta(days=SESSIONS_PER_YEAR)
        per_year = (state.n_sessions - 1) / years
    return math.log(max(per_year / (JOINT_SHARE * design.settings.false_alarms_per_year), 2.0))


def _closed(state: JointState, design: DetectorDesign, loss: Mapping[str, LossDirection]) -> JointState:
    """Close the session that was going on: learn it."""
    session = state.session
    if session is None:
        return state
    if state.watching and state.learnt is not None:
        chart, belief = _carried(state.before, state.learnt, session, joint_limit(state, design))
        return replace(state, session=None, before=chart, chart=chart, learnt=belief)
    if session.in_doubt or not session.values:
        return replace(state, session=None)
    settings, learnt = design.settings, state.learnt
    # of numbers that come and go the newest sessions tell which can be watched
    collected = (*state.learning, session)
    n_numbers = len({name for each in collected for name in each.values})
    collected = collected[-max(2 * settings.baseline_size, SESSIONS_PER_NUMBER * n_numbers) :]
    if learnt is None:
        span = collected[-1].started_at - collected[0].started_at
        enough = len(collected) >= settings.baseline_size and span >= settings.baseline_span
        learnt = _begun(collected, loss) if enough else None
        if learnt is not None and len(collected) < SESSIONS_PER_NUMBER * len(learnt.names):
            learnt = None
    else:
        enough = len(collected) >= LEVEL_SIZE
        learnt = _with_bank(learnt, joint_filter.reopened(_bank(learnt))) if enough else None
    if learnt is None:
        return replace(state, session=None, learning=collected)
    for each in collected:
        learnt = _learnt(learnt, each, _judged(learnt, each))
    return replace(state, session=None, learning=(), learnt=learnt, watching=True)


def _begun(sessions: Sequence[JointSession], loss: Mapping[str, LossDirection]) -> JointBelief | None:
    """Return the belief before anything is learnt, of the numbers that most sessions have and that scatter."""
    names, zeros, units = [], [], []
    for name in sorted({name for session in sessions for name in session.values}):
        values = np.array([session.values[name] for session in sessions if name in session.values])
        scatter = float(values.std(ddof=1)) if len(values) > 1 else 0.0
        if len(values) >= KNOWN * len(sessions) and scatter > 0.0:
            names.append(name)
            zeros.append(float(values.mean()))
            units.append(scatter)
    if len(names) < 2:
        return None
    temperatures = [session.temperature for session in sessions if session.temperature is not None]
    reference, first = float(np.mean(temperatures)) if temperatures else None, sessions[0].started_at
    signs = tuple(_SIGNS.get(loss.get(name), 0.0) for name in names)
    whole = [[session.values[name] for name in names] for session in sessions if set(names) <= set(session.values)]
    scattered = (np.array(whole) - np.array(zeros)) / np.array(units)
    numbers = joint_filter.begin(joint_filter.correlation_of(scattered), signs).numbers()
    return JointBelief(tuple(names), signs, tuple(zeros), tuple(units), first, first, 0, 0, numbers, reference)


def _bank(belief: JointBelief) -> Bank:
    return bank_from(belief.numbers, len(belief.names))


def _with_bank(belief: JointBelief, bank: Bank) -> JointBelief:
    return replace(belief, numbers=bank.numbers())


def _judged(belief: JointBelief, session: JointSession) -> Judged:
    now, reference, apart = session.temperature, belief.reference_temperature, session.started_at - belief.last_at
    warmer = 0.0 if now is None or reference is None else (now - reference) / KELVIN
    change = change_in_a_day(belief.latest_temperature, now, apart) if apart else None
    row = joint_filter.design_row((session.started_at - belief.started_at) / YEAR, change or 0.0, warmer)
    known = np.array([name in session.values for name in belief.names])
    values = np.array([session.values.get(name, zero) for name, zero in zip(belief.names, belief.zeros, strict=True)])
    values = (values - np.array(belief.zeros)) / np.array(belief.units)
    # nobody knows what fresh grease does to friction and damping until they have been measured with it
    bank = joint_filter.reopened(_bank(belief)) if session.lubricated else _bank(belief)
    return judge(bank, row, apart / DAY, values, known)


def _teaches(belief: JointBelief, session: JointSession) -> bool:
    return not session.in_doubt and all(name in session.values for name in belief.names)


def _learnt(belief: JointBelief, session: JointSession, judged: Judged) -> JointBelief:
    """Learn a session, or let it go by."""
    belief = replace(belief, last_at=session.started_at, latest_temperature=session.temperature)
    if not _teaches(belief, session):
        return _with_bank(belief, judged.bank)
    counted = replace(belief, n_sessions=belief.n_sessions + 1, n_measurements=belief.n_measurements + session.count)
    return _with_bank(counted, joint_filter.learn(judged))


def _carried(
    chart: JointChart, belief: JointBelief, session: JointSession, limit: float
) -> tuple[JointChart, JointBelief]:
    """Carry chart and belief over a session. Nothing is learnt of one in doubt, nor while an alarm stands."""
    days = (session.started_at - belief.last_at) / DAY
    if not any(name in session.values for name in belief.names):
        return chart, _with_bank(belief, joint_filter.reopened(_bank(belief))) if session.lubricated else belief
    judged = _judged(belief, session)
    if chart.alarm is not None:
        gone_by = replace(belief, last_at=session.started_at, latest_temperature=session.temperature)
        return _standing(chart, judged), _with_bank(gone_by, judged.bank)
    at, before = chart.beginnings, weighed_from(chart.numbers, judged.bank.series.shape[0])
    teaches = _teaches(belief, session)
    weighed = joint_filter.weigh(before, judged, days, belief.signs, limit=limit, learns=teaches)
    learnt = _learnt(belief, session, judged)
    of_series = joint_filter.log_evidence(weighed, judged, belief.signs)
    each = joint_filter.log_sum(of_series)
    log_evidence = float(joint_filter.log_sum((each + weighed.merged)[: len(at)])) if at else None
    if log_evidence is not None and log_evidence > limit:
        best = int(np.argmax(each[: len(at)]))
        changes = _changes(belief, judged, *joint_filter.changes_since(weighed, judged, each + weighed.merged))
        series = int(np.argmax(of_series[best]))
        as_loss = series < joint_filter.n_losses(belief.signs)
        alarm = JointEvidence(session.last_at, at[best], log_evidence, limit, changes, as_loss)
        now = joint_filter.step_of(weighed, judged, best, series)
        bank = joint_filter.without_step(_bank(learnt), weighed, best)
        chart = JointChart(log_evidence=log_evidence, alarm=alarm, series=series, step=now, recent=now)
        return chart, _with_bank(learnt, bank)
    weighed, gone = joint_filter.thinned(weighed, each)
    kept = tuple(moment for index, moment in enumerate((*at, session.started_at)) if index != gone)
    return JointChart(kept, weighed.numbers(), log_evidence), learnt


def _changes(
    belief: JointBelief, judged: Judged, step: FloatArray, uncertainty: FloatArray, share: FloatArray
) -> tuple[NumberChange, ...]:
    p, degrees = len(belief.names), 2.0 * judged.bank.shape
    unit = judged.bank.scatter[-p:] * np.array(belief.units)
    changes = [
        NumberChange(name, Estimate(float(change), float(deviation), degrees), float(part))
        for name, change, deviation, part in zip(belief.names, step * unit, uncertainty * unit, share, strict=True)
    ]
    return tuple(sorted(changes, key=lambda item: -item.share))


def _standing(chart: JointChart, judged: Judged) -> JointChart:
    """Keep or release an alarm."""
    recent = (1.0 - NEWEST) * chart.recent + NEWEST * float(judged.relative[chart.series])
    quiet = chart.quiet + 1 if recent / chart.step < RELEASE_FRACTION else 0
    if quiet >= RELEASE_COUNT:
        return JointChart()
    return replace(chart, recent=recent, quiet=quiet)
