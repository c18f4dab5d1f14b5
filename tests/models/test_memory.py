"""What the extended drive remembers on its lines: the same numbers to the last bit, computed less often."""

import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest

from monitor_core.models.extended import AxisPhysics, PreparedLines, ResponseCase, physics_of, prepare_lines, responses
from monitor_core.models.extended.memory import Memory
from monitor_core.models.families import build_model
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.recordings.model_file import read_model_file
from tests.conftest import PROJECT_ROOT
from tests.models.extended_axes import add


@dataclass(frozen=True)
class _Inner:
    a: float
    b: float


@dataclass(frozen=True)
class _Outer:
    inner: _Inner
    values: np.ndarray

    def method(self) -> float:
        return self.inner.a


def _lines(level: float = 0.0) -> PreparedLines:
    frequency = np.linspace(50.0, 900.0, 40)
    return prepare_lines(
        [
            ResponseCase(frequency, DriveConditions(position, 200.0, excitation_level=level), excitation, point, end)
            for position in (0.2, 0.5, 0.8)
            for excitation, point, end in (
                (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE, MotorEnd.FREE),
                (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_NUT, MotorEnd.FREE),
            )
        ]
    )


def _physics() -> AxisPhysics:
    file = read_model_file(PROJECT_ROOT / "replay_data" / "models" / "replay-axis.toml")
    return physics_of(build_model(file.family, file.parameters).parameters)


def _moved(physics: AxisPhysics, rng: np.random.Generator) -> AxisPhysics:
    """Return the axis with one quantity of one record moved."""
    record, name = [
        ("joints", "nut_stiffness"), ("joints", "bearing_stiffness"), ("joints", "coupling_stiffness"),
        ("joints", "loss_factor"), ("joints", "causal_loss_factor"), ("bodies", "table_mass"),
        ("bodies", "rotor_inertia"), ("screw", "axial_rigidity"), ("screw", "torsional_rigidity"),
        ("added", "position_offset"), ("added", "base_compliance"), ("added", "servo_stiffness"),
        ("added", "series_compliance"), ("added", "guide_stiffness"), ("added", "second_mode_residue"),
    ][rng.integers(15)]  # fmt: skip
    part = getattr(physics, record)
    scale = {"position_offset": 1e-3, "base_compliance": 1e-9, "servo_stiffness": 10.0, "series_compliance": 1e-9,
             "guide_stiffness": 1e6, "second_mode_residue": 0.0, "causal_loss_factor": 0.01}.get(name)  # fmt: skip
    value = scale * rng.uniform() if scale is not None else getattr(part, name) * rng.uniform(0.9, 1.1)
    return replace(physics, **{record: replace(part, **{name: value})})


def test_what_is_remembered_is_the_same_to_the_last_bit() -> None:
    rng, lines, physics = np.random.default_rng(1), _lines(), _physics()
    for _ in range(200):
        trial = physics if rng.uniform() < 0.2 else _moved(physics, rng)
        physics = trial if rng.uniform() < 0.2 else physics
        np.testing.assert_array_equal(responses(trial, lines), responses(trial, _lines()))


def test_only_what_was_read_counts() -> None:
    asked = []

    def function(outer: _Outer, factor: float) -> float:
        asked.append(factor)
        return factor * outer.inner.a + float(outer.values.sum())

    memory, outer = Memory(10), _Outer(_Inner(1.0, 2.0), np.ones(3))
    first = memory.recall(function, outer, 2.0)
    assert memory.recall(function, _Outer(_Inner(1.0, 7.0), np.ones(3)), 2.0) == first == 5.0
    assert len(asked) == 1
    assert memory.recall(function, _Outer(_Inner(3.0, 2.0), np.ones(3)), 2.0) == 9.0
    assert memory.recall(function, _Outer(_Inner(1.0, 2.0), np.zeros(3)), 2.0) == 2.0
    assert memory.recall(function, outer, 3.0) == 6.0
    assert len(asked) == 4


def test_a_method_that_hides_what_it_reads_is_refused() -> None:
    with pytest.raises(TypeError, match=r"method\(\) reads of a record"):
        Memory(10).recall(lambda outer: outer.method(), _Outer(_Inner(1.0, 2.0), np.ones(3)))


@pytest.mark.parametrize("friction", [0.0, 0.05])
def test_lines_go_to_another_process_without_what_is_remembered(friction) -> None:
    lines, physics = _lines(level=1.0), add(_physics(), guide_friction=friction)
    before = len(pickle.dumps(lines))
    there = responses(physics, lines)
    assert len(pickle.dumps(lines)) == before
    np.testing.assert_array_equal(responses(physics, pickle.loads(pickle.dumps(lines))), there)  # noqa: S301 our own


def test_long_sessions_keep_few_answers() -> None:
    memory = Memory(400_000)
    for value in range(20):
        memory.recall(lambda x: np.full(2, x), float(value))
    kept = {function: len(known) for function, known in memory._known.items()}
    assert max(kept.values()) <= 2
