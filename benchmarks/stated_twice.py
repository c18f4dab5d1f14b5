"""How many windows that contradict themselves are silent and outside, on two machines the product does not know.

``python -m benchmarks.stated_twice [days [first seed]]``: each statement of :data:`SPOILT` is made wrong at each place
of so many days, those of :data:`WITHIN_STROKE` where strokes are long; then healthy measurements of six regimes, and of
axes wired in four ways, are counted that are doubted for nothing.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.cross_checks import cross_checked
from monitor_core.pipeline import AxisSettings, check_window, judge_measurement, search_band
from monitor_core.preload import Calibration, PreloadEstimate
from monitor_core.preload.drag_torque import Friction
from monitor_core.recording import Session, Window
from monitor_core.session import calibrate_session
from tests.plant.measurements import Acquisition
from tests.plant.shop import CASES, MACHINES, Machine, Truth, calibration_session, case_session

SETTINGS = AxisSettings(search_band=(120.0, 260.0))
Spoil = Callable[[Window], Window]


def tagged_off(metres: float) -> Spoil:
    """Let the position tag be off [m]."""
    return lambda w: replace(w, conditions=replace(w.conditions, position=w.conditions.position + metres))


def traced(change: Callable[[np.ndarray, Window], np.ndarray]) -> Spoil:
    """Change the position trace."""
    return lambda w: replace(w, position_trace=change(np.array(w.position_trace), w))


def late(samples: int) -> Spoil:
    """Let the trace lag by so many samples."""
    return traced(lambda x, w: np.concatenate([np.full(samples, x[0]), x[:-samples]]))


#: What is made wrong, and what is to be said of it.
SPOILT: dict[str, tuple[Spoil, str]] = {
    **{
        f"tag {1e3 * off:+.0f} mm": (tagged_off(off), "position-contradicts-trace")
        for off in (0.01, -0.01, 0.03, -0.03, 0.1, -0.1)
    },
    "tag in metres": (
        lambda w: replace(w, conditions=replace(w.conditions, position=1e-3 * w.conditions.position)),
        "position-contradicts-trace",
    ),
    "trace modulo 10 mm": (traced(lambda x, w: x % 0.01), "position-wraps"),
    "trace within one turn": (traced(lambda x, w: x - x.mean() + 0.005), "position-contradicts-trace"),
    "trace counted the other way": (traced(lambda x, w: x.min() + x.max() - x), "trace-contradicts-motion"),
    "trace from the far end": (traced(lambda x, w: 2.0 - x), "trace-contradicts-motion"),
    "trace negative": (traced(lambda x, w: -x), "trace-contradicts-motion"),
    "trace 2 samples late": (late(2), "trace-contradicts-motion"),
    "trace 5 samples late": (late(5), "trace-contradicts-motion"),
    "trace 20 samples late": (late(20), "trace-contradicts-motion"),
    "trace stuck": (traced(lambda x, w: np.full(x.size, x[0])), "trace-contradicts-motion"),
    "trace stuck at half of it": (
        traced(lambda x, w: np.where(np.arange(x.size) < x.size // 2, x, x[x.size // 2])),
        "trace-contradicts-motion",
    ),
    "trace in km": (traced(lambda x, w: 1e-3 * x), "trace-contradicts-motion"),
    "trace in radians": (traced(lambda x, w: x * 2.0 * np.pi), "trace-contradicts-motion"),
    "trace of another window": (traced(lambda x, w: np.roll(x, x.size // 3)), "trace-contradicts-motion"),
    "rate stated too low": (lambda w: replace(w, sample_rate=0.4 * w.sample_rate), "sample-rate-mismatch"),
}


#: Of strokes of 12 to 18 mm: tags that lie within the travel of their windows, or just off it.
WITHIN_STROKE: dict[str, tuple[Spoil, str]] = {
    f"tag {1e3 * off:+.0f} mm, long strokes": (tagged_off(off), "position-contradicts-trace")
    for off in (0.005, -0.005, 0.007, -0.007, 0.01, -0.01)
}
#: How torque and acceleration may count along an axis.
WIRINGS: dict[str, Spoil] = {
    "both forward": lambda w: w,
    "torque backward": lambda w: replace(w, excitation=-w.excitation),
    "acceleration backward": lambda w: replace(w, response=-w.response),
    "both backward": lambda w: replace(w, excitation=-w.excitation, response=-w.response),
}


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a measurement whose windows contradict themselves."""

    said: frozenset[str]
    outside: bool


def answer(windows: Sequence[Window], truth: float, calibration: Calibration) -> Answer:
    """Gate and judge the windows of a measurement."""
    refused = [check_window(window, SETTINGS, calibration) for window in windows]
    accepted = [window for window, refusal in zip(windows, refused, strict=True) if refusal is None]
    said = {str(refusal.reason) for refusal in refused if refusal is not None}
    if len(accepted) < 2:
        return Answer(frozenset(said), outside=False)
    outcome = judge_measurement(accepted, SETTINGS, calibration)
    if not isinstance(outcome.preload, PreloadEstimate):
        return Answer(frozenset({str(outcome.preload.reason)}), outside=False)
    said |= {str(doubt.reason) for doubt in outcome.preload.doubts}
    return Answer(frozenset(said), outside=not outcome.preload.interval.covers(truth))


