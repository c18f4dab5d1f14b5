"""The recorded sessions: who measured what, when, and what happened to the axis meanwhile.

Every session is one axis with the default :class:`~tests.plant.simulation.Plant`. Tags are rounded as an operator or a
controller states them. Truth differs from the tags by a stated scatter, drawn anew for each measurement, independent
and normal (:class:`~tests.plant.measurements.Scatter`): preload ±1.5 N around the level of the day (none where the
preload is stated: a load cell reads it), position ±0.2 mm, temperature ±0.3 K, Coulomb friction ±5 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta, timezone

import numpy as np

from tests.plant import troubles
from tests.plant.chain import Condition
from tests.plant.measurements import CALIBRATION_SCATTER, Acquisition, Scatter, simulate_measurements
from tests.plant.motion import MoveProgram
from tests.plant.recorder import RecordedWindow
from tests.plant.troubles import Trouble

AXIS_ID = "plant-axis"
ZONE = timezone(timedelta(hours=1))
HEALTHY_PRELOAD = 300.0  # [N]
HEALTHY_MEASUREMENTS = 20  # before anything happens: enough for a baseline


@dataclass(frozen=True, slots=True)
class Measurement:
    """One measurement: tags, time, and how it was taken."""

    name: str
    started_at: datetime
    tagged: Condition  # its preload is written only where the scenario says that it is known
    acquisition: Acquisition = field(default_factory=Acquisition)
    trouble: Trouble = troubles.none


@dataclass(frozen=True, slots=True)
class Scenario:
    """One recorded session."""

    key: str
    description: str
    measurements: tuple[Measurement, ...]
    seed: int
    preload_known: bool = False

    @property
    def scatter(self) -> Scatter:
        """How truth differs from the tags."""
        return CALIBRATION_SCATTER if self.preload_known else Scatter()


def record(scenario: Scenario) -> list[RecordedWindow]:
    """Simulate a session."""
    rng = np.random.default_rng([2018, scenario.seed])
    windows: list[RecordedWindow] = []
    for acquisition in dict.fromkeys(m.acquisition for m in scenario.measurements):
        chosen = [m for m in scenario.measurements if m.acquisition == acquisition]
        recorded = simulate_measurements([m.tagged for m in chosen], rng, acquisition, scatter=scenario.scatter)
        for i, measurement in enumerate(chosen):
            c = measurement.tagged
            windows += measurement.trouble(
                [
                    RecordedWindow(
                        measurement=measurement.name,
                        started_at=measurement.started_at + timedelta(seconds=2.0 * acquisition.duration * w),
                        sample_rate_hz=float(acquisition.sample_rate),
                        excitation=recorded.excitation[i, w],
                        response=recorded.response[i, w],
                        position=recorded.position[i, w],
                        position_mm=round(1e3 * c.position, 3),
                        payload_kg=c.payload,
                        temperature_c=c.temperature,
                        preload_n=c.preload if scenario.preload_known else None,
                        excitation_source="drive" if acquisition.drive_torque else "sensor",
                    )
                    for w in range(acquisition.n_windows)
                ]
            )
    return sorted(windows, key=lambda w: w.started_at)


def all_scenarios() -> tuple[Scenario, ...]:
    """Return the sessions of ``replay_data``."""
    return (
        calibration(),
        hidden(),
        healthy_month(),
        slow_wear(),
        sudden_loss(),
        payload_change(),
        temperature_drift(),
        bad_windows(),
    )


def calibration() -> Scenario:
    """Six positions by five preloads, two payloads at three positions, three temperatures."""
    conditions = [
        Condition(x, preload=p, temperature=22.0)
        for p in (50.0, 100.0, 200.0, 300.0, 400.0)
        for x in (0.15, 0.30, 0.45, 0.60, 0.75, 0.85)
    ]
    conditions += [Condition(x, payload=m, temperature=22.0) for m in (8.0, 10.0) for x in (0.30, 0.45, 0.60)]
    conditions += [Condition(x, temperature=t) for x, t in ((0.30, 30.0), (0.60, 36.0), (0.45, 38.0))]
    start = datetime(2025, 2, 24, 8, 0, tzinfo=ZONE)
    return Scenario(
        "calibration",
        "Preload set by load cell: 6 positions x 5 preloads, 2 payloads x 3 positions, 3 temperatures.",
        tuple(
            Measurement(f"calibration-{i:03d}", start + timedelta(minutes=12 * i), c) for i, c in enumerate(conditions)
        ),
        seed=1,
        preload_known=True,
    )


def hidden() -> Scenario:
    """Preloads and positions that are not in the calibration, with the truth beside them."""
    rng = np.random.default_rng([2018, 2, 0])
    start = datetime(2025, 2, 26, 8, 0, tzinfo=ZONE)
    return Scenario(
        "hidden",
        "Preloads 70 to 380 N and positions 180 to 820 mm that the calibration has not seen; preload_n is the truth.",
        tuple(
            Measurement(
                f"hidden-{i:03d}",
                start + timedelta(minutes=12 * i),
                Condition(
                    round(rng.uniform(0.18, 0.82), 3),
                    preload=round(rng.uniform(70.0, 380.0), 1),
                    temperature=round(22.0 + rng.normal(0.0, 0.7), 1),
                ),
            )
            for i in range(20)
        ),
        seed=2,
        preload_known=True,
    )


def healthy_month() -> Scenario:
    """Nothing happens."""
    return Scenario("healthy-month", "A healthy month at 300 N.", _daily("healthy", 31, seed=3), seed=3)


def slow_wear() -> Scenario:
    """Lose 120 N evenly over four weeks."""
    loss = np.linspace(0.0, 120.0, 29)[1:]
    return Scenario(
        "slow-wear",
        "Healthy for 20 days at 300 N, then wear: 4.3 N a day down to 180 N.",
        _daily("wear", HEALTHY_MEASUREMENTS + loss.size, seed=4, preloads=list(HEALTHY_PRELOAD - loss)),
        seed=4,
    )


def sudden_loss() -> Scenario:
    """Lose 100 N between two measurements."""
    return Scenario(
        "sudden-loss",
        "Healthy for 22 days at 300 N, then 200 N from one day to the next.",
        _daily("sudden", 32, seed=5, preloads=[200.0] * 10),
        seed=5,
    )


def payload_change() -> Scenario:
    """Carry a workpiece from some day on."""
    return Scenario(
        "payload-change",
        "Healthy at 300 N; from day 21 with a workpiece of 9 kg, stated.",
        _daily("payload", 30, seed=6, payloads=[9.0] * 10),
        seed=6,
    )


def temperature_drift() -> Scenario:
    """Warm the hall by 13 K over twelve days."""
    return Scenario(
        "temperature-drift",
        "Healthy at 300 N; from day 21 the temperature rises by 13 K in 12 days, stated.",
        _daily("temperature", 32, seed=7, temperatures=list(22.0 + np.linspace(0.0, 13.0, 13)[1:])),
        seed=7,
    )


LONG_MOVES = MoveProgram(speed=0.12, cruise=(0.30, 0.32), starts=((0.05, 0.1), (0.52, 0.56)))  # of 37 mm
STANDSTILL = MoveProgram(speed=1e-5)
#: Trouble by the day of the month on which it strikes, and how the measurement was taken. Other days are good.
TROUBLES: dict[int, tuple[Trouble, Acquisition]] = {
    1: (troubles.first(2, troubles.drop_out), Acquisition()),
    3: (troubles.every(troubles.drop_out), Acquisition()),
    4: (troubles.every(troubles.clip), Acquisition()),
    6: (troubles.first(4, troubles.unplug), Acquisition()),
    7: (troubles.first(3, troubles.freeze), Acquisition()),
    9: (troubles.first(3, troubles.cut(128)), Acquisition()),
    10: (troubles.first(2, troubles.cut(1021)), Acquisition()),  # a prime number
    12: (troubles.keep(2), Acquisition(sample_rate=2048)),  # after good windows at 1024 Hz
    14: (troubles.none, Acquisition(program=LONG_MOVES)),
    15: (troubles.none, Acquisition(program=STANDSTILL)),
    17: (troubles.keep(3), Acquisition()),
    18: (troubles.keep(1), Acquisition(knock=400.0)),  # after undisturbed windows
    20: (troubles.none, Acquisition(drive_torque=True)),
    21: (troubles.every(troubles.turn_round), Acquisition()),
    23: (troubles.lose_synchrony, Acquisition()),
    24: (troubles.every(troubles.unplug), Acquisition()),
}


def bad_windows() -> Scenario:
    """Meet most troubles in a month, with good days between."""
    measurements = []
    for day, healthy in enumerate(_daily("bad", 27, seed=8)):
        trouble, acquisition = TROUBLES.get(day, (troubles.none, healthy.acquisition))
        struck = replace(healthy, acquisition=acquisition, trouble=trouble)
        if day in {12, 18}:  # the trouble comes after good windows of the same measurement
            measurements.append(healthy)
            struck = replace(struck, started_at=healthy.started_at + timedelta(minutes=1))
        measurements.append(struck)
    return Scenario(
        "bad-windows",
        "Healthy at 300 N; most things that go wrong with windows and measurements, and good days between.",
        tuple(measurements),
        seed=8,
    )


def _daily(
    prefix: str,
    days: int,
    *,
    seed: int,
    preloads: Sequence[float] = (),
    payloads: Sequence[float] = (),
    temperatures: Sequence[float] = (),
) -> tuple[Measurement, ...]:
    """Measure once a day, about six in the morning, where the table happens to be in its usual range.

    The sequences hold the last days' values; before them the axis is healthy, unloaded and at about 22 °C.
    """
    rng = np.random.default_rng([2018, seed, 0])

    def value(of_last_days: Sequence[float], day: int, usual: float) -> float:
        late = day - (days - len(of_last_days))
        return float(of_last_days[late]) if late >= 0 else usual

    start = datetime(2025, 3, 1, 6, 0, tzinfo=ZONE)
    return tuple(
        Measurement(
            f"{prefix}-{day:03d}",
            start + timedelta(days=day, seconds=int(rng.integers(0, 1800))),
            Condition(
                position=round(rng.uniform(0.3, 0.7), 3),
                preload=value(preloads, day, HEALTHY_PRELOAD),
                payload=value(payloads, day, 0.0),
                temperature=round(value(temperatures, day, 22.0) + rng.normal(0.0, 0.7), 1),
            ),
        )
        for day in range(days)
    )
