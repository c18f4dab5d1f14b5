"""The charts of many axes at once: the arithmetic of :func:`monitor_core.trend.step` with the axes as an array.

The product steps one axis. For a rate to within a tenth hundreds of years are wanted, each of up to 8,760
measurements; here a measurement of a hundred axes costs little more than that of one. It is a copy, worth what
``tests/trend/test_many_charts.py`` shows: on axes of every kind it raises the alarms of ``step``, to the measurement.
Left out is what the axes of :mod:`benchmarks.false_alarms` do not have: doubts, sisters, months of silence, covariates
that are known at times. An alarm is cleared as soon as it is raised. Times are whole seconds.
"""

import math
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import special

from monitor_core.trend import DetectorDesign, LossDirection, Prior, belief as b, detector as d
from monitor_core.trend.charts import EWMA_WEIGHT, SESSIONS_PER_YEAR, SHEWHART_CONSECUTIVE
from monitor_core.trend.lasting_loss import KEPT, LARGEST_WORD, STEP
from monitor_core.trend.learning import EVIDENCE_LIMIT, weigh_fall
from monitor_core.trend.observation import SESSION, Session

Array = npt.NDArray[Any]
Rows = dict[str, Array]  # of each axis

CORRELATION = np.array([structure.correlation for structure in b.STRUCTURES])
SHARE = np.array([structure.share for structure in b.STRUCTURES])
N, SIZE, SLOTS = len(b.STRUCTURES), b.N_COEFFICIENTS + 1, KEPT + 1
DAY = 86400.0
TAKES, YEAR = SESSION.total_seconds(), b.YEAR.total_seconds()
BEGIN = datetime(2026, 1, 1, tzinfo=UTC)  # of the seconds
SESSION_KEYS = ("start", "count", "value", "squares", "temperature", "friction", "lubricated")
#: A session that is not whole can alarm by :data:`monitor_core.trend.detector.SUDDEN_LIMIT` only, and is looked at only
#: where it is off by so much of the scatter: less is no five standard deviations, whatever the days before say.
SUSPICIOUS = 1.5


def of(rows: Rows, which: Array) -> Rows:
    """Return some of the axes."""
    return {name: values[which] for name, values in rows.items()}


def put(rows: Rows, which: Array, new: Rows) -> None:
    """Write some of the axes."""
    for name, values in new.items():
        rows[name][which] = values


def begun(first: Rows, variance: Array) -> Rows:
    """Return beliefs before anything is learnt (``belief.begin``)."""
    n, prior = len(variance), Prior()
    mean, covariance = np.zeros((n, N, SIZE)), np.zeros((n, N, SIZE, SIZE))
    covariance[..., range(SIZE), range(SIZE)] = [b._OPEN**2, *(s**2 for s in prior.deviations), 0.0]
    covariance[..., -1, -1] = SHARE
    shape = np.full((n, N), 0.5 * prior.degrees_of_freedom)
    none = np.full(n, np.nan)
    return {
        "mean": mean, "covariance": covariance, "shape": shape, "rate": shape * variance[:, None],
        "log_weight": np.tile(np.log(prior.weights), (n, 1)),
        "start": first["start"].copy(), "last": first["start"].copy(), "zero": first["value"].copy(),
        "sessions": np.zeros(n), "observations": np.zeros(n), "within": np.zeros(n),
        "of_temperature": none.copy(), "of_friction": none.copy(), "temperature": none.copy(),
        "friction": none.copy(), "steps": np.zeros(n), "step_mean": np.zeros(n), "step_squares": np.zeros(n),
    }  # fmt: skip


def weight_of(belief: Rows) -> Array:
    """Return the probability of each structure."""
    relative = np.exp(belief["log_weight"] - belief["log_weight"].max(axis=1, keepdims=True))
    return np.asarray(relative / relative.sum(axis=1, keepdims=True))


def variance_of(belief: Rows) -> Array:
    """Return the scatter as it is believed."""
    return np.asarray((weight_of(belief) * belief["rate"] / belief["shape"]).sum(axis=1))