#: Regimes of a healthy axis: how it is driven and recorded.
REGIMES: dict[str, Callable[[Acquisition], Acquisition]] = {
    "as calibrated": lambda usual: usual,
    "a third of the speed": lambda usual: replace(usual, program=replace(usual.program, speed=usual.program.speed / 3)),
    "a tenth of the speed": lambda usual: replace(
        usual, program=replace(usual.program, speed=usual.program.speed / 10)
    ),
    "short strokes": lambda usual: replace(usual, program=replace(usual.program, cruise=(5e-3, 15e-3))),
    "long strokes": lambda usual: replace(usual, program=replace(usual.program, cruise=(0.19, 0.23))),
    "noise × 5": lambda usual: replace(
        usual,
        surroundings=replace(usual.surroundings, coloured_noise=5 * usual.surroundings.coloured_noise, floor_force=5.0),
    ),
}


def healthy(machine: Machine, regime: str, seed: int, days: int) -> Iterator[Truth]:
    """Record healthy sessions."""
    acquisition = replace(REGIMES[regime](machine.acquisition), n_windows=8)
    there = replace(machine, acquisition=acquisition)
    for day in range(days):
        rng = np.random.default_rng([seed, list(REGIMES).index(regime), day])
        yield case_session(there, CASES["healthy"], rng, day=day)


def by_measurement(recorded: Iterable[Truth]) -> Iterator[Sequence[Window]]:
    """Yield the windows of each measurement."""
    for truth in recorded:
        yield from (truth.session.windows_of(name) for name in truth.session.measurements)


def doubted(windows: Sequence[Window], trace_polarity: int | None = None) -> list[str]:
    """Return what the windows are said to contradict themselves in, or to what their calibration saw of the trace."""
    reasons = [str(r.reason) for w in windows if (r := check_window(w, SETTINGS, None)) and "wraps" in r.reason]
    below = search_band(SETTINGS, None, windows[0])[0]
    return reasons + [str(doubt.reason) for doubt in cross_checked(windows, below, trace_polarity).doubts]


def spoilt(
    truth: Truth, calibration: Calibration, spoilt_by: Mapping[str, tuple[Spoil, str]]
) -> dict[str, list[Answer]]:
    """Judge every measurement of a session with each statement made wrong."""
    names = truth.session.measurements
    return {
        what: [
            answer([spoil(w) for w in truth.session.windows_of(name)], preload, calibration)
            for name, preload in zip(names, truth.preload, strict=True)
        ]
        for what, (spoil, _) in spoilt_by.items()
    }


def wired(recorded: Session, spoil: Spoil) -> Session:
    """Return a session as it is recorded of an axis that is wired otherwise."""
    return Session(recorded.axis_id, tuple(spoil(window) for window in recorded.windows))


def main(arguments: list[str]) -> None:
    """Print what is said of windows that are wrong, and how often healthy ones are doubted."""
    days, seed = (int(a) for a in (arguments + ["1", "5300"][len(arguments) :])[:2])
    answers: dict[str, list[Answer]] = {}
    sessions = {
        name: calibration_session(machine, np.random.default_rng([seed, 0])) for name, machine in MACHINES.items()
    }
    calibrations = {name: calibrate_session(session, SETTINGS) for name, session in sessions.items()}
    for name, machine in MACHINES.items():
        for day in range(days):
            truth = case_session(machine, CASES["healthy"], np.random.default_rng([seed, 1, day]), day=day)
            (long,) = healthy(machine, "long strokes", seed + 7 + day, 1)
            for recorded, by in ((truth, SPOILT), (long, WITHIN_STROKE)):
                for what, found in spoilt(recorded, calibrations[name], by).items():
                    answers.setdefault(what, []).extend(found)
    expected = {what: reason for what, (_, reason) in (SPOILT | WITHIN_STROKE).items()}
    for what, found in answers.items():
        silent = sum(a.outside and not a.said for a in found)
        said = Counter(reason for a in found for reason in a.said)
        named = sum(expected[what] in a.said for a in found)
        print(
            f"{what:28s}{len(found):4d} measured, {named} named, {silent} silent and outside; {dict(said)}", flush=True
        )
    for name, machine in MACHINES.items():
        for regime in REGIMES:
            measured = by_measurement(healthy(machine, regime, seed + 1, 4 * days))
            reasons = [doubted(windows, calibrations[name].trace_polarity) for windows in measured]
            print(f"{name}, {regime}: {_counted(reasons)}", flush=True)
        for wiring, spoil in WIRINGS.items():
            calibration = calibrate_session(wired(sessions[name], spoil), SETTINGS)
            measured = by_measurement(healthy(machine, "as calibrated", seed + 2, days))
            windows_of = [[spoil(window) for window in windows] for windows in measured]
            found = [judge_measurement(windows, SETTINGS, calibration) for windows in windows_of]
            known = sum(isinstance(outcome.friction, Friction) for outcome in found)
            print(
                f"{name}, wired {wiring} ({calibration.trace_polarity}): friction known in {known}, "
                f"{_counted([doubted(windows, calibration.trace_polarity) for windows in windows_of])}",
                flush=True,
            )


def _counted(reasons: Sequence[Sequence[str]]) -> str:
    of_each = Counter(reason for each in reasons for reason in each)
    return f"{sum(map(bool, reasons))} of {len(reasons)} doubted falsely {dict(of_each)}"


if __name__ == "__main__":
    main(sys.argv[1:])
