"""What the charts remember survives the way through JSON to the last bit."""

import json
from datetime import UTC, datetime, timedelta

import numpy as np
from hypothesis import given, settings, strategies as st

from monitor_core.axis_state import AxisState
from monitor_core.recording import Conditions
from monitor_core.trend import (
    DetectorSettings,
    JointObservation,
    LossDirection,
    Observation,
    Session,
    joint_step,
    step,
)
from service.operations.monitoring.axis_configuration import AxisConfiguration, detector_design, detector_settings
from service.operations.monitoring.intake.chart_state import dump_design, dump_state, load_design, load_state, state_now
from service.store.tables import AxisRow

SETTINGS = DetectorSettings(baseline_size=8, baseline_span=timedelta(days=2), loss=LossDirection.RISE)
START = datetime(2026, 1, 1, tzinfo=UTC)

finite = st.floats(allow_nan=False, allow_infinity=False)
moments = st.datetimes(datetime(1970, 1, 2), datetime(2200, 1, 1), timezones=st.just(UTC))  # noqa: DTZ001 - the zone is added
uncertainties = st.floats(0.0, allow_infinity=False)
sessions = st.builds(Session, moments, moments, st.integers(1, 9), finite, uncertainties, uncertainties, uncertainties)
conditions = st.builds(
    Conditions,
    finite,
    st.none() | st.floats(0.0, 1e6),
    st.none() | st.floats(-273.0, 1e3),
    st.none() | st.floats(1.0, 1e7),
)


def through_json(document: dict[str, object]) -> dict[str, object]:
    return json.loads(json.dumps(document, allow_nan=False))


@given(learning=st.lists(sessions, max_size=5), known=st.lists(conditions, max_size=5))
def test_learning_state_comes_back_as_it_was(learning: list[Session], known: list[Conditions]) -> None:
    state = AxisState()
    state = AxisState(type(state.detector)(learning=tuple(learning)), tuple(known))
    assert load_state(through_json(dump_state(state))) == state


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), loss=st.floats(-1.0, 5.0))
def test_charts_go_on_from_json_as_they_would_have(seed: int, loss: float) -> None:
    """From baseline to alarm: a state that is stored after each measurement is one that never was, to the last bit."""
    design = detector_design(SETTINGS)
    rng = np.random.default_rng(seed)
    state = stored = AxisState()
    for i in range(30):
        value = 4.4e-6 + 2e-8 * (rng.normal() + (loss if i > 15 else 0.0))
        observation = Observation(START + timedelta(hours=13 * i, microseconds=i), value, 5e-9, 1e-9, 21.0 + i % 3)
        together = JointObservation(observation.at, {"a": rng.normal() + loss * (i > 22), "b": rng.normal()}, 21.0)
        state, stored = (
            AxisState(
                step(before.detector, observation, design),
                (Conditions(0.5, 0.0, 21.5),),
                joint=joint_step(before.joint, together, design),
            )
            for before in (state, stored)
        )
        stored = load_state(through_json(dump_state(stored)))
        assert stored == state


def test_limits_come_back_as_they_were() -> None:
    design = detector_design(detector_settings(AxisConfiguration(baseline_size=8)))
    assert load_design(through_json(dump_design(design))) == design


def axis_in(state: AxisState) -> AxisRow:
    detector = state.detector
    return AxisRow(state=str(detector.status), state_since=detector.since, last_charted_at=detector.last_at)


def test_axis_nothing_is_known_of_is_unknown() -> None:
    assert state_now(axis_in(AxisState()), START, 1.0) == ("unknown", None)


def test_silence_makes_a_state_unknown_but_does_not_end_an_alarm() -> None:
    design = detector_design(SETTINGS)
    rng = np.random.default_rng(1)
    state = AxisState()
    at = START
    while str(state.detector.status) != "alarm":
        lost = 5.0 if state.detector.baseline is not None else 0.0
        state = AxisState(step(state.detector, Observation(at, rng.normal() + lost), design))
        if str(state.detector.status) == "learning":
            assert state_now(axis_in(state), at + timedelta(hours=2), 1.0) == ("unknown", at + timedelta(hours=1))
            assert state_now(axis_in(state), at + timedelta(hours=1), 1.0) == ("learning", START)
        at += timedelta(hours=8)
    assert state_now(axis_in(state), at + timedelta(days=999), 1.0) == ("alarm", state.detector.since)