def predict(belief: Rows, session: Rows) -> Rows:
    """Predict a session of each axis (``belief.predict``)."""
    apart = (session["start"] - belief["last"]) / DAY
    decay = CORRELATION ** apart[:, None]
    mean, covariance = belief["mean"].copy(), belief["covariance"].copy()
    mean[..., -1] *= decay
    covariance[..., -1, :] *= decay[..., None]
    covariance[..., :, -1] *= decay[..., None]
    covariance[..., -1, -1] += SHARE * (1.0 - decay**2)
    stepped = session["friction"] - belief["friction"]
    usual = np.sqrt(belief["step_squares"] / np.maximum(belief["steps"] - 1.0, 1.0))
    least = np.maximum(b.JUMP * usual, b.LEAST_JUMP * np.abs(belief["friction"]))
    lubricated = (session["lubricated"] > 0.0) | ((belief["steps"] >= b.FEWEST_STEPS) & (stepped > least))
    covariance[..., 0, 0] += b.LUBRICATION**2 * lubricated[:, None]

    angle = 2.0 * math.pi * (session["start"] - belief["start"]) / YEAR
    change = (session["temperature"] - belief["temperature"]) / b.KELVIN / np.maximum(apart, 1.0)
    warmer = (session["temperature"] - belief["of_temperature"]) / b.KELVIN
    stiffer = (session["friction"] - belief["of_friction"]) / (b.FRICTION_SHARE * np.abs(belief["of_friction"]))
    design = np.stack([
        np.ones_like(angle), 1.0 - np.cos(angle), np.sin(angle), np.nan_to_num(change), np.nan_to_num(warmer),
        np.nan_to_num(stiffer), np.ones_like(angle),
    ], axis=1)  # fmt: skip
    cross = (covariance @ design[:, None, :, None])[..., 0]
    variance, repeated = variance_of(belief), belief["observations"] - belief["sessions"]
    within = belief["within"] / np.maximum(repeated, 1.0)
    of_few = within * (1.0 / session["count"] - belief["sessions"] / np.maximum(belief["observations"], 1.0))
    noise = np.where(repeated > 0, np.maximum(of_few, 0.0) / variance, 0.0)
    spread = (cross * design[:, None]).sum(axis=2) + 1.0 - SHARE + noise[:, None]
    centre, scale = (mean * design[:, None]).sum(axis=2), np.sqrt(belief["rate"] / belief["shape"] * spread)
    weight, own = weight_of(belief), covariance[..., :-1, :-1] @ design[:, None, :-1, None]
    own = (own[..., 0] * design[:, None, :-1]).sum(axis=2)
    return {
        "mean": mean, "covariance": covariance, "design": design, "cross": cross, "spread": spread, "scale": scale,
        "decay": decay, "lubricated": lubricated, "stepped": stepped, "weight": weight,
        "error": (session["value"] - belief["zero"])[:, None] - centre,
        "difference": session["value"] - belief["zero"] - (weight * centre).sum(axis=1),
        "unlearnt": (weight * np.clip(own / spread, 0.0, 1.0)).sum(axis=1),
    }  # fmt: skip


def residual_of(belief: Rows, predicted: Rows) -> Array:
    """Return the residual of the sessions as normal scores."""
    ratio, degrees = predicted["error"] / predicted["scale"], 2.0 * belief["shape"]
    below = (predicted["weight"] * special.stdtr(degrees, ratio)).sum(axis=1)
    above = (predicted["weight"] * special.stdtr(degrees, -ratio)).sum(axis=1)
    score = special.ndtri(np.maximum(np.minimum(below, above), 1e-300))
    return np.where(below < above, score, -score)


