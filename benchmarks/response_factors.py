"""Joints from responses whose gain and phase are off at every condition: how often the 95 % intervals cover.

``python -m benchmarks.response_factors`` draws 40 machines of two axes (seeds 1 to 40), measures each with a factor of
2 % and 1.2° (standard deviations) on every response beside the noise of its lines, identifies the joints as
``preload identify`` does, with a search of fewer starts, and prints the coverage; once as the product has it, and once
with the factors taken for exact. On one core in about a quarter of an hour.

Neither plant shares a formula with the model that is fitted: *hammer* is Tian's axis in finite elements
(`tests/models/finite_elements`), struck at the table at three positions; *torque* an axis of wave lines
(`tests/hidden_effects/truth`), driven by its motor, acceleration of the table and angle of the motor at three positions
under two preloads, without the loss of its steel, which no description holds.
"""

import time
from collections.abc import Sequence

import numpy as np

from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.response_factors import EXACT, FactorTolerance
from monitor_core.fitting.solver.global_search import SearchSettings
from monitor_core.identification.cases import ResponseCase
from monitor_core.identification.joint_fit import JointFit, JointFitSettings, fit_joints
from tests.identification import driven, tian
from tests.identification.simulated import factored
from tests.identification.test_identify import finite_element_responses

SEEDS = range(1, 41)
NOISE = 0.02  # of each line, rms over |H|
#: Standard deviations of ln of the true joints about what the model states.
SPREAD, SPREAD_OF_DAMPERS = 0.25, 0.4
SEARCH = SearchSettings(64, 3)

Machine = tuple[FreeParameters, tuple[FrequencyResponseObservation, ...], np.ndarray]

HAMMER = tian.free(tian.axis())


def hammer(seed: int) -> Machine:
    """Draw Tian's axis with other joints and strike it."""
    rng = np.random.default_rng(seed)
    truth = HAMMER.start + drawn(HAMMER, rng)
    measured = finite_element_responses(HAMMER.record(truth), (0.6, 1.0, 1.6), rng, NOISE)
    return HAMMER, factored(measured, rng), truth


def torque(seed: int) -> Machine:
    """Draw an axis of wave lines and drive it."""
    rng = np.random.default_rng(seed)
    change = drawn(driven.STATED, rng)
    return driven.STATED, driven.machine(rng, change, NOISE), driven.STATED.start + change


def drawn(drive: FreeParameters, rng: np.random.Generator) -> np.ndarray:
    """Draw by how many decades the joints are off."""
    spread = [SPREAD_OF_DAMPERS if "damping" in name else SPREAD for name in drive.free]
    return np.array(spread) * rng.standard_normal(len(spread)) / np.log(10.0)


def identified(machine: Machine, factors: FactorTolerance) -> tuple[JointFit, np.ndarray, np.ndarray]:
    """Return the joints, by how much each is off [%] and whether its interval covers."""
    drive, measured, truth = machine
    case, bounds = ResponseCase(drive, measured, factors=factors), drive.bounds()
    found = fit_joints(case, bounds, JointFitSettings(search=SEARCH))
    covers = [each.interval.covers(true) for each, true in zip(found.judged.coordinates, truth, strict=True)]
    return found, 100.0 * np.log(10.0) * (found.fit.coordinates.values - truth), np.array(covers)


def report(name: str, machines: Sequence[Machine], factors: FactorTolerance) -> None:
    """Print coverage and errors of all machines of a plant."""
    began = time.process_time()
    answers = [identified(machine, factors) for machine in machines]
    names = answers[0][0].fit.names
    error, covers = np.array([each[1] for each in answers]), np.array([each[2] for each in answers])
    springs = np.array(["stiffness" in each for each in names])
    lacking = sum(found.lack_of_fit for found, _, _ in answers)
    each = ", ".join(
        f"{joint.split('_stiffness')[0]} {covers[:, k].mean():.1%} (rms {np.sqrt(np.mean(error[:, k] ** 2)):.2f} %)"
        for k, joint in enumerate(names)
        if springs[k]
    )
    print(
        f"{name}: of stiffnesses {covers[:, springs].mean():.1%} of {covers[:, springs].size} intervals cover, of "
        f"dampings {covers[:, ~springs].mean():.1%}; lack of fit in {lacking} of {len(answers)}; {each}; "
        f"{(time.process_time() - began) / len(answers):.1f} s each",
        flush=True,
    )


def main() -> None:
    """Print the table."""
    for plant in (hammer, torque):
        machines = [plant(seed) for seed in SEEDS]
        report(f"{plant.__name__}, factors known to 5 % and 0.05 rad", machines, FactorTolerance())
        report(f"{plant.__name__}, factors taken for exact", machines, EXACT)


if __name__ == "__main__":
    main()
