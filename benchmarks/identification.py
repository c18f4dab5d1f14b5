"""Joints of Tian's axis: from the published peaks, and from whole responses of a simulated axis.

``python -m benchmarks.identification`` prints what the paper claims beside what comes out, on one core in about six
minutes. The simulated axis is the finite-element one of the tests, an independent formulation.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.residuals.lines import ResidualForm, response_problem
from monitor_core.fitting.residuals.peaks import PeakProblem, Weighting, peak_problem
from monitor_core.fitting.solver.global_search import SearchSettings, search
from monitor_core.fitting.solver.least_squares import LocalFit, fit_local
from monitor_core.identification.identifiability import assess
from monitor_core.models.protocol import DriveConditions
from monitor_core.models.published.receptance.closed_form import position_terms, table_receptance
from tests.identification import simulated, tian

JOINTS = tian.free(tian.axis())
BOUNDS = JOINTS.bounds(tian.LIMITS)
TRUTH = JOINTS.start
HELD_OUT = ("l2", "l4", "l6")
#: Lines of the paper's windows [Hz] if a peak is read by a parabola through log|H|.
LINES = {1: 0.25, 2: 0.5, 3: 1.0, 4: 1.0}


def published(*names: str, weighting: Weighting = Weighting.UNCERTAINTY) -> PeakProblem:
    peaks = tian.as_labelled(tian.measured(*names))
    return peak_problem(JOINTS, peaks, bands=tian.BANDS, weighting=weighting, minimum_positions=1)


def held_out(coordinates: np.ndarray, trained: Sequence[str]) -> dict[int, float]:
    """Return the largest error of frequency [%] of each order at the positions that were not used."""
    problem = published(*(name for name in HELD_OUT if name not in trained))
    error = np.abs(problem.predict(coordinates).frequency / problem.frequency - 1.0) * 100.0
    return {mode: max(e for e, p in zip(error, problem.peaks, strict=True) if p.mode == mode) for mode in tian.BANDS}


def report(name: str, fit: LocalFit, trained: Sequence[str], seconds: float, agreement: float) -> None:
    errors, joints = held_out(fit.coordinates.values, trained), 10.0**fit.coordinates.values
    each = " ".join(f"{error:5.2f}" for error in errors.values())
    print(
        f"{name:26s} worst {max(errors.values()):5.2f} %  orders 1-4 {each} %  k_n {joints[2]:.3g}  "
        f"k_al+k_ar {joints[0] + joints[1]:.3g}  y {np.sqrt(fit.chi_squared):.4g}  {seconds:4.1f} s  "
        f"{agreement:.0%} of starts agree"
    )


def from_published_peaks() -> None:
    print("published l1, l3, l5 predict l2, l4, l6 (paper 2.95 %); single positions")
    began = time.process_time()
    all_three = ("l1", "l3", "l5")
    for name, trained, weighting in (
        ("three, weighted", all_three, Weighting.UNCERTAINTY),
        ("three, Eq. (26)", all_three, Weighting.UNIT),
        ("l1 alone", ("l1",), Weighting.UNCERTAINTY),
        ("l3 alone", ("l3",), Weighting.UNCERTAINTY),
        ("l5 alone", ("l5",), Weighting.UNCERTAINTY),
    ):
        start, problem = time.process_time(), published(*trained, weighting=weighting)
        found = search(problem, BOUNDS, 1)
        report(name, found.best, trained, time.process_time() - start, found.agreement())
        if name == "three, weighted":
            best = found.best
    print(f"all of it: {time.process_time() - began:.1f} s of one core")
    read_on_lines(best)
    start = time.process_time()
    judged = assess(published(*all_three), BOUNDS, best)
    for coordinate in judged.coordinates:
        factor = 10**coordinate.standard_uncertainty
        print(f"  {coordinate.name:22s} {10**coordinate.value:9.3g}  × or ÷ {factor:8.3g}  {coordinate.verdict.value}")
    for pair in judged.pairs:
        print(f"  not told apart: {pair.first} and {pair.second}, correlation {pair.correlation:.3f}")
    print("  unseen:", "; ".join(direction.describe() for direction in judged.unseen), end="")
    print(f"  ({time.process_time() - start:.1f} s)")


class ReadOnLines:
    """The weighted objective with peaks read by a parabola through log|H| on fixed lines."""

    def __init__(self, problem: PeakProblem) -> None:
        self.problem, self.names = problem, problem.names
        self.grids = []
        for peak in problem.peaks:
            band, step = tian.BANDS[peak.mode], LINES[peak.mode]
            frequency = np.arange(band.lower, band.upper + step / 2, step)
            terms = position_terms(JOINTS.stated, 2 * np.pi * frequency, peak.observation.conditions)
            self.grids.append((frequency, step, peak.observation.conditions, terms))

    def predict(self, coordinates: np.ndarray) -> np.ndarray:
        """Return frequency and height of each peak."""
        tops = []
        for frequency, step, conditions, terms in self.grids:
            level = np.log(np.abs(table_receptance(terms, JOINTS.record(coordinates).joints(conditions))))
            maxima = np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] >= level[2:])) + 1
            k = maxima[level[maxima].argmax()]
            below, top, above = level[k - 1 : k + 2]
            offset = 0.5 * (below - above) / (below - 2 * top + above)
            tops.append((frequency[k] + offset * step, np.exp(top - 0.25 * (below - above) * offset)))
        return np.array(tops).T

    def residuals(self, coordinates: np.ndarray) -> np.ndarray:
        """Return relative errors over their uncertainty."""
        frequency, amplitude = self.predict(coordinates)
        p = self.problem
        of_amplitude = (amplitude[p.with_amplitude] / p.amplitude - 1) * p.amplitude_weight
        return np.concatenate([(frequency / p.frequency - 1) * p.frequency_weight, of_amplitude])

    def jacobian(self, coordinates: np.ndarray) -> np.ndarray:
        """Return their derivatives by central differences."""
        step = 1e-5
        around = [
            (self.residuals(coordinates + h) - self.residuals(coordinates - h)) / (2 * step) for h in step * np.eye(8)
        ]
        return np.array(around).T


def read_on_lines(best: LocalFit) -> None:
    """Show what reading peaks by a parabola through log|H| on lines of 0.25 to 1 Hz does to the same fit."""
    read = ReadOnLines(published("l1", "l3", "l5"))
    fit = fit_local(read, BOUNDS, best.coordinates.values)
    held = ReadOnLines(published(*HELD_OUT))
    error = np.abs(held.predict(fit.coordinates.values)[0] / held.problem.frequency - 1) * 100
    worst = held.problem.peaks[int(error.argmax())]
    print(
        f"peaks read on lines of 0.25 to 1 Hz: worst {error.max():.2f} % (order {worst.mode} at "
        f"{worst.observation.conditions.position} m), y {np.sqrt(fit.chi_squared):.4g}"
    )


def from_whole_responses(runs: int = 200, starts: int = 100) -> None:
    print(f"\nsimulated axis (finite elements), 3 positions × {simulated.FREQUENCY.size} lines, noise 5 % of |H|")
    exact = simulated.receptances(tian.axis())
    rng = np.random.default_rng(7)
    inside, errors, started = np.zeros(8), [], time.process_time()
    for _ in range(runs):
        fit = fit_local(response_problem(JOINTS, simulated.noisy(exact, rng)), wide(4.0), TRUTH)
        error = fit.coordinates.values - TRUTH
        inside += np.abs(error) <= 1.96 * fit.coordinates.standard_uncertainties
        errors.append(error * np.log(10) * 100)
    per_fit = (time.process_time() - started) / runs
    whole = rms(errors)
    print(
        f"{runs} runs: 95 % intervals cover {np.round(inside / runs * 100, 1)} %, all {inside.mean() / runs:.1%}; "
        f"{per_fit:.3f} s each"
    )
    print(
        f"rms error of the joints {np.round(whole, 3)} %; largest of k_n {np.max(np.abs(np.array(errors)[:, 2])):.3f} %"
    )
    peaks = rms([peak_error(simulated.noisy(exact, rng)) for _ in range(40)])
    print(
        f"four peaks per position of the same kind of data, 40 runs: {np.round(peaks, 3)} %; "
        f"ratio of k_n {peaks[2] / whole[2]:.0f}"
    )
    agreement_of_starts(simulated.noisy(exact, rng), starts, rng)


def rms(errors: Sequence[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.square(errors), axis=0))


def peak_error(observations: tuple) -> np.ndarray:
    """Return the error of the joints [%] from peaks read off noisy responses, with the truth's help to find them."""
    modes = published("l1", "l3", "l5").predict(TRUTH).frequency.reshape(3, 4)
    peaks = []
    for observation, frequencies in zip(observations, modes, strict=True):
        for mode, near in enumerate(frequencies, start=1):
            frequency, amplitude = simulated.picked_peak(observation, near)
            conditions = DriveConditions(observation.conditions.position)
            peak = ModalObservation(conditions, frequency, 0.002 * frequency, amplitude, 0.05 * amplitude)
            peaks.append(AssignedPeak(peak, mode))
    fit = fit_local(peak_problem(JOINTS, peaks, bands=tian.BANDS), wide(4.0), TRUTH)
    return (fit.coordinates.values - TRUTH) * np.log(10) * 100