def log_weight_of(belief: Rows, predicted: Rows) -> Array:
    """Return the weights once the sessions are known."""
    degrees, ratio = 2.0 * belief["shape"], predicted["error"] / predicted["scale"]
    evidence = (
        special.gammaln(0.5 * (degrees + 1.0)) - special.gammaln(0.5 * degrees) - 0.5 * np.log(degrees * math.pi)
        - np.log(predicted["scale"]) - 0.5 * (degrees + 1.0) * np.log1p(ratio**2 / degrees)
    )  # fmt: skip
    relative = belief["log_weight"] + evidence
    return np.asarray(relative - np.logaddexp.reduce(relative, axis=1, keepdims=True))


def _believed(predicted: Rows) -> Array:
    largest = b.LARGEST_LESSON * predicted["scale"]
    return np.clip(predicted["error"], -largest, largest)


def learn(belief: Rows, predicted: Rows, session: Rows) -> Rows:
    """Learn a session of each axis (``belief.learn``)."""
    gain, believed = predicted["cross"] / predicted["spread"][..., None], _believed(predicted)
    counted = ~predicted["lubricated"] & ~np.isnan(predicted["stepped"])
    off = np.where(counted, predicted["stepped"] - belief["step_mean"], 0.0)
    steps = belief["steps"] + counted
    step_mean = belief["step_mean"] + off / np.maximum(steps, 1.0)
    left = np.where(counted, predicted["stepped"] - step_mean, 0.0)
    return belief | {
        "mean": predicted["mean"] + gain * believed[..., None],
        "covariance": predicted["covariance"] - gain[..., :, None] * predicted["cross"][..., None, :],
        "shape": belief["shape"] + 0.5,
        "rate": belief["rate"] + 0.5 * believed**2 / predicted["spread"],
        "log_weight": log_weight_of(belief, predicted),
        "last": session["start"], "sessions": belief["sessions"] + 1,
        "observations": belief["observations"] + session["count"], "within": belief["within"] + session["squares"],
        "of_temperature": _first(belief["of_temperature"], session["temperature"]),
        "of_friction": _first(belief["of_friction"], session["friction"]),
        "steps": steps, "step_mean": step_mean, "step_squares": belief["step_squares"] + off * left,
        "temperature": session["temperature"], "friction": session["friction"],
    }  # fmt: skip


def _first(before: Array, now: Array) -> Array:
    return np.where(np.isnan(before), now, before)


def pass_over(belief: Rows, predicted: Rows, session: Rows) -> Rows:
    """Follow the autoregression over a session of each axis (``belief.pass_over``)."""
    gain = np.zeros_like(predicted["cross"])
    gain[..., -1] = predicted["cross"][..., -1] / predicted["spread"]
    both = gain[..., :, None] * predicted["cross"][..., None, :]
    square = gain[..., :, None] * gain[..., None, :] * predicted["spread"][..., None, None]
    return belief | {
        "mean": predicted["mean"] + gain * _believed(predicted)[..., None],
        "covariance": predicted["covariance"] - both - both.swapaxes(-1, -2) + square,
        "last": session["start"], "temperature": session["temperature"], "friction": session["friction"],
    }  # fmt: skip


def no_beginnings(n: int) -> Rows:
    """Return that no loss may have begun."""
    shape = (n, SLOTS, N)
    return {
        "n": np.zeros(n, dtype=int), "at": np.zeros((n, SLOTS)), "effect": np.zeros((*shape, SIZE)),
        "step": np.zeros(shape), "information": np.zeros(shape), "merged": np.zeros((n, SLOTS)),
    }  # fmt: skip


