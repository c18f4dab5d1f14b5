"""Sessions from drive models: physics of the moves and of friction, and what the product's own road finds in them."""

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy import linalg

from monitor_core.errors import OutsideValidityError
from monitor_core.models.generator import MOTOR_END, SimulationSettings, condition_grid, simulate_session
from monitor_core.models.generator.moves import RampMoves, Reference, draw_reference
from monitor_core.models.generator.scan import GuideFriction, advance_modes
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, NormalModes, ResponsePoint
from monitor_core.pipeline import AxisSettings, check_window, judge_measurement
from monitor_core.recording import ExcitationSource
from monitor_core.recordings import write_session
from monitor_core.response import FrequencyResponse

START = datetime(2025, 3, 1, tzinfo=UTC)
TRANSMISSION = 0.006 / (2.0 * np.pi)


@dataclass(frozen=True)
class TwoMasses:
    """A turning screw, a table, one damped spring between: solved by hand below. With a motor: one spring more."""

    screw_inertia: float = 1.2e-4
    motor_inertia: float = 1.6e-4
    table_mass: float = 20.0
    stiffness: float = 2.5e7
    damping: float = 600.0

    def springs(self, conditions):
        """Return the stiffnesses; the axial one softens with the distance, as a screw does."""
        return self.stiffness * (1.0 - 0.2 * conditions.position), 850.0

    def normal_modes(self, conditions, motor_end=None):
        axial, coupling = self.springs(conditions)
        mass = np.diag([self.motor_inertia, self.screw_inertia, self.table_mass + conditions.payload_mass])
        twist, stretch = np.array([1.0, -1.0, 0.0]), np.array([0.0, -TRANSMISSION, 1.0])
        stiffness = coupling * np.outer(twist, twist) + axial * np.outer(stretch, stretch)
        dashpots = 0.015 * np.outer(twist, twist) + self.damping * np.outer(stretch, stretch)
        if motor_end is MotorEnd.PRESCRIBED:
            mass, stiffness, dashpots = (
                matrix[1:, 1:] for matrix in (mass, axial * np.outer(stretch, stretch), dashpots)
            )
            dashpots = self.damping * np.outer(stretch, stretch)[1:, 1:]
        squares, shapes = linalg.eigh(stiffness, mass)
        omega = np.sqrt(np.append(0.0, squares[1:]))
        damping = np.zeros_like(omega)
        damping[1:] = np.einsum("im,ij,jm->m", shapes, dashpots, shapes)[1:] / (2.0 * omega[1:])
        return NormalModes(omega / (2.0 * np.pi), damping, shapes[0], shapes[-1])

    def frequency_response(self, frequency, conditions, *, excitation, response):
        """Return what its modes say where the torque is the motor's, its own damping included where it is not."""
        assert response is ResponsePoint.ACCELERATION_AT_TABLE
        if excitation is ExcitationPoint.TORQUE_AT_SCREW:
            return FrequencyResponse(frequency, self.torque_accelerance(frequency, conditions), "torque_accelerance")
        modes, omega = self.normal_modes(conditions, MotorEnd.FREE), 2.0 * np.pi * frequency
        own = 2.0 * np.pi * modes.frequency[:, None]
        of_modes = (modes.angle_at_motor * modes.displacement_at_table)[:, None] / (
            own**2 - omega**2 + 2j * modes.damping_ratio[:, None] * own * omega
        )
        return FrequencyResponse(frequency, -(omega**2) * np.sum(of_modes, axis=0), "torque_accelerance")

    def torque_accelerance(self, frequency, conditions):
        """Solve the two equations of motion under a torque on the screw: exact, with the damping where it is."""
        s = 2j * np.pi * frequency
        link = self.springs(conditions)[0] + s * self.damping
        mass = self.table_mass + conditions.payload_mass
        return (
            TRANSMISSION
            * link
            / (link * (1.0 + TRANSMISSION**2 * mass / self.screw_inertia) + mass * s**2)
            / (self.screw_inertia)
        )


MODEL = TwoMasses()
QUIET = SimulationSettings(torque_noise=0.0, acceleration_noise=0.0, encoder_resolution=0.0)
POSITIONS = (0.2, 0.5, 0.8)


