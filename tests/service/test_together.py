"""Numbers that are watched together: the fold over measurements, and what is said of it."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from monitor_core.axis_state import AxisState, ChartedFeature, advance_feature
from monitor_core.preload import preload_feature
from monitor_core.preload.witnesses import WitnessName
from monitor_core.recording import Conditions
from monitor_core.trend import DetectorSettings, LossDirection, design_detector
from monitor_core.uncertainty import Estimate
from service.documents.axis_sentence import AxisFacts, OpenAlarm, standing
from service.documents.history import LineView
from service.documents.measurement import if_stated_in_words
from service.documents.said import in_english
from service.documents.together import together_view
from service.errors import DocumentDamagedError
from service.operations.monitoring.intake.chart_state import dump_state, load_state
from tests.test_end_to_end import bundled_calibration

START = datetime(2026, 1, 5, 6, tzinfo=UTC)
DESIGN = design_detector(DetectorSettings(loss=LossDirection.RISE))


def _fold(days: int, lost_from: int, lost: tuple[float, float], *, friction: bool = True) -> AxisState:
    """Return the state of a calibrated axis whose frequency and torque scatter by 0.3 and 2 % and fall by so much."""
    rng, state, calibration = np.random.default_rng(3), AxisState(), bundled_calibration()
    for day in range(days):
        fall = np.array(lost) * (day >= lost_from)
        frequency = 178.0 * (1.0 + 0.003 * rng.normal() - fall[0])
        torque = 0.4 * (1.0 + 0.02 * rng.normal() - fall[1])
        charted = ChartedFeature(
            START + timedelta(days=day),
            Estimate(preload_feature(frequency, 0.5, calibration.coefficients), 0.0),
            Conditions(0.5, 0.0, 21.0),
            torque if friction else None,
        )
        state = advance_feature(state, charted, calibration=calibration, design=DESIGN)
        state = load_state(dump_state(state))
    return state


def _measured_everywhere(
    days: int, changed_from: int, change: dict[str, float], payloads: tuple[tuple[float, ...], ...] = ((0.0, 10.0),) * 2
) -> AxisState:
    """Return the state of an axis whose damping and residue are measured anywhere, by a regression.

    It carries the first payloads before the change, and the others after it [kg].
    """
    rng, state, calibration = np.random.default_rng(4), AxisState(), bundled_calibration()
    for day in range(days):
        payload = rng.choice(payloads[day >= changed_from])
        conditions = Conditions(rng.uniform(0.2, 0.8), payload, 21.0 + rng.normal())
        setting = calibration.setting(conditions, 300.0)
        values = {}
        for name in (WitnessName.DAMPING_RATIO, WitnessName.RESIDUE):
            witness = calibration.witness(name)
            assert witness is not None
            of_day = 0.01 * rng.normal() + change.get(str(name), 0.0) * (day >= changed_from)
            values[name] = witness.expected(setting) * math.exp(of_day)
        frequency = 178.0 * (1.0 + 0.003 * rng.normal())
        charted = ChartedFeature(
            START + timedelta(days=day),
            Estimate(preload_feature(frequency, 0.5, calibration.coefficients), 0.0),
            conditions,
            0.4 * (1.0 + 0.02 * rng.normal()),
            damping_ratio=values[WitnessName.DAMPING_RATIO],
            residue=values[WitnessName.RESIDUE],
        )
        state = load_state(dump_state(advance_feature(state, charted, calibration=calibration, design=DESIGN)))
    return state


def test_damping_and_residue_are_watched_at_any_place_and_payload_of_a_calibration() -> None:
    """What place and payload do to them is taken out; a sensor whose gain moves is no loss, and is not called one."""
    healthy = together_view(_measured_everywhere(70, 99, {}).joint, DESIGN)
    assert healthy.numbers == ("damping-ratio", "frequency", "friction-torque", "residue")
    assert healthy.alarm is None
    view = together_view(_measured_everywhere(62, 50, {"residue": -0.06}).joint, DESIGN)
    assert view.alarm is not None
    first = view.alarm.numbers[0]
    lower, upper = first.interval_95_percent
    assert first.number == "residue"
    assert lower < 100.0 * math.expm1(-0.06) < upper
    assert "though not as when preload is lost" in view.sentence


@pytest.mark.parametrize(
    ("before", "after", "alarms"),
    # the last as a mean over windows has it
    [((0.0,), 10.0, False), ((0.0, 10.0), 10.0, True), ((10.0,), 9.999999999999996, True)],
)
def test_a_payload_that_the_baseline_has_not_seen_is_not_compared(
    before: tuple[float, ...], after: float, alarms: bool
) -> None:
    """What the calibration has of it is as far off in all sessions: that is no change, nor is the axis healthy."""
    state = _measured_everywhere(70, 50, {"residue": -0.06}, payloads=(before, (after,)))
    view = together_view(state.joint, DESIGN)
    assert (view.alarm is not None) is alarms
    assert view.sentence.startswith("not looked at since 2026-02-24") is not alarms
    assert ("uncompared_since" in dump_state(state)["joint"]) is not alarms  # as documents from before were


def test_an_alarm_names_each_number_with_its_change_and_its_share() -> None:
    view = together_view(_fold(50, 40, (0.03, 0.08)).joint, DESIGN)
    assert view.alarm is not None
    changes = {number.number: number for number in view.alarm.numbers}
    for name, percent in (("frequency", -3.0), ("friction-torque", -8.0)):
        lower, upper = changes[name].interval_95_percent
        assert lower <= percent <= upper
        assert f"{changes[name].change_percent:+.1f}" in view.sentence
    assert sum(number.share for number in view.alarm.numbers) == pytest.approx(1.0)
    assert abs(view.alarm.onset - (START + timedelta(days=40))) <= timedelta(days=1)


def test_a_healthy_axis_is_said_to_show_no_change_and_one_without_friction_is_not_called_healthy() -> None:
    healthy = together_view(_fold(40, 99, (0.0, 0.0)).joint, DESIGN)
    assert healthy.alarm is None
    assert healthy.numbers == ("frequency", "friction-torque")
    assert "show no change that lasts" in healthy.sentence
    alone = together_view(_fold(40, 99, (0.0, 0.0), friction=False).joint, DESIGN)
    assert alone.numbers == ()
    assert alone.sentence.startswith("not watched yet")


def test_an_axis_whose_numbers_have_changed_together_is_not_told_that_nothing_is_to_be_done() -> None:
    facts = AxisFacts(
        state="normal", is_silent=False, heard_at=START, silent_after_hours=48.0, in_force=1, stored=1, last_at=START,
        last_refused=None, preload=300.0, baseline=300.0, judged_anew_by=None, has_friction=True,
    )  # fmt: skip
    assert standing(facts).sentence.text == "No loss of preload is seen."
    changed = standing(replace(facts, changed_since=START))
    assert changed.sentence.text.startswith("Several numbers together have changed")
    assert changed.next_step.text.startswith("Measure at another position")
    assert "preload alone does not show it" in changed.sentence.text
    alerted = standing(replace(facts, changed_since=START, state="alert"))
    assert "preload alone is off its baseline, too" in alerted.sentence.text
    for waits in (
        {"changed_since": START},
        {"state": "alert"},
        {"is_silent": True},
    ):  # for somebody, judged anew or not
        assert standing(replace(facts, judged_anew_by=2, **waits)) == standing(replace(facts, **waits))
    learning = replace(facts, state="learning", in_force=None, stored=None, preload=None, baseline=None)
    assert "only a natural frequency that falls" in standing(learning).sentence.text  # no preload without newtons
    assert "only a preload that falls" in standing(replace(learning, in_force=1)).sentence.text


def test_a_standing_alarm_that_was_stored_before_it_said_which_way_it_goes_is_read_and_says_nothing_of_it() -> None:
    document = dump_state(_fold(46, 40, (0.03, 0.08)))
    del document["drive"], document["joint"]["chart"]["alarm"]["as_loss"]
    sentence = together_view(load_state(document).joint, DESIGN).sentence
    assert "several numbers together have changed: " in sentence
    del document["joint"]["chart"]["alarm"]["log_evidence"]
    with pytest.raises(DocumentDamagedError):
        load_state(document)


def test_of_an_axis_that_is_silent_a_rate_is_said_with_the_day_that_it_is_known_until() -> None:
    line = LineView(
        preload_at_end_n=240.0, slope_n_per_year=-365.25, interval_95_n_per_year=(-400.0, -330.0),
        interval_kind="confidence", started_at=START, ended_at=START + timedelta(days=30), n_sessions=30,
    )  # fmt: skip
    facts = AxisFacts(
        state="alarm", is_silent=False, heard_at=START, silent_after_hours=48.0, in_force=1, stored=1, last_at=START,
        last_refused=None, preload=240.0, baseline=300.0, judged_anew_by=None, has_friction=True, present=line,
        alarm=OpenAlarm(START, 300.0, None, None),
    )  # fmt: skip
    assert "now it loses 1.000 ± 0.096 N a day" in in_english(standing(facts).sentence)
    silent = in_english(standing(replace(facts, is_silent=True)).sentence)
    assert "until 2026-02-04 it lost 1.000 ± 0.096 N a day" in silent
    assert "now" not in silent


def test_an_interval_without_width_is_a_half_of_0() -> None:
    assert (
        if_stated_in_words((300.0, 300.0), [(["temperature"], (290.0, 310.0))]) == "± 0 N; with the temperature ± 10 N"
    )
