"""What happens to an axis in the months after its calibration: machines, calibration sessions, and cases by letter.

A case is a way in which the axis, its surroundings or its tags differ from the calibration. What is true and what is
tagged are drawn apart; nothing here knows what the product makes of it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from monitor_core.recording import Conditions, Session
from tests.plant.chain import Axis, Condition, natural_frequency
from tests.plant.friction import Friction
from tests.plant.measurements import CALIBRATION_SCATTER, Acquisition, Scatter, simulate_measurements, to_windows
from tests.plant.motion import MoveProgram, Ripple, Servo
from tests.plant.simulation import Plant
from tests.plant.surroundings import SecondMode, Surroundings

#: Of a shop: cogging, an encoder that counts, a floor that shakes, and noise that is not white.
_SERVO = Servo(encoder_step=2.0 * np.pi / 2**20)
_SURROUNDINGS = Surroundings(coloured_noise=0.03, floor_force=0.5)
START = datetime(2026, 1, 5, 6, 0, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Machine:
    """An axis with what it was calibrated at."""

    name: str
    plant: Plant
    acquisition: Acquisition
    preloads: tuple[float, ...]  # set at the calibration [N]
    healthy: float  # preload at work [N]
    payloads: tuple[float, ...]  # of the calibration, with the empty table [kg]
    torque_rms: float  # of the moves [N·m]
    travel: tuple[float, float] = (0.15, 0.85)  # shares of the screw

    def positions(self, count: int) -> list[float]:
        """Return places evenly over the travel, rounded as an operator states them [m]."""
        low, high = self.travel
        return [round(float(x), 3) for x in np.linspace(low, high, count) * self.plant.axis.screw_length]

    def mode(self, position: float) -> float:
        """Return the axial natural frequency at the healthy preload [Hz]."""
        return float(natural_frequency(position, self.healthy, axis=self.plant.axis))


#: An axis of a machining centre: its mode lies at 207 to 218 Hz, of which a doubled preload is 3.1 to 3.6 Hz.
MEDIUM = Machine(
    "medium",
    Plant(
        Axis(
            table_mass=38.0,
            screw_mass=3.4,
            screw_inertia=2.2e-4,
            screw_length=1.1,
            screw_minor_diameter=0.0224,
            screw_diameter=0.025,
            lead=0.010,
            bearing_stiffness=70e6,
            far_bearing_stiffness=40e6,
            bracket_stiffness=230e6,
            coupling_stiffness=1200.0,
            motor_inertia=3e-4,
        ),
        Friction(guide_force=40.0, guide_presliding=65e-6, bearing_torque=0.01),
        _SERVO,
        Ripple(0.01),
    ),
    Acquisition(surroundings=_SURROUNDINGS),
    preloads=(100.0, 200.0, 300.0, 400.0),
    healthy=300.0,
    payloads=(8.0, 12.0),
    torque_rms=0.52,
)
#: A large axis: three times the mass, twice the lead; its mode lies at 182 to 194 Hz, a doubled preload is 4 to 5 Hz.
HEAVY = Machine(
    "heavy",
    Plant(
        Axis(
            table_mass=120.0,
            nut_mass=5.0,
            screw_mass=14.4,
            screw_inertia=2.33e-3,
            screw_length=1.8,
            screw_minor_diameter=0.036,
            screw_diameter=0.040,
            lead=0.020,
            nut_rigidity=900e6,
            rated_preload=2500.0,
            bearing_stiffness=250e6,
            far_bearing_stiffness=160e6,
            bracket_stiffness=500e6,
            coupling_stiffness=8000.0,
            coupling_damping=0.1,
            coupling_inertia=6e-4,
            motor_inertia=3.5e-3,
            joint_loss_factor=0.05,
        ),
        Friction(guide_force=60.0, bearing_torque=0.08),
        replace(_SERVO, torque_limit=50.0),
        Ripple(0.05),
    ),
    Acquisition(
        surroundings=replace(_SURROUNDINGS, torque_span=64.0, torque_noise=0.02, floor_force=1.5),
        program=MoveProgram(speed=0.08),
    ),
    preloads=(500.0, 1000.0, 1500.0, 2000.0),
    healthy=1500.0,
    payloads=(25.0, 40.0),
    torque_rms=4.7,
)
MACHINES = {machine.name: machine for machine in (MEDIUM, HEAVY)}


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A session with what was true behind its tags."""

    session: Session
    preload: tuple[float, ...]  # of each measurement, in the order of the session [N]
    conditions: tuple[Condition, ...] = ()  # those that were true, of each measurement