def weigh(beginnings: Rows, belief: Rows, predicted: Rows, session: Rows, sign: float) -> tuple[Rows, Array, Array]:
    """Weigh a session of each axis (``lasting_loss.weigh``): beginnings, logarithm of the evidence, best beginning."""
    axes, newest = np.arange(len(beginnings["n"])), beginnings["n"]
    new = {name: values.copy() for name, values in beginnings.items()}
    new["at"][axes, newest] = session["start"]
    for name in ("effect", "step", "information", "merged"):
        new[name][axes, newest] = 0.0
    new["effect"][..., -1] *= predicted["decay"][:, None]
    left = 1.0 - (new["effect"] @ predicted["design"][:, None, :, None])[..., 0]
    largest, spread = LARGEST_WORD * predicted["scale"], predicted["spread"]
    error = sign * np.clip(predicted["error"], -largest, largest)
    new["effect"] += left[..., None] * (predicted["cross"] / spread[..., None])[:, None]
    new["step"] += left * (error / spread)[:, None]
    new["information"] += left**2 / spread[:, None]
    new["n"] = newest + 1

    shape, rate = belief["shape"] + 0.5, belief["rate"] + 0.5 * error**2 / spread
    information = new["information"] + STEP**-2
    with_step = rate[:, None] - 0.5 * new["step"] ** 2 / information
    upwards = new["step"] / np.sqrt(information * with_step / shape[:, None])
    of_structure = (
        shape[:, None] * np.log(rate[:, None] / with_step) - 0.5 * np.log(STEP**2 * information)
        + math.log(2.0) + special.log_ndtr(upwards)
    )  # fmt: skip
    each = np.logaddexp.reduce(log_weight_of(belief, predicted)[:, None] + of_structure, axis=2)
    earlier = np.arange(SLOTS) < newest[:, None]
    own = each + new["merged"]
    evidence = np.logaddexp.reduce(np.where(earlier, own, -np.inf), axis=1)
    best = new["at"][axes, np.where(earlier, each, -np.inf).argmax(axis=1)]
    full = np.flatnonzero(new["n"] == SLOTS)
    if full.size:
        put(new, full, _thinned(of(new, full), own[full], each[full]))
    return new, evidence, best


def _thinned(new: Rows, own: Array, each: Array) -> Rows:
    pair = np.logaddexp(own[:, :-1], own[:, 1:]) + np.log(np.diff(new["at"], axis=1))
    axes, i = np.arange(len(own)), pair[:, :-1].argmin(axis=1)
    first = own[axes, i] >= own[axes, i + 1]
    stays, goes = np.where(first, i, i + 1), np.where(first, i + 1, i)
    new["merged"][axes, stays] = np.logaddexp(own[axes, i], own[axes, i + 1]) - each[axes, stays]
    kept = np.arange(SLOTS - 1) + (np.arange(SLOTS - 1) >= goes[:, None])
    for name in ("at", "effect", "step", "information", "merged"):
        new[name][:, :-1] = new[name][axes[:, None], kept]
    new["n"] -= 1
    return new


def without_loss(belief: Rows, beginnings: Rows, onset: Array, sign: float) -> Rows:
    """Give back what was taken for healthy of a loss (``lasting_loss.without_loss``)."""
    valid = np.arange(SLOTS) < beginnings["n"][:, None]
    nearest = np.where(valid, np.abs(beginnings["at"] - onset[:, None]), np.inf).argmin(axis=1)
    axes = np.arange(len(onset))
    effect, information = beginnings["effect"][axes, nearest], beginnings["information"][axes, nearest] + STEP**-2
    step = sign * np.maximum(beginnings["step"][axes, nearest], 0.0) / information
    unknown = effect[..., :, None] * effect[..., None, :] / information[..., None, None]
    return belief | {
        "mean": belief["mean"] - effect * step[..., None],
        "covariance": belief["covariance"] + unknown,
    }


def _row_of(session: Session) -> Rows:
    known = {
        "start": (session.started_at - BEGIN).total_seconds(), "count": session.count, "value": session.value,
        "squares": session.squares, "temperature": session.temperature, "friction": session.friction_torque,
        "lubricated": session.lubricated,
    }  # fmt: skip
    return {name: np.array([value], dtype=np.float64) for name, value in known.items()}