def wide(decades: float) -> Bounds:
    """Return bounds so many decades wide around the truth for stiffness, and twice that for damping."""
    half = np.r_[np.full(4, decades / 2), np.full(4, decades)]
    return Bounds(TRUTH - half, TRUTH + half)


def agreement_of_starts(observations: tuple, starts: int, rng: np.random.Generator) -> None:
    problem = response_problem(JOINTS, observations)
    best = fit_local(problem, wide(4.0), TRUTH)
    for name, bounds in (
        ("2 decades of stiffness, 4 of damping", wide(2.0)),
        ("limits of the published case", BOUNDS),
    ):
        for form in ResidualForm:
            began, searched = time.process_time(), replace(problem, form=form)
            reached = sum(
                same_optimum(problem, searched, bounds, rng.uniform(bounds.lower, bounds.upper), best)
                for _ in range(starts)
            )
            seconds = (time.process_time() - began) / starts
            print(f"random starts over {name}, {form.value}: {reached / starts:.0%} of {starts}, {seconds:.2f} s each")
    logarithmic = replace(problem, form=ResidualForm.LOGARITHMIC)
    found = search(logarithmic, wide(2.0), 1, SearchSettings(n_starts=30))
    print(f"search's own starts agree: {found.agreement():.0%} of 30")


def same_optimum(problem: object, searched: object, bounds: Bounds, start: np.ndarray, best: LocalFit) -> bool:
    first = fit_local(searched, bounds, start)
    final = fit_local(problem, bounds, first.coordinates.values)
    distance = np.abs(final.coordinates.values - best.coordinates.values)
    return bool(np.all(distance < 0.1 * best.coordinates.standard_uncertainties))


def speed() -> None:
    of_peaks = published("l1", "l3", "l5")
    of_responses = response_problem(
        JOINTS, simulated.noisy({x: np.ones(850) for x in simulated.MESHES}, np.random.default_rng(0))
    )
    for name, problem in (("peaks", of_peaks), ("responses", of_responses)):
        print(
            f"{name}: {per_second(lambda problem=problem: problem.residuals(TRUTH)):.0f} objectives/s, "
            f"{per_second(lambda problem=problem: problem.jacobian(TRUTH)):.0f} Jacobians/s"
        )


def per_second(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    for _ in range(300):
        function()
    return 300 / (time.perf_counter() - start)


def main() -> None:
    """Print the tables."""
    speed()
    from_published_peaks()
    from_whole_responses()


if __name__ == "__main__":
    main()