def recorded_session(
    machine: Machine,
    tagged: Sequence[Condition],
    true: Sequence[Condition],
    rng: np.random.Generator,
    *,
    acquisition: Acquisition | None = None,
    plant: Plant | None = None,
    scatter: Scatter = CALIBRATION_SCATTER,
    preload_known: bool = False,
    payload_stated: bool = True,
    started_at: datetime = START,
) -> Truth:
    """Simulate measurements ten minutes apart and return them with the true preloads."""
    acquisition = acquisition or machine.acquisition
    recorded = simulate_measurements(tagged, rng, acquisition, scatter=scatter, plant=plant or machine.plant, true=true)
    begin = [started_at + timedelta(minutes=10 * i) for i in range(len(tagged))]
    windows = to_windows(recorded, tagged, begin, acquisition, preload_known=preload_known)
    if not payload_stated:
        windows = tuple(replace(w, conditions=_without_payload(w.conditions)) for w in windows)
    return Truth(Session(machine.name, windows), tuple(condition.preload for condition in true), tuple(true))


def _without_payload(conditions: Conditions) -> Conditions:
    return replace(conditions, payload_mass=None)


def calibration_session(machine: Machine, rng: np.random.Generator) -> Session:
    """Record 35 settings: six places by four preloads, two payloads at three places, five temperatures."""
    places = machine.positions(6)
    tagged = [Condition(x, p, temperature=22.0) for p in machine.preloads for x in places]
    tagged += [Condition(x, machine.healthy, m, 22.0) for m in machine.payloads for x in places[1:6:2]]
    tagged += [
        Condition(x, machine.healthy, temperature=t)
        for x, t in zip(places[:5], (16.0, 19.0, 26.0, 30.0, 34.0), strict=True)
    ]
    return recorded_session(machine, tagged, tagged, rng, preload_known=True).session


#: From the conditions as tagged to those that are true.
Truly = Callable[[Machine, Condition, np.random.Generator], Condition]


def _as_tagged(machine: Machine, tagged: Condition, rng: np.random.Generator) -> Condition:
    del machine, rng
    return tagged


@dataclass(frozen=True, slots=True)
class Case:
    """One way in which a measurement differs from the calibration."""

    key: str
    title: str
    truly: Truly = _as_tagged
    payload: Callable[[Machine], float] = field(default=lambda machine: 0.0)  # as tagged [kg]
    temperature: float = 22.0  # as tagged [°C]
    payload_stated: bool = True
    acquisition: Callable[[Machine, Acquisition], Acquisition] = field(default=lambda machine, usual: usual)
    plant: Callable[[Plant], Plant] = field(default=lambda plant: plant)
    blind: bool = False  # one mode cannot tell: up to 20 % may be silent and outside


def _with(**changes: float) -> Truly:
    return lambda machine, tagged, rng: replace(tagged, **changes)


def _friction_of_the_day(machine: Machine, tagged: Condition, rng: np.random.Generator) -> Condition:
    return replace(tagged, friction_scale=float(np.exp(0.3 * rng.standard_normal())))


def _far_end(machine: Machine, tagged: Condition, rng: np.random.Generator) -> Condition:
    return replace(tagged, position=machine.plant.axis.screw_length - tagged.position)


def _second_mode(machine: Machine, usual: Acquisition) -> Acquisition:
    """Place a mode 8 Hz above the axial one at mid-travel, of 0.4 of its residue."""
    axis = machine.plant.axis
    carried = axis.table_mass + axis.nut_mass
    # of a mass that moves freely the torque makes 2π/(l·m); the inertia of the screw takes half of that
    residue = -0.4 * 0.5 * 2.0 * np.pi / axis.lead / carried
    mode = SecondMode(machine.mode(machine.positions(3)[1]) + 8.0, 0.012, residue)
    return replace(usual, surroundings=replace(usual.surroundings, second_mode=mode))


def _torque_noise(share: float) -> Callable[[Machine, Acquisition], Acquisition]:
    """Add white noise to the torque channel, as a share of the rms torque of the moves."""
    return lambda machine, usual: replace(
        usual, surroundings=replace(usual.surroundings, torque_noise=share * machine.torque_rms)
    )


def _slower(machine: Machine, usual: Acquisition) -> Acquisition:
    return replace(usual, program=replace(usual.program, speed=0.5 * usual.program.speed))


def _light_damping(plant: Plant) -> Plant:
    return replace(plant, axis=replace(plant.axis, joint_loss_factor=0.006, screw_loss_factor=0.002))


def _payload(index: int) -> Callable[[Machine], float]:
    return lambda machine: machine.payloads[index]


def _heavier(share: float) -> Truly:
    return lambda machine, tagged, rng: replace(tagged, payload=tagged.payload * share)


