"""The cause is named on sessions of the plant: finite elements in time with friction, servo and sensors."""

from dataclasses import replace
from itertools import groupby
from pathlib import Path

import pytest

from monitor_core.change.attribution import ChangeAttribution, attribute_change
from monitor_core.change.changes import Cause
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.measured_responses import measured_responses
from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.recordings.session_hdf5 import read_session
from service.documents.change import attribution_sentence
from tests.hidden_effects.running.sessions import BAND, HAPPENINGS, OUTSIDE, PRELOAD
from tests.hidden_effects.running.trials import described_axis, trials

BUNDLED = Path(__file__).parents[3] / "replay_data"
USUAL_TEMPERATURE = 22.0  # of the bundled sessions [°C]


@pytest.mark.release
@pytest.mark.parametrize("truth", ["none", "preload"])
def test_worn_nut_is_named_and_a_healthy_axis_is_left_alone(truth: str) -> None:
    few = trials(100, {truth: HAPPENINGS[truth]}, positions=(0.15, 0.30, 0.45, 0.60, 0.75), days=(2, 1))
    (trial,) = few
    assert trial.right, attribution_sentence(trial.explanation)
    if truth == "preload":
        size = trial.explanation.changes[0].size
        assert size is not None
        assert abs(size.value + 75.0) < 3.0 * size.standard_uncertainty
        assert size.standard_uncertainty < 15.0


@pytest.mark.release
@pytest.mark.parametrize(
    ("session", "outcome", "cause", "size"),
    [
        ("healthy-month", Outcome.NONE, Cause.NONE, None),
        pytest.param(  # 4.3 N a day: the mean of days 21 to 28 of the wear
            "slow-wear", Outcome.NAMED, Cause.PRELOAD, -105.0, marks=pytest.mark.release
        ),
        ("sudden-loss", Outcome.NAMED, Cause.PRELOAD, -100.0),
    ],
)
def test_bundled_session_with_positions_as_they_came(
    session: str, outcome: Outcome, cause: Cause, size: float | None
) -> None:
    answer = explained_session(session)
    assert (answer.outcome, answer.cause) == (outcome, cause), attribution_sentence(answer)
    found = answer.changes[0].size
    if size is not None:
        assert found is not None
        assert abs(found.value - size) < 3.0 * found.standard_uncertainty


def explained_session(session: str) -> ChangeAttribution:
    """Explain the last eight measurements of a bundled session by its first twenty."""
    windows = read_session(BUNDLED / f"{session}.session.h5").windows
    measurements = [list(group) for _, group in groupby(windows, key=lambda window: window.measurement)]
    responses = []
    for of_measurement in (*measurements[:20], *measurements[-8:]):
        modal = measure_mode(of_measurement, band=BAND, gate=ModeGate())
        assert isinstance(modal, ModalMeasurement)
        responses.append(_with_its_temperature(modal))
    return attribute_change(described_axis(), responses[:20], responses[20:], preload=PRELOAD)


def _with_its_temperature(modal: ModalMeasurement) -> FrequencyResponseObservation:
    (response,) = measured_responses([modal])
    assert modal.conditions.temperature is not None
    deviation = modal.conditions.temperature - USUAL_TEMPERATURE
    return replace(response, conditions=replace(response.conditions, temperature_deviation=deviation))


@pytest.mark.release
def test_every_cause_is_named() -> None:
    """On one machine; benchmarks/running_axis.py has twenty, with more positions and days."""
    found = list(trials(101, HAPPENINGS | OUTSIDE, positions=(0.15, 0.30, 0.45, 0.60, 0.75), days=(3, 1)))
    wrong = {trial.truth: attribution_sentence(trial.explanation) for trial in found if not trial.right}
    assert not wrong
