"""What the blind benchmark draws: every effect in three sizes, pairs, healthy machines, strangers, wrong records."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tests.hidden_effects import cases
from tests.hidden_effects.machines import BENCH, MACHINES, jittered, machine_named
from tests.hidden_effects.situations import FAULTS, SCATTERS, Situation, WrongRecord
from tests.hidden_effects.truth import finite_elements, transmission_line

Value = TypeVar("Value")
PLANTS = {"finite elements": finite_elements.respond, "transmission line": transmission_line.respond}
NOISES = (0.003, 0.01)
OUTSIDE = "outside:"
#: What no motion in time has, and what no line has.
ON_LINES = ("constant-loss-factor",)
IN_STEPS = ("outside:backlash", "outside:contact-loss")
#: Not linear: solved in steps, without a loop, whose share of the torque is not known line by line.
NOT_LINEAR = (*IN_STEPS, "guide-friction", "cubic-stiffness", "outside:nut-softening")
_N_HEALTHY = 110
_N_OUTSIDE = 3  # of each kind and size
_DESIGNS = ("rich", "usual", "usual", "rich", "poor")
#: Of ten cases.
_SCATTERS = ("assumed",) * 4 + ("smaller", "smaller", "larger", "larger", "uniform", "heavy")
_DISTURBANCES = ("clean",) * 6 + ("pink", "hum", "clipped", "loop")
#: Beside a wrong record; one that only temperature shows beside a wrong temperature.
_BESIDE = ("far-bearing-stiffness", "added-mass", "loss-factor", "series-compliance", "guide-stiffness", "torque-delay",
           "screw-axial-stiffness")  # fmt: skip
_OF_TEMPERATURE = "thermal-stiffness"


@dataclass(frozen=True, slots=True)
class Job:
    """One case to be drawn."""

    number: int
    kind: str
    size: str
    noise: float
    family: str
    plant: str
    machine: str = BENCH.name
    design: str = "rich"
    scatter: str = "assumed"
    disturbance: str = "clean"
    fault: str = ""
    fault_size: int = 1

    @property
    def name(self) -> str:
        """How its files are called."""
        return f"case-{self.number:04d}"

    @property
    def healthy(self) -> bool:
        """Whether nothing is hidden and no record is wrong."""
        return self.kind == cases.NONE and not self.fault and self.family == "receptance"

    @property
    def outside(self) -> bool:
        """Whether what is hidden is not in the catalogue."""
        return self.kind.startswith(OUTSIDE)


def composition(seed: int = 0) -> list[Job]:
    """Return all cases of a draw; which machine, design and errors a case has is drawn, each as often as it should."""
    kinds = cases.all_kinds()
    pairs = [kind for kind in kinds if "+" in kind]
    outside = [kind for kind in kinds if kind.startswith(OUTSIDE)]
    singles = [kind for kind in kinds if kind not in pairs and kind not in outside and kind != cases.NONE]
    wanted = [(kind, size, "", 1) for kind in singles for size in (*cases.SIZES, "large")]
    wanted += [(kind, size, "", 1) for kind in outside for size in cases.SIZES for _ in range(_N_OUTSIDE)]
    wanted += [(kind, size, "", 1) for kind in pairs for size in ("large", "medium") for _ in range(2)]
    wanted += [(cases.NONE, "medium", "", 1)] * _N_HEALTHY
    alone = [fault for fault in FAULTS if fault != "temperature-tag"]  # nothing follows temperature there
    wanted += [(cases.NONE, "medium", fault, size) for fault in alone for size in range(3)]
    beside = [(fault, size) for fault in FAULTS for size in range(3) for _ in range(2)]
    wanted += [
        (_OF_TEMPERATURE if fault == "temperature-tag" else _BESIDE[number % len(_BESIDE)], "large", fault, size)
        for number, (fault, size) in enumerate(beside)
    ]
    rng = np.random.default_rng(seed)
    machines, designs, scatters, disturbances, noises, plants = (
        _spread(values, len(wanted), rng)
        for values in ([m.name for m in MACHINES], _DESIGNS, _SCATTERS, _DISTURBANCES, NOISES, list(PLANTS))
    )
    jobs = []
    for number, (kind, size, fault, fault_size) in enumerate(wanted):
        plant, design, disturbance = plants[number], designs[number], disturbances[number]
        if kind in ON_LINES:
            plant = "transmission line"
        elif any(part in NOT_LINEAR for part in kind.split("+")):
            plant, disturbance = "finite elements", "clean" if disturbance == "loop" else disturbance
        if fault:
            design, disturbance = "usual" if design == "poor" else design, "clean"
        scatter = "assumed" if fault else scatters[number]
        under = machines[number], design, scatter, disturbance
        jobs.append(Job(number, kind, size, noises[number], "receptance", plant, *under, fault, fault_size))
    crude = [Job(len(jobs) + k, "none", "medium", NOISES[0], "lumped", "finite elements") for k in range(3)]
    return jobs + crude


def drawn(job: Job, seed: int) -> cases.Case:
    """Draw a case: its machine about that of its size, what is hidden, and what is measured of it."""
    own = seed + job.number
    if job.family == "lumped":
        return cases.draw_case(job.kind, job.size, job.noise, own, job.family, respond=PLANTS[job.plant])
    situation = Situation(
        machine=jittered(machine_named(job.machine), np.random.default_rng([own, 1])),
        design=job.design,
        scatter=SCATTERS[job.scatter],
        disturbance=job.disturbance,
        wrong=WrongRecord(job.fault, job.fault_size) if job.fault else None,
    )
    return cases.draw_case(
        job.kind, job.size, job.noise, own, job.family, respond=PLANTS[job.plant], situation=situation
    )


def _spread(values: Sequence[Value], n: int, rng: np.random.Generator) -> list[Value]:
    """Return n values in random order, each as often as in the list."""
    return [values[index] for index in rng.permutation(n) % len(values)]