def _heavier_by(share: float) -> Truly:
    """Put a share of the table's mass on it."""
    return lambda machine, tagged, rng: replace(tagged, payload=share * machine.plant.axis.table_mass)


CASES = {
    case.key: case
    for case in (
        Case("healthy", "as calibrated"),
        Case("A", "a second mode 8 Hz above", acquisition=_second_mode),
        Case("B05", "noise on the torque, 5 %", acquisition=_torque_noise(0.05)),
        Case("B12", "noise on the torque, 12 %", acquisition=_torque_noise(0.12)),
        Case("B20", "noise on the torque, 20 %", acquisition=_torque_noise(0.2)),
        Case("C03", "guide friction × 0.3", _with(guide_friction_scale=0.3)),
        Case("C25", "guide friction × 2.5", _with(guide_friction_scale=2.5)),
        Case("C50", "guide friction × 5", _with(guide_friction_scale=5.0)),
        Case("D", "friction varies by 30 % from day to day", _friction_of_the_day),
        Case("E-", "mounting of the nut − 2 %", _with(bracket_scale=0.98), blind=True),
        Case("E+", "mounting of the nut + 5 %", _with(bracket_scale=1.05), blind=True),
        Case("F", "payload a fifth above the stated one", _heavier(1.2), payload=_payload(0)),
        Case("G", "thermometer + 10 K, structure + 3 K", _with(temperature=25.0), temperature=32.0),
        Case("H", "moves at half speed", acquisition=_slower),
        Case(
            "I10",
            "position tags 10 mm too small",
            lambda machine, tagged, rng: replace(tagged, position=tagged.position + 0.010),
            blind=True,
        ),
        Case("I", "position counted from the far end", _far_end),
        Case("J", "light damping", plant=_light_damping),
        Case("K01", "payload of 2 % of the table not stated", _heavier_by(1.0 / 50.0), payload_stated=False),
        Case("K10", "payload of 20 % of the table not stated", _heavier_by(0.2), payload_stated=False),
        Case("L", "twice the largest calibrated payload, stated", payload=lambda machine: 2.0 * machine.payloads[1]),
    )
}


def case_session(machine: Machine, case: Case, rng: np.random.Generator, *, day: int) -> Truth:
    """Record one day of a case: one measurement at each of five places."""
    tagged = [Condition(x, machine.healthy, case.payload(machine), case.temperature) for x in machine.positions(5)]
    # what a day brings is one draw for all places of the day
    of_the_day = rng.integers(2**32)
    true = [case.truly(machine, condition, np.random.default_rng(of_the_day)) for condition in tagged]
    return recorded_session(
        machine,
        tagged,
        true,
        rng,
        acquisition=case.acquisition(machine, machine.acquisition),
        plant=case.plant(machine.plant),
        payload_stated=case.payload_stated,
        started_at=START + timedelta(days=30 + day),
    )


#: Ways in which a healthy axis is measured within what its calibration has seen: any doubt about it is false.
REGIMES = {
    "shop": "a year in the shop, everything stated",
    "payload": "payloads inside the calibrated range",
    "places": "other places than the calibrated ones",
    "speed": "half speed, which the calibration has seen",
    "temperature": "cold and warm",
    "friction": "another friction, as days differ",
}


def regime_calibration(machine: Machine, regime: str, rng: np.random.Generator) -> Session:
    """Record the calibration that a regime lies within: for another speed, a second session at that speed."""
    session = calibration_session(machine, rng)
    if regime != "speed":
        return session
    slower = calibration_session(replace(machine, acquisition=_slower(machine, machine.acquisition)), rng)
    renamed = tuple(replace(w, measurement=f"{w.measurement}-slow") for w in slower.windows)
    return Session(machine.name, session.windows + renamed)


def regime_sessions(machine: Machine, regime: str, rng: np.random.Generator, days: int) -> Iterator[Truth]:
    """Record a session a day of a healthy axis, five places each."""
    if regime == "shop":
        yield from shop_year(machine, rng, measured=sorted(rng.choice(365, days, replace=False).tolist()))
        return
    acquisition = _slower(machine, machine.acquisition) if regime == "speed" else machine.acquisition
    low, high = machine.positions(2)
    for day in range(days):
        places = rng.uniform(low, high, 5).round(3) if regime == "places" else machine.positions(5)
        payload = float(rng.uniform(0.0, max(machine.payloads))) if regime == "payload" else 0.0
        temperature = float(rng.uniform(16.0, 34.0)) if regime == "temperature" else 22.0
        friction = float(np.exp(0.15 * rng.standard_normal())) if regime == "friction" else 1.0
        tagged = [Condition(float(x), machine.healthy, payload, temperature) for x in places]
        true = [replace(condition, friction_scale=friction) for condition in tagged]
        started_at = START + timedelta(days=30 + day)
        yield recorded_session(machine, tagged, true, rng, acquisition=acquisition, started_at=started_at)


