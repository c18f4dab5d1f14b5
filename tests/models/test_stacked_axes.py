"""Two stacked axes, coupled through the table between them, against finite elements and the laws of such a stack."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse

from monitor_core.effects.catalogue import OF_STACK
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.identification import IdentifyOptions, identify
from monitor_core.models.extended import ExtendedModel, SecondAxis, physics_of
from monitor_core.models.extended.modes import with_damping
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.receptance import ReceptanceParameters
from monitor_core.recordings.model_file import read_model_file
from tests.conftest import PROJECT_ROOT
from tests.models.finite_elements import Assembly
from tests.models.test_receptance import axis_of

CROSS_TABLE = read_model_file(PROJECT_ROOT / "replay_data" / "models" / "cross-table.toml")
LOWER = ReceptanceParameters.from_file_names(CROSS_TABLE.parameters, "receptance")
_STATED = CROSS_TABLE.effects["carried-axis"]
UPPER = ReceptanceParameters.from_file_names(
    {name: value for name, value in _STATED.items() if name not in OF_STACK}, "receptance"
)
CROSSED = {OF_STACK[name]: value for name, value in _STATED.items() if name in OF_STACK and name != "position_m"}
SKEW = {**CROSSED, "direction_cosine": 0.6}
PARALLEL = {"direction_cosine": 1.0}
STACKS = {"parallel": PARALLEL, "crossed": CROSSED, "skew": SKEW}
FREQUENCY = np.linspace(12.0, 900.0, 75)
FORCE = {"excitation": ExcitationPoint.FORCE_AT_TABLE, "response": ResponsePoint.DISPLACEMENT_AT_TABLE}


def lower_model(**stack):
    """Return the lower axis, carrying the upper one at a position."""
    stack = {"position": 0.3, **stack}
    second = SecondAxis(physics=physics_of(UPPER), carried=True, **stack)
    return ExtendedModel(LOWER, replace(physics_of(LOWER), second=second))


def upper_model(**stack):
    """Return the upper axis, standing on the lower one at a position."""
    stack = {"position": 1.0, **stack}
    second = SecondAxis(physics=physics_of(LOWER), carried=False, **stack)
    return ExtendedModel(UPPER, replace(physics_of(UPPER), second=second))


class Stack:
    """Both axes in finite elements on one table that slides and yaws."""

    def __init__(self, x, y, n=200, payload=0.0, **stack):
        stack = {
            "yaw_stiffness": np.inf, "yaw_damping": 0.0, "yaw_inertia": 0.0, "lower_offset": 0.0, "upper_offset": 0.0,
            "upper_centre": 0.0, **stack,
        }  # fmt: skip
        c, e, a = stack["direction_cosine"], -stack["lower_offset"], -stack["upper_offset"]
        parts = []
        for axis, at in ((LOWER, x), (UPPER, y)):
            near = max(10, round(n * at / axis.screw_length))
            own = axis_of(axis, MotorEnd.FREE)
            standing = own if axis is LOWER else replace(own, near_bearing=(0.0, 0.0), far_bearing=(0.0, 0.0))
            parts.append((Assembly(replace(standing, table_mass=1e-9), near, n - near, at), near, n))
        (lower, _, _), (upper, near, _) = parts
        self.lower, self.yaw, self.upper = lower.table, lower.size, lower.size + 1 + upper.table
        first = lower.size + 1  # of the upper one
        size = first + upper.size

        def both(name):
            return scipy.sparse.block_diag(
                [getattr(lower, name), scipy.sparse.csr_matrix((1, 1)), getattr(upper, name)], format="lil"
            )

        self.mass, self.damping, self.stiffness = both("mass"), both("damping"), both("screw") + both("springs")
        self.stiffness = self.stiffness.tolil()

        def rank_one(matrix, vector, factor):
            for i, j in itertools.product(vector, vector):
                matrix[i, j] += factor * vector[i] * vector[j]

        # travel of the table's centre is that of the nut less what yaw adds there
        travel = {self.lower: 1.0, self.yaw: -e}
        base = {self.lower: c, self.yaw: a - c * e}
        for node, (stiffness, damping) in (
            (0, axis_of(UPPER, MotorEnd.FREE).near_bearing), (n, axis_of(UPPER, MotorEnd.FREE).far_bearing),
        ):  # fmt: skip
            deflection = {first + node: 1.0, **{point: -factor for point, factor in base.items()}}
            rank_one(self.stiffness, deflection, stiffness)
            rank_one(self.damping, deflection, damping)
        rank_one(self.mass, travel, LOWER.table_mass)
        self.mass[self.upper, self.upper] += UPPER.table_mass + payload
        # what slides on the table is carried across its own direction
        sine, area = np.sqrt(1.0 - c * c), np.pi * UPPER.screw_diameter**2 / 4.0
        lengths = np.r_[np.full(near, y / near), np.full(n - near, (UPPER.screw_length - y) / (n - near))]
        middles = np.cumsum(lengths) - lengths / 2.0
        bodies = [(y, UPPER.table_mass + payload + UPPER.screw_nut_segment_mass)]
        for middle, length in zip(middles, lengths, strict=True):  # two points have the moments of a uniform piece
            bodies += [
                (middle + side * length / np.sqrt(12.0), UPPER.density * area * length / 2.0) for side in (-1.0, 1.0)
            ]
        for at, mass in bodies:
            across = {self.lower: -sine, self.yaw: sine * e + at - stack["upper_centre"]}
            rank_one(self.mass, across, mass)
        self.mass[self.yaw, self.yaw] += stack["yaw_inertia"]
        self.damping[self.yaw, self.yaw] += stack["yaw_damping"]
        self.free = np.arange(size)
        if np.isinf(stack["yaw_stiffness"]):
            self.free = np.delete(self.free, self.yaw)
        else:
            self.stiffness[self.yaw, self.yaw] += stack["yaw_stiffness"]

    def _matrices(self):
        chosen = np.ix_(self.free, self.free)
        return [scipy.sparse.csc_matrix(m)[chosen] for m in (self.mass, self.damping, self.stiffness)]

    def receptances(self, frequency):
        """Return displacements of (lower nut line, upper table) per force at each, shape (n, 2, 2)."""
        mass, damping, stiffness = self._matrices()
        points = [int(np.flatnonzero(self.free == point)[0]) for point in (self.lower, self.upper)]
        load = np.zeros((self.free.size, 2))
        load[points, [0, 1]] = 1.0
        found = []
        for omega in 2.0 * np.pi * frequency:
            dynamic = scipy.sparse.csc_matrix(stiffness + 1j * omega * damping - omega**2 * mass)
            found.append(scipy.sparse.linalg.splu(dynamic).solve(load.astype(complex))[points])
        return np.array(found)

    def frequencies(self, highest):
        mass, _, stiffness = self._matrices()
        used = np.flatnonzero(mass.diagonal() > 0.0)
        square = scipy.linalg.eigh(
            stiffness.toarray()[np.ix_(used, used)], mass.toarray()[np.ix_(used, used)], eigvals_only=True,
            subset_by_index=(0, 24),
        )  # fmt: skip
        frequency = np.sqrt(np.maximum(square, 0.0)) / (2.0 * np.pi)
        return frequency[(frequency > 1.0) & (frequency < highest)]


def extrapolated(x, y, **stack):
    """Return receptances of elements of no length: the error falls with its square."""
    coarse, fine = (Stack(x, y, n, **stack).receptances(FREQUENCY) for n in (180, 360))
    return fine + (fine - coarse) / 3.0


@pytest.mark.release
@pytest.mark.parametrize("name", STACKS)
def test_receptances_of_both_tables_are_those_of_finite_elements(name):
    stack, x, y = STACKS[name], 1.0, 0.3
    expected = extrapolated(x, y, **stack)
    lower, upper = lower_model(position=y, **stack), upper_model(position=x, **stack)
    own = lower.frequency_response(FREQUENCY, DriveConditions(x), **FORCE).response
    its = upper.frequency_response(FREQUENCY, DriveConditions(y), **FORCE).response
    cross = lower.second_table_per_force(FREQUENCY, DriveConditions(x))
    for found, (i, j) in ((own, (0, 0)), (its, (1, 1)), (cross, (1, 0)), (cross, (0, 1))):
        assert np.max(np.abs(found / expected[:, i, j] - 1.0)) < 1e-5


def test_receptances_are_near_those_of_few_elements():
    found = lower_model(position=0.3, **SKEW).second_table_per_force(FREQUENCY[:20], DriveConditions(1.0))
    expected = Stack(1.0, 0.3, 60, **SKEW).receptances(FREQUENCY[:20])
    np.testing.assert_allclose(found, expected[:, 1, 0], rtol=3e-3)


#: What hangs on the upper axis, or yields in it, too small to be felt, with a frequency of its own among the lines.
SLIGHT = {
    **{
        f"{place}_absorber": {
            f"{place}_absorber_{size}": 1e-12 if size == "inertia" else 1e-9,
            f"{place}_absorber_frequency": 100.0,
            f"{place}_absorber_damping_ratio": 0.02,
        }
        for place, size in (("table", "mass"), ("nut", "mass"), ("screw_end", "mass"), ("rotor", "inertia"))
    },
    "base": {"base_compliance": 1e-20, "base_frequency": 100.0, "base_damping_ratio": 0.02},
    "bending": {"compliance": 1e-20, "frequency": 100.0, "damping_ratio": 0.02},
}


@pytest.mark.parametrize("name", SLIGHT)
def test_what_is_too_slight_to_be_felt_leaves_the_receptance_between_both_tables(name):
    lower = lower_model(**SKEW)
    second, record = lower.physics.second, "bending" if name == "bending" else "added"
    upper = replace(second.physics, **{record: replace(getattr(second.physics, record), **SLIGHT[name])})
    slightly = ExtendedModel(LOWER, replace(lower.physics, second=replace(second, physics=upper)))
    without, with_it = (model.second_table_per_force(FREQUENCY, DriveConditions(1.0)) for model in (lower, slightly))
    np.testing.assert_allclose(with_it, without, rtol=1e-7)


def elastic(model, position, payload=0.0):
    modes = model.natural_frequencies(DriveConditions(position, payload_mass=payload))
    return np.array([m.frequency for m in modes if m.frequency > 1.0])


@pytest.mark.parametrize(("name", "payload"), [*((name, 0.0) for name in STACKS), ("crossed", 50.0)])
def test_both_views_have_the_modes_of_the_stack(name, payload):
    """Counted from the lower axis or from the upper one: all of both, none twice, those of the finite elements.

    A workpiece is on the upper table in both.
    """
    stack, x, y = STACKS[name], 1.0, 0.3
    undamped = [
        ExtendedModel(model.parameters, with_damping(model.physics, 0.0))
        for model in (lower_model(position=y, **stack), upper_model(position=x, **stack))
    ]
    from_lower, from_upper = elastic(undamped[0], x, payload), elastic(undamped[1], y, payload)
    np.testing.assert_allclose(from_lower, from_upper, rtol=1e-9)
    np.testing.assert_allclose(from_lower, Stack(x, y, 90, payload, **stack).frequencies(2000.0), rtol=2e-3)


def test_modes_of_each_axis_go_with_the_position_of_the_other():
    # the mode of the lower axis near 110 Hz, and that of the upper one near 160 Hz; both hardly damped
    of_lower = [elastic(lower_model(position=y, **CROSSED), 0.6)[1] for y in (0.1, 0.7)]
    of_upper = [elastic(upper_model(position=x, **CROSSED), 0.1)[2] for x in (0.6, 1.6)]
    expected = [Stack(0.6, y, 90, **CROSSED).frequencies(400.0) for y in (0.1, 0.7)]
    assert np.diff(of_lower)[0] == pytest.approx(expected[1][1] - expected[0][1], rel=0.02)
    assert np.diff(of_lower)[0] > 1.5
    there = Stack(1.6, 0.1, 90, **CROSSED).frequencies(400.0)
    assert np.diff(of_upper)[0] == pytest.approx(there[2] - expected[0][2], rel=0.02)
    assert -0.1 < np.diff(of_upper)[0] < -0.05  # at 160 Hz a heavy table on its soft drive is nearly a free mass
    assert abs(elastic(ExtendedModel.of(UPPER), 0.1)[0] / of_upper[0] - 1.0) > 0.1  # which is felt, though
    # at right angles on guides that do not yield each is as if the other were a dead weight, or not there
    alone = {"direction_cosine": 0.0}
    dead = replace(LOWER, table_mass=LOWER.table_mass + sliding_mass())
    for p in (0.1, 0.7):
        np.testing.assert_allclose(elastic(lower_model(position=p, **alone), 1.0), elastic(ExtendedModel.of(dead), 1.0))
    np.testing.assert_allclose(elastic(upper_model(**alone), 0.3), elastic(ExtendedModel.of(UPPER), 0.3))


def sliding_mass():
    screw = UPPER.density * np.pi * UPPER.screw_diameter**2 / 4.0 * UPPER.screw_length
    return UPPER.table_mass + UPPER.screw_nut_segment_mass + screw


def test_slow_pushes_move_everything_by_newtons_law():
    # both rotors free and parallel: the upper table hangs on its screw's free turning, the lower one carries the rest
    omega = 2.0 * np.pi * np.array([0.01])
    rigid = replace(UPPER, motor_inertia=1e6)  # a rotor that does not turn
    second = SecondAxis(physics=physics_of(rigid), carried=True, position=0.3, **PARALLEL)
    held = replace(LOWER, coupling_stiffness=1e-6, coupling_damping=0.0, motor_inertia=1e-6)
    model = ExtendedModel(held, replace(physics_of(held), second=second))
    found = model.frequency_response(omega / (2.0 * np.pi), DriveConditions(1.0), **FORCE).response
    ratio = LOWER.screw_lead / (2.0 * np.pi)
    polar = np.pi * LOWER.screw_diameter**4 / 32.0
    turning = LOWER.density * polar * LOWER.screw_length + 2e-4
    mass = LOWER.table_mass + sliding_mass() + turning / ratio**2
    np.testing.assert_allclose(found, -1.0 / (omega**2 * mass), rtol=2e-3)


def test_what_no_stack_can_be_is_refused():
    with pytest.raises(OutsideValidityError, match="direction_cosine must lie within 0 and 1"):
        lower_model(direction_cosine=1.2)
    with pytest.raises(OutsideValidityError, match="yaw_inertia must be positive"):
        lower_model(yaw_stiffness=1e7)
    with pytest.raises(OutsideValidityError, match=r"within 0 and 0.9 m; got 1.0 m"):
        lower_model(position=1.0)
    on_guides = physics_of(replace(UPPER, table_damping=100.0))
    with pytest.raises(OutsideValidityError, match="an axis that stands on another one must have no table damping"):
        replace(physics_of(LOWER), second=SecondAxis(physics=on_guides, carried=True, position=0.3))
    with pytest.raises(OutsideValidityError, match="normal modes cannot include a second axis"):
        lower_model(**PARALLEL).normal_modes(DriveConditions(1.0))
    with pytest.raises(OutsideValidityError, match="this one has none"):
        upper_model(**PARALLEL).second_table_per_force(FREQUENCY, DriveConditions(0.3))


def test_the_file_states_both_axes():
    model = CROSS_TABLE.build()
    assert model.physics == lower_model(**CROSSED).physics
    turned = {"position_m": 1.0, **{name: _STATED[name] for name in OF_STACK if name != "position_m"}}
    upper = AxisDescription(
        "receptance", UPPER.to_file_names(), effects={"carrying-axis": {**turned, **LOWER.to_file_names()}}
    )
    assert upper.build().physics == upper_model(**CROSSED).physics
    for wrong, sentence in (
        ({"position_m": None}, "expected one second axis, with its position_m"),
        ({"table_mass_kg": None}, "a receptance model needs table_mass_kg"),
        ({"angle_rad": 1.0}, "a receptance model has no parameter angle_rad"),
    ):
        values = {name: value for name, value in {**_STATED, **wrong}.items() if value is not None}
        with pytest.raises(OutsideValidityError, match=f"the effect carried-axis: {sentence}"):
            replace(CROSS_TABLE, effects={"carried-axis": values}).build()


@pytest.mark.release
def test_joints_are_found_with_the_second_axis_present():
    """Responses of the finite elements: with the upper axis stated the joints come back, without it they do not."""
    places, rng = (0.6, 1.0, 1.6), np.random.default_rng(5)
    lines = np.unique(np.concatenate([np.geomspace(15.0, 900.0, 120)]))
    measured = []
    for x in places:
        true = Stack(x, 0.3, 240, **CROSSED).receptances(lines)[:, 0, 0]
        noise = 0.02 * np.abs(true)
        scatter = (rng.standard_normal(lines.size) + 1j * rng.standard_normal(lines.size)) * noise
        measured.append(
            FrequencyResponseObservation(
                DriveConditions(x), lines, true + scatter, noise, ExcitationPoint.FORCE_AT_TABLE,
                ResponsePoint.DISPLACEMENT_AT_TABLE,
            )
        )  # fmt: skip
    stated = {"bearing_stiffness_n_per_m": 0.3, "nut_stiffness_n_per_m": 0.3}
    off = {**CROSS_TABLE.parameters, "bearing_stiffness_n_per_m": 5.5e7, "nut_stiffness_n_per_m": 5.5e8}
    with_upper = replace(CROSS_TABLE, parameters=off, uncertain=stated)
    weight = {**off, "table_mass_kg": off["table_mass_kg"] + sliding_mass()}
    without = replace(with_upper, parameters=weight, effects={})
    found, missed = (identify(axis, measured, IdentifyOptions(hold_out=(1.0,))) for axis in (with_upper, without))
    assert not found.quality.lack_of_fit
    assert missed.quality.lack_of_fit
    for name in stated:
        joint = found.joints[name]
        assert abs(joint.estimate.value - CROSS_TABLE.parameters[name]) < 3.5 * joint.estimate.standard_uncertainty
        assert joint.estimate.value == pytest.approx(CROSS_TABLE.parameters[name], rel=0.02)
    assert found.model.effects == CROSS_TABLE.effects