def simulated(settings, conditions=None, *, model=MODEL, seed=1):
    conditions = condition_grid(POSITIONS) if conditions is None else conditions
    return simulate_session(
        model, conditions, settings, axis_id="axis", started_at=START, rng=np.random.default_rng(seed)
    )


# --- linear ----------------------------------------------------------------------------------------------------------


def test_the_record_has_the_frequency_response_of_the_model():
    """The windows begin and end at rest, so the ratio of their transforms is the response, line by line."""
    settings = replace(QUIET, window_duration=4.0, windows_per_measurement=6)
    condition = DriveConditions(0.5, payload_mass=3.0)
    natural = MODEL.normal_modes(condition, MotorEnd.PRESCRIBED).frequency[1]
    spectra = [(np.fft.rfft(w.excitation), np.fft.rfft(w.response)) for w in simulated(settings, (condition,)).windows]
    frequency = np.fft.rfftfreq(settings.n_samples, 1.0 / settings.sample_rate)
    near = (frequency > 5.0) & (frequency < 2.0 * natural)
    excitation, response = (np.array([pair[i][near] for pair in spectra]) for i in range(2))
    measured = np.sum(response * excitation.conj(), axis=0) / np.sum(np.abs(excitation) ** 2, axis=0)
    expected = MODEL.torque_accelerance(frequency[near], condition)
    # normal modes alone have no damping in the link between screw and table: a share ζ of the response
    assert np.abs(measured / expected - 1.0).max() < 1e-3


@pytest.mark.parametrize("source", MOTOR_END)
def test_the_products_road_finds_the_modes_without_friction(source):
    settings = replace(SimulationSettings(), excitation_source=source)
    for frequency, truth in found_and_true(settings):
        assert abs(frequency.value - truth) < 3.0 * frequency.standard_uncertainty
        assert frequency.standard_uncertainty < 0.05


def found_and_true(settings, model=MODEL, *, band=(120.0, 260.0)):
    session, axis = simulated(settings, model=model), AxisSettings(search_band=band)
    for name, position in zip(session.measurements, POSITIONS, strict=True):
        windows = session.windows_of(name)
        assert all(check_window(w, axis, None) is None for w in windows)
        modal = judge_measurement(windows, axis, None).modal
        end = MOTOR_END[settings.excitation_source]
        yield modal.mode.frequency, model.normal_modes(DriveConditions(position), end).frequency[1]


def test_the_table_moves_as_commanded_and_ends_where_it_began():
    time = np.arange(4097) / 4096.0
    reference = draw_reference(RampMoves(), time, 1.0, np.random.default_rng(3), 50)
    assert np.abs(reference.travel[-1]).max() < 1e-15
    assert np.abs(reference.speed[-1]).max() < 1e-15
    # speed and acceleration are the derivatives of the travel (Simpson's rule is exact to the fourth order)
    for value, rate in ((reference.travel, reference.speed), (reference.speed, reference.acceleration)):
        rise = (rate[:-2:2] + 4.0 * rate[1:-1:2] + rate[2::2]) / (6.0 * 2048.0)
        assert np.abs(np.diff(value[::2], axis=0) - rise).max() < 2e-3 * np.abs(rate).max() / 2048.0
    reached = np.ptp(reference.travel, axis=0)
    assert reached.min() > 0.06 * 33e-3
    assert reached.max() < 0.06 * 64.5e-3
    for window in simulated(replace(QUIET, friction=GuideFriction(5.0, 20.0))).windows:
        assert window.position_span == pytest.approx(np.ptp(window.position_trace))
        assert abs(window.position_trace[-1] - window.position_trace[0]) < 5e-6
        assert 0.06 * 33e-3 * 0.99 < window.position_span < 0.06 * 64.5e-3 * 1.01
        centre = 0.5 * (window.position_trace.max() + window.position_trace.min())
        assert centre == pytest.approx(window.conditions.position, abs=5e-5)


def test_no_null_of_the_mean_excitation_sits_in_the_band():
    """Fixed moves have nulls at the multiples of 1/duration; drawn ones fill them."""

    def spread(settings):
        spectra = [np.abs(np.fft.rfft(w.excitation)) ** 2 for w in simulated(settings).windows]
        power = np.mean(spectra, axis=0)[60:350]
        return power.min() / np.median(power)

    settings = replace(QUIET, windows_per_measurement=40)
    fixed = replace(settings, moves=RampMoves(ramp=(6e-3, 6e-3), cruise=(30e-3, 30e-3)))
    assert spread(fixed) < 1e-3
    assert spread(settings) > 0.02


