"""What is said of an axis follows from what was measured, not from the order in which it arrived."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.recording import Window
from tests.conftest import canary
from tests.service.arrivals import hashed, history, outcome_of
from tests.service.conftest import START

SEED = 5


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    return history(SEED)


@pytest.fixture(scope="module")
def in_order(windows: list[Window], tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    return outcome_of(windows, tmp_path_factory.mktemp("in order"), np.random.default_rng(0), 1)


def test_the_history_has_an_alarm_and_what_is_refused(in_order: dict) -> None:
    assert [alarm["status"] for alarm in in_order["alarms"]] == ["active"]
    assert in_order["axis"]["refused_windows"] == {"dead-channel": 1}


@pytest.mark.parametrize(("seed", "n_senders"), canary([(1, 1), (2, 3), (3, 8)]))
def test_any_order_cut_and_number_of_senders_says_the_same(
    windows: list[Window], in_order: dict, tmp_path: Path, seed: int, n_senders: int
) -> None:
    rng = np.random.default_rng(seed)
    shuffled = [windows[i] for i in rng.permutation(len(windows))]
    found = outcome_of(shuffled, tmp_path, rng, n_senders)
    assert found == in_order
    assert hashed(found) == hashed(in_order)


@pytest.mark.release
def test_newest_first_says_the_same(windows: list[Window], in_order: dict, tmp_path: Path) -> None:
    assert outcome_of(windows[::-1], tmp_path, np.random.default_rng(0), 1) == in_order


@pytest.mark.release
@pytest.mark.parametrize("away", [timedelta(days=-2000), datetime(2099, 1, 1, tzinfo=UTC) - START])
def test_one_clock_that_is_wrong_does_not_blind_the_axis(
    windows: list[Window], in_order: dict, tmp_path: Path, away: timedelta
) -> None:
    rogue = [
        replace(window, started_at=window.started_at + away, measurement="rogue") for window in windows if
        window.measurement == "m012"
    ]  # fmt: skip
    half = next(i for i, window in enumerate(windows) if window.measurement == "m012")
    found = outcome_of([*windows[:half], *rogue, *windows[half:]], tmp_path, np.random.default_rng(0), 1)
    assert found["alarms"] == in_order["alarms"]
    assert found["axis"]["state"] == "alarm"
    assert found["axis"]["refused_windows"].get("clock-ahead", 0) + found["axis"]["uncharted"].get("too-late", 0) > 0