@dataclass(frozen=True, slots=True)
class ShopYear:
    """What a healthy axis lives through in a year; nothing of it is a loss of preload."""

    friction: float = 0.15  # from day to day, first-order autoregression, relative standard deviation [-]
    persistence: float = 0.9  # of the friction from one day to the next [-]
    between_lubrications: float = 0.25  # rise of the friction until the next lubrication [-]
    lubrication_interval: int = 60  # [days]
    season: float = 8.0  # of the air's temperature about 22 °C, half range over the year [K]
    weather: float = 2.5  # of the air from day to day, standard deviation [K]
    lag: float = 1.0  # of the structure behind the air [days]
    thermometer: float = 1.0  # its offset, one for the year, standard deviation [K]
    mounting: float = 0.003  # of the bracket's stiffness from month to month, standard deviation [-]
    home: float = 0.7e-3  # of the position from week to week, standard deviation [m]

    def air(self, rng: np.random.Generator, days: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw the temperature of the air, and that of the structure, at the measurement of each day [°C]."""
        day = np.arange(days)
        air = 22.0 - self.season * np.cos(2.0 * np.pi * (day - 20) / 365.0) + self.weather * rng.standard_normal(days)
        structure = np.empty(days)
        state = 22.0 - self.season
        for i, temperature in enumerate(air):
            state += (temperature - state) * (1.0 - np.exp(-1.0 / self.lag))
            structure[i] = state
        return air, structure

    def friction_scales(self, rng: np.random.Generator, days: int) -> np.ndarray:
        """Draw by what all friction is scaled on each day [-]."""
        state, scale = rng.standard_normal(), np.empty(days)
        for day in range(days):
            state = self.persistence * state + np.sqrt(1.0 - self.persistence**2) * rng.standard_normal()
            since = (day % self.lubrication_interval) / self.lubrication_interval
            scale[day] = (1.0 + self.between_lubrications * since) * np.exp(self.friction * state)
        return scale


#: Days that are simulated together: 320 windows.
_DAYS_AT_ONCE = 8
_WINDOWS_A_PLACE = 8


def shop_year(
    machine: Machine,
    rng: np.random.Generator,
    days: int = 365,
    year: ShopYear | None = None,
    lost: Sequence[float] = (),
    *,
    measured: Sequence[int] | None = None,
) -> Iterator[Truth]:
    """Record one session a day, eight windows at each of five places, of an axis that has lost so much preload [N].

    It stays as it is where nothing is said. ``measured`` are the days on which it is measured, by default all.
    """
    measured = range(days) if measured is None else measured
    year = year or ShopYear()
    preload = machine.healthy - (np.array(lost) if len(lost) else np.zeros(days))
    air, structure = year.air(rng, days)
    friction = year.friction_scales(rng, days)
    offset = year.thermometer * rng.standard_normal()
    mounting = 1.0 + year.mounting * rng.standard_normal(days // 30 + 1)
    home = year.home * rng.standard_normal(days // 7 + 1)
    acquisition = replace(machine.acquisition, n_windows=_WINDOWS_A_PLACE)
    places = machine.positions(5)
    for first in range(0, len(measured), _DAYS_AT_ONCE):
        chunk = measured[first : first + _DAYS_AT_ONCE]
        tagged = [Condition(x, machine.healthy, temperature=round(float(air[day]), 1)) for day in chunk for x in places]
        true = [
            replace(
                condition,
                position=condition.position + float(home[day // 7]),
                preload=float(preload[day]),
                temperature=float(structure[day] + offset),
                friction_scale=float(friction[day]),
                bracket_scale=float(mounting[day // 30]),
            )
            for condition, day in zip(tagged, (day for day in chunk for _ in places), strict=True)
        ]
        recorded = simulate_measurements(
            tagged, rng, acquisition, scatter=Scatter(preload=0.0, temperature=0.3), plant=machine.plant, true=true
        )
        begin = [START + timedelta(days=30 + day, minutes=10 * i) for day in chunk for i in range(len(places))]
        windows = to_windows(recorded, tagged, begin, acquisition)
        for i, _ in enumerate(chunk):
            names = {f"m{k:04d}" for k in range(i * len(places), (i + 1) * len(places))}
            of_day = tuple(window for window in windows if window.measurement in names)
            of_places = tuple(true[i * len(places) : (i + 1) * len(places)])
            yield Truth(Session(machine.name, of_day), (float(preload[chunk[i]]),) * len(places), of_places)