# --- friction --------------------------------------------------------------------------------------------------------


def motion_with(friction):
    time = np.arange(4097) / 4096.0
    reference = draw_reference(RampMoves(), time, 1.0, np.random.default_rng(5), 20)
    stacked = Reference(*(getattr(reference, name)[:, None, :] for name in Reference.__slots__))
    modes = MODEL.normal_modes(DriveConditions(0.5), MotorEnd.PRESCRIBED)
    return advance_modes([modes], stacked, friction, 1.0 / 4096.0), reference


@pytest.mark.parametrize(
    "friction", [GuideFriction(5.0), GuideFriction(20.0, presliding=0.0), GuideFriction(0.0, 50.0)]
)
def test_friction_takes_the_energy_it_should(friction):
    motion, reference = motion_with(friction)
    work = np.sum(motion.friction_force * motion.table_speed, axis=0)[0] / 4096.0
    path = np.sum(np.abs(motion.table_speed), axis=0)[0] / 4096.0
    if friction.viscous:
        assert -work == pytest.approx(friction.viscous * np.sum(motion.table_speed[:, 0] ** 2, axis=0) / 4096.0)
    else:
        # each way the slider travels at least as far as the table less the spring's range; never farther than the table
        slid = 2.0 * (np.ptp(reference.travel, axis=0) - 2.0 * friction.presliding - 20e-6)
        assert np.all(-work > friction.coulomb * slid)
        assert np.all(-work < friction.coulomb * path)


def test_a_rigid_grip_only_takes_energy_and_stops_the_table_for_good():
    motion, _ = motion_with(GuideFriction(30.0, presliding=0.0))
    assert (motion.friction_force * motion.table_speed).max() < 1e-12  # rounding of a speed of zero
    assert np.abs(motion.friction_force).max() <= 30.0 * (1.0 + 1e-9)
    at_rest = motion.table_speed[-400:]
    assert np.abs(at_rest).max() < 1e-12
    assert np.abs(motion.friction_force[-400:]).max() < 30.0
    free, _ = motion_with(GuideFriction())
    assert np.abs(free.table_speed[-400:]).max() > 1e-6


def test_a_spring_of_the_guides_holds_the_table_at_rest():
    motion, _ = motion_with(GuideFriction(30.0, presliding=25e-6))
    travel = np.cumsum(motion.table_speed, axis=0) / 4096.0
    assert np.ptp(travel[-200:], axis=0).max() < 2e-6
    assert np.abs(motion.friction_force[-200:]).max() < 30.0


@pytest.mark.parametrize("friction", [GuideFriction(100.0, 0.0, 1e-3), GuideFriction(20.0), GuideFriction(0.0, 5000.0)])
def test_the_acceleration_sample_was_free_to_take_the_friction_half_a_step_late(friction):
    """Of a rigid mass the second difference of the travel has no delay; slow ramps keep its own error small."""
    time, step = np.arange(4097) / 4096.0, 1.0 / 4096.0
    reference = draw_reference(RampMoves(ramp=(40e-3, 60e-3)), time, 1.0, np.random.default_rng(5), 6)
    stacked = Reference(*(getattr(reference, name)[:, None, :] for name in Reference.__slots__))
    displacement = 0.15
    rigid = NormalModes(np.zeros(1), np.zeros(1), np.array([150.0]), np.array([displacement]))
    motion = advance_modes([rigid], stacked, friction, step)
    deviation = motion.acceleration[1:-1] - np.diff(motion.travel, n=2, axis=0) / step**2
    jump = displacement**2 * np.diff(motion.friction_force, axis=0)[:-1]
    # with the force of one side only, half of each of its jumps would be in the deviation
    assert abs(np.sum(deviation * jump)) < 0.02 * np.sum(jump**2)