class ManyCharts:
    """The state of the detectors of many axes, all measured at the same moments."""

    def __init__(self, n: int, design: DetectorDesign) -> None:
        """Begin with nothing known."""
        self.n, self.design = n, design
        self.sign = -1.0 if design.settings.loss is LossDirection.FALL else 1.0
        zeros = np.zeros(n)
        self.session: Rows = {name: zeros.copy() for name in SESSION_KEYS}
        self.going_on, self.watching, self.has_learnt = (np.zeros(n, dtype=bool) for _ in range(3))
        self.first_at, self.n_sessions, self.scatter = np.full(n, np.nan), zeros.copy(), zeros.copy()
        self.collected: list[list[Session]] = [[] for _ in range(n)]
        self.learnt = begun(self.session, np.ones(n))
        self.known = begun(self.session, np.ones(n))
        self.seen, self.expected = np.zeros(n, dtype=bool), zeros.copy()  # as it stands, and of the session
        self.apart = np.zeros(n, dtype=bool)  # whether what is known differs from what is learnt
        self.beginnings = no_beginnings(n)
        self.weighed: tuple[Any, ...] | None = None  # the sessions that are going on
        names = ("residual", "cusum", "ewma", "beyond", "run", "total", "alert", "quiet")
        self.before: Rows = {name: zeros.copy() for name in names}
        self.charts: Rows = {name: zeros.copy() for name in names}

    def step(self, at: float, value: Array, temperature: Array, friction: Array, lubricated: Array) -> Array:
        """Judge one more measurement of each axis; alarms are returned, and cleared."""
        takes = self.going_on & (at - self.session["start"] < TAKES)
        alarmed = np.zeros(self.n, dtype=bool)
        over = np.flatnonzero(self.going_on & ~takes)
        if over.size:
            alarmed[over] = self._close(over)
        new = np.flatnonzero(~takes)
        first = {"start": at, "count": 0.0, "value": value[new], "squares": 0.0, "temperature": temperature[new]}
        for name, values in (first | {"friction": friction[new], "lubricated": 0.0}).items():
            self.session[name][new] = values
        self.first_at = np.where(np.isnan(self.first_at), at, self.first_at)
        self.n_sessions[new] += 1
        session = self.session
        session["count"] += 1.0
        off = value - session["value"]
        session["value"] += off / session["count"]
        session["squares"] += off * (value - session["value"])
        session["lubricated"] = np.maximum(session["lubricated"], lubricated)
        session["temperature"] += (temperature - session["temperature"]) / session["count"]
        session["friction"] += (friction - session["friction"]) / session["count"]
        self.going_on[:] = True
        for axis in np.flatnonzero(~self.watching & ~alarmed).tolist():
            alarmed[axis] = self._learn(axis)
        watched = np.flatnonzero(self.watching & self.going_on & ~alarmed)
        loss = self.sign * (session["value"][watched] - self.expected[watched])
        looked = (
            (session["count"][watched] == 1.0) | self._is_whole(watched) | (loss > SUSPICIOUS * self.scatter[watched])
        )
        self.seen[watched] = looked
        if looked.any():
            alarmed[watched[looked]] = self._watch(watched[looked])
        self._clear(np.flatnonzero(alarmed))
        return alarmed

    def _clear(self, which: Array) -> None:
        self.watching[which] = self.going_on[which] = False
        for axis in which.tolist():
            self.collected[axis] = []

    def _limits(self, which: Array) -> Rows:
        """Return the limits at the pace of each axis (``DetectorState.of``)."""
        span = (self.session["start"][which] - self.first_at[which]) / DAY / SESSIONS_PER_YEAR
        paces, of_pace = np.unique((self.n_sessions[which] - 1.0) / span, return_inverse=True)
        designs = [self.design.at_pace(pace) for pace in paces.tolist()]
        names = ("cusum_limit", "shewhart_limit", "ewma_limit", "evidence_limit", "largest_increment",
                 "largest_residual")  # fmt: skip
        return {name: np.array([getattr(design, name) for design in designs])[of_pace] for name in names}

    def _is_whole(self, which: Array) -> Array:
        return np.asarray(
            self.session["count"][which] * self.learnt["sessions"][which]
            >= d.WHOLE * self.learnt["observations"][which]
        )

    def _close(self, which: Array) -> Array:
        """Close the sessions that are over (``detector._closed``)."""
        alarmed = np.zeros(self.n, dtype=bool)
        learning, which_watched = which[~self.watching[which]], which[self.watching[which]]
        for axis in learning.tolist():
            self.collected[axis].append(self._session_of(axis))
        if which_watched.size:
            alarmed[which_watched] = self._close_watched(which_watched)
        return alarmed[which]

    def _close_watched(self, which: Array) -> Array:
        late = which[~self.seen[which]]
        if late.size:
            assert not self._watch(late).any()
        session, known, limits = of(self.session, which), of(self.known, which), self._limits(which)
        whole = self._is_whole(which)
        if self.weighed is not None and np.isin(which[whole], self.weighed[0]).all() and whole.all():
            axes, *weighed = self.weighed  # by its last measurement
            places = np.searchsorted(axes, which)
            predicted, beginnings = (of(rows, places) for rows in weighed[:2])
            evidence, onset = (values[places] for values in weighed[2:])
        else:
            predicted = predict(known, session)
            beginnings, evidence, onset = weigh(of(self.beginnings, which), known, predicted, session, self.sign)
        charts = of(self.charts, which)
        alarms, lasting, judged = _judged(charts, evidence, session, limits)
        charts = {name: np.where(whole, charts[name], judged[name]) for name in charts}
        alarms, lasting = alarms & ~whole, lasting & ~whole
        known = learn(known, predicted, session)
        settled = (
            (charts["ewma"] < 0.0) & (charts["run"] >= self.design.settings.baseline_size)
            & (np.abs(charts["total"] / np.maximum(charts["run"], 1.0)) <= d.LARGEST_SETTLED * self.scatter[which])
        )  # fmt: skip
        calm = (charts["cusum"] <= d.LEARNING_FRACTION * limits["cusum_limit"]) & ((charts["alert"] == 0.0) | settled)
        follows = np.flatnonzero(~calm | alarms)
        after = {name: values.copy() for name, values in known.items()}
        if follows.size:
            before, some = of(self.learnt, which[follows]), of(session, follows)
            put(after, follows, pass_over(before, predict(before, some), some))
        lost = np.flatnonzero(lasting)
        if lost.size:
            put(after, lost, without_loss(of(known, lost), of(beginnings, lost), onset[lost], self.sign))
        put(self.learnt, which, after)
        put(self.known, which, known)
        put(self.beginnings, which, beginnings)
        put(self.before, which, charts)
        self.apart[which] = ~calm | alarms
        self.scatter[which] = np.sqrt(variance_of(after))
        return alarms

    def _session_of(self, axis: int) -> Session:
        session = {name: float(values[axis]) for name, values in self.session.items()}
        at = BEGIN + timedelta(seconds=session["start"])
        temperature, friction = (
            None if math.isnan(session[name]) else session[name] for name in ("temperature", "friction")
        )
        return Session(
            at, at, int(session["count"]), session["value"], session["squares"], temperature=temperature,
            friction_torque=friction, lubricated=session["lubricated"] > 0.0,
        )  # fmt: skip

    def _learn(self, axis: int) -> bool:
        """Learn the baseline if there is enough for one, and say whether it falls instead (``detector._learn``)."""
        settings, sessions = self.design.settings, [*self.collected[axis], self._session_of(axis)]
        fall = weigh_fall(sessions, Prior(), towards_loss=self.sign)
        if fall is not None and fall.log_evidence > EVIDENCE_LIMIT:
            return True
        span = sessions[-1].started_at - sessions[0].started_at
        enough = len(sessions) >= settings.baseline_size and span >= settings.baseline_span
        if not (len(sessions) >= d.LEVEL_SIZE if self.has_learnt[axis] else enough):
            return False
        alone, rows = np.array([axis]), [_row_of(session) for session in sessions]
        if self.has_learnt[axis]:
            belief = of(self.learnt, alone)
            belief["covariance"][..., 0, 0] += b._OPEN**2
        else:
            values = np.array([session.value for session in sessions])
            deviation = np.median(np.abs(values - np.median(values))) / special.ndtri(0.75)
            belief = begun(rows[0], np.array([deviation**2]))
        for row in rows:
            belief = learn(belief, predict(belief, row), row)
        for kept in (self.learnt, self.known):
            put(kept, alone, belief)
        self.scatter[axis] = math.sqrt(variance_of(belief)[0])
        put(self.beginnings, alone, no_beginnings(1))
        self.apart[axis] = False
        for charts in (self.before, self.charts):
            put(charts, alone, {name: np.zeros(1) for name in charts})
        self._clear(alone)
        self.watching[axis] = self.has_learnt[axis] = True
        return False

    def _watch(self, which: Array) -> Array:
        """Judge the sessions as far as they have come (``detector._watch``)."""
        session, learnt, limits, before = (
            of(self.session, which), of(self.learnt, which), self._limits(which), of(self.before, which)
        )  # fmt: skip
        predicted = predict(learnt, session)
        residual = self.sign * residual_of(learnt, predicted)
        reference = self.design.cusum_reference + d.BASELINE_ALLOWANCE * np.sqrt(predicted["unlearnt"])
        evidence, whole = np.full(which.size, -np.inf), self._is_whole(which)
        some, self.weighed = np.flatnonzero(whole), None
        if some.size:
            known, part, expected = of(self.known, which[some]), of(session, some), of(predicted, some)
            apart = np.flatnonzero(self.apart[which[some]])
            if apart.size:
                put(expected, apart, predict(of(known, apart), of(part, apart)))
            weighed = weigh(of(self.beginnings, which[some]), known, expected, part, self.sign)
            evidence[some] = weighed[1]
            self.weighed = (which[some], expected, *weighed)
        grown = before["cusum"] + np.minimum(residual - reference, limits["largest_increment"])
        cusum = np.minimum(np.maximum(grown, 0.0), d.FULL_CHART * limits["cusum_limit"])
        winsorised = np.clip(residual, -limits["largest_residual"], limits["largest_residual"])
        ewma = (1.0 - EWMA_WEIGHT) * before["ewma"] + EWMA_WEIGHT * winsorised
        goes_on = ewma * before["ewma"] > 0.0
        charts = before | {
            "residual": residual, "cusum": cusum, "ewma": ewma,
            "beyond": np.where(residual > limits["shewhart_limit"], before["beyond"] + 1.0, 0.0),
            "run": np.where(goes_on, before["run"], 0.0) + 1.0,
            "total": np.where(goes_on, before["total"], 0.0) + predicted["difference"],
        }  # fmt: skip
        alarms, _, judged = _judged(charts, evidence, session, limits)
        sudden = (charts["beyond"] > 0.0) & (session["count"] > 1.0) & (residual > d.SUDDEN_LIMIT)
        self.expected[which] = session["value"] - predicted["difference"]
        put(self.charts, which, {name: np.where(whole, judged[name], charts[name]) for name in charts})
        return np.asarray(sudden | (whole & alarms))


def _judged(charts: Rows, evidence: Array, session: Rows, limits: Rows) -> tuple[Array, Array, Rows]:
    """Return alarms of whole sessions, those of them by all sessions together, and the charts after."""
    by_charts = (
        ((charts["beyond"] > 0.0) & (session["count"] > 1.0) & (charts["residual"] > d.SUDDEN_LIMIT))
        | (charts["beyond"] >= SHEWHART_CONSECUTIVE) | (charts["cusum"] > limits["cusum_limit"])
    )  # fmt: skip
    lasting = ~by_charts & (evidence > limits["evidence_limit"])
    alert = (charts["alert"] > 0.0) | (np.abs(charts["ewma"]) > limits["ewma_limit"])
    calm = np.abs(charts["ewma"]) < d.RELEASE_FRACTION * limits["ewma_limit"]
    quiet = np.where(calm, charts["quiet"] + 1.0, 0.0)
    after = charts | {"alert": 1.0 * (alert & (quiet < d.RELEASE_COUNT)), "quiet": quiet}
    return by_charts | lasting, lasting, after