@pytest.mark.parametrize("presliding", [0.0, 1e-9, 25e-6])
def test_a_step_of_friction_solves_its_equations(presliding):
    rng, step = np.random.default_rng(2), 1e-4
    friction = GuideFriction(12.0, 40.0, presliding)
    gain = rng.uniform(2e-6, 8e-6, 2000)
    free = rng.normal(0.0, 1e-4 + presliding / step, 2000)  # some stick, some slide
    before = rng.uniform(-presliding, presliding, 2000)
    speed, force, after = friction.step(free, gain, before, step)
    assert speed == pytest.approx(free + gain * force, abs=1e-15)
    grip = -(force + friction.viscous * speed)
    stuck = np.abs(grip) < 12.0 * (1.0 - 1e-9)
    assert 200 < stuck.sum() < 1800
    assert np.abs(grip).max() <= 12.0 * (1.0 + 1e-9)
    assert after[stuck] == pytest.approx((before + step * speed)[stuck], abs=1e-15)
    assert np.all(grip[~stuck] * speed[~stuck] > 0.0)
    if presliding == 0.0:
        assert np.abs(speed[stuck]).max() < 1e-15


@pytest.mark.release
@pytest.mark.parametrize(
    ("source", "coulomb"),
    [(ExcitationSource.SENSOR, 5.0), (ExcitationSource.SENSOR, 20.0), (ExcitationSource.DRIVE, 5.0)],
)
def test_friction_raises_the_frequency_by_less_than_its_spring_could(source, coulomb):
    """Sliding leaves the mode alone; held by the spring all the time it would rise by f φ² k / 2ω²."""
    settings = replace(SimulationSettings(), excitation_source=source, friction=GuideFriction(coulomb))
    shifts = []
    for (frequency, truth), position in zip(found_and_true(settings), POSITIONS, strict=True):
        modes = MODEL.normal_modes(DriveConditions(position), MOTOR_END[source])
        spring = coulomb / settings.friction.presliding
        held = truth * modes.displacement_at_table[1] ** 2 * spring / (2.0 * (2.0 * np.pi * truth) ** 2)
        shifts.append(frequency.value - truth)
        assert -3.0 * frequency.standard_uncertainty < shifts[-1] < held + 3.0 * frequency.standard_uncertainty
    assert min(shifts) > 0.0


def test_viscous_friction_damps_the_mode():
    plain, viscous = (
        judge_measurement(
            simulated(replace(SimulationSettings(), friction=f)).windows[:15], AxisSettings((120, 260)), None
        )
        for f in (GuideFriction(), GuideFriction(0.0, 200.0))
    )
    modes = MODEL.normal_modes(DriveConditions(POSITIONS[0]), MotorEnd.PRESCRIBED)
    added = 200.0 * modes.displacement_at_table[1] ** 2 / (4.0 * np.pi * modes.frequency[1])
    rise = viscous.modal.mode.damping_ratio.value - plain.modal.mode.damping_ratio.value
    assert rise == pytest.approx(added, rel=0.05)  # backward Euler takes a little more than a dashpot


# --- what is recorded ------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        write_session(tmp_path / name, simulated(SimulationSettings(), seed=seed))
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c


def test_a_measurement_does_not_depend_on_the_others():
    few, many = (simulated(SimulationSettings(), condition_grid(p)) for p in ((0.2, 0.5), (0.2, 0.5, 0.8)))
    for window, other in zip(few.windows, many.windows, strict=False):
        assert np.array_equal(window.excitation, other.excitation)
        assert np.array_equal(window.response, other.response)


def test_noise_and_resolution_are_as_stated():
    settings = replace(SimulationSettings(), torque_noise=0.01, acceleration_noise=0.2, encoder_resolution=1e-6)
    quiet = simulated(replace(settings, torque_noise=0.0, acceleration_noise=0.0, encoder_resolution=0.0))
    noisy = simulated(settings)
    for name, expected in (("excitation", 0.01), ("response", 0.2)):
        difference = np.concatenate(
            [getattr(n, name) - getattr(q, name) for n, q in zip(noisy.windows, quiet.windows, strict=True)]
        )
        assert difference.std() == pytest.approx(expected, rel=0.01)
        assert abs(difference.mean()) < 4.0 * expected / np.sqrt(difference.size)
    counts = noisy.windows[0].position_trace / 1e-6
    assert np.abs(counts - np.round(counts)).max() < 1e-6


def test_windows_say_what_was_simulated():
    conditions = condition_grid((0.2, 0.5), (100.0, 200.0), (0.0, 10.0), (0.0, 4.0))
    assert len(conditions) == 16
    session = simulated(replace(SimulationSettings(), windows_per_measurement=2), conditions)
    assert len(session.measurements) == 16
    for name, condition in zip(session.measurements, conditions, strict=True):
        for window in session.windows_of(name):
            stated = window.conditions
            assert (stated.position, stated.preload, stated.payload_mass) == (
                condition.position, condition.preload, condition.payload_mass,
            )  # fmt: skip
            assert stated.temperature == 20.0 + condition.temperature_deviation
            assert (window.n_samples, window.sample_rate) == (4096, 4096.0)
    starts = [window.started_at for window in session.windows]
    assert starts == sorted(starts)
    assert starts[0] == START
    assert len(set(starts)) == 32


# --- refusals --------------------------------------------------------------------------------------------------------


def test_bad_settings_are_refused(subtests):
    for make, sentence in [
        (lambda: SimulationSettings(windows_per_measurement=0), "windows_per_measurement must be at least 1; got 0"),
        (lambda: SimulationSettings(window_duration=0.0), "window_duration must be positive; got 0.0 s"),
        (lambda: SimulationSettings(sample_rate=float("nan")), "sample_rate must be positive; got nan Hz"),
        (lambda: SimulationSettings(sample_rate=1000.0), "needs a sample_rate of at least 1333.33 Hz; got 1000 Hz"),
        (lambda: SimulationSettings(torque_noise=-1.0), "torque_noise must not be negative; got -1.0 N·m"),
        (lambda: RampMoves(speed=0.0), "speed must be positive; got 0.0 m/s"),
        (lambda: RampMoves(ramp=(4e-3, 3e-3)), "ramp must rise from above 0 s; got 0.004 to 0.003 s"),
        (lambda: GuideFriction(-5.0), "coulomb of the guides must not be negative; got -5.0 N"),
        (lambda: SimulationSettings(window_duration=1e12), "16,777,216 samples; 15 x 1e+12 s at 4096 Hz are 6.14e+16"),
        (lambda: SimulationSettings(window_duration=1e300, sample_rate=1e300), "must not exceed 16,777,216 samples"),
        (lambda: simulated(replace(QUIET, torque_noise=1e300)), "samples of the torque must fit into single precision"),
        (lambda: simulated(replace(QUIET, acceleration_noise=1e308)), "samples of the acceleration must fit"),
        (lambda: simulated(replace(QUIET, window_duration=0.2)), "of which a window of 0.2 s has 0.04 s to spare"),
    ]:
        with subtests.test(sentence), pytest.raises(OutsideValidityError, match=re.escape(sentence)):
            make()


@pytest.mark.parametrize("per_newton", [GuideFriction(1.0), GuideFriction(0.0, 1.0 / RampMoves().speed)])
def test_friction_that_the_ramps_cannot_overcome_threw_the_table_about(per_newton):
    """By hand: a raised cosine of 4.5 ms to 0.06 m/s peaks at twice its mean, against table and turning screw."""
    mass = MODEL.table_mass + MODEL.screw_inertia / TRANSMISSION**2
    strongest = 2.0 * mass * 0.06 / 4.5e-3

    def settings(share):
        force = share * strongest
        return replace(QUIET, friction=GuideFriction(force * per_newton.coulomb, force * per_newton.viscous))

    for window in simulated(settings(0.99)).windows:
        assert window.position_span < 2.0 * 0.06 * 64.5e-3  # it follows, if badly
    with pytest.raises(OutsideValidityError, match=f"must not exceed the {strongest:.4g} N"):
        simulated(settings(1.01))


@dataclass(frozen=True)
class FixedModes:
    frequency: tuple[float, ...]

    def normal_modes(self, conditions, motor_end=None):
        ones = np.ones(len(self.frequency))
        return NormalModes(np.array(self.frequency), 0.01 * ones, ones, ones)


def test_a_drive_that_cannot_move_is_refused():
    with pytest.raises(OutsideValidityError, match="no rigid-body mode"):
        simulated(QUIET, model=FixedModes((150.0, 300.0)))


def test_a_mode_above_half_the_sampling_rate_is_refused():
    with pytest.raises(OutsideValidityError, match="above twice the first natural frequency, 3000 Hz; got 4096 Hz"):
        simulated(QUIET, model=FixedModes((0.0, 3000.0)))
