"""What each of several files was measured under is proposed as its name and its contents say it, and nothing else."""

from pathlib import Path

import pytest

from monitor_core.recordings.check import check_file
from monitor_core.recordings.raw.proposal.file_facts import file_facts
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map


@pytest.mark.parametrize(
    ("name", "preload", "payload", "position", "began"),
    [
        ("p100N_x250.csv", 100.0, None, 250.0, None),
        ("P3_x100.csv", None, None, 100.0, None),  # a part or a feed, as likely
        ("f12.csv", None, None, None, None),
        ("preload100_x250.csv", 100.0, None, 250.0, None),
        ("100N_250mm_9kg.csv", 100.0, 9.0, 250.0, None),
        ("Vorspannung 150 N Pos 300,5 mm.csv", 150.0, None, 300.5, None),
        ("2026-03-01_0630_P200N_X500.csv", 200.0, None, 500.0, "2026-03-01T06:30"),
        ("20260301T063015 50N.tdms", 50.0, None, None, "2026-03-01T06:30:15"),
        ("2026-03-01 load2.5 x400.csv", None, 2.5, 400.0, None),  # a day is no start
        ("2026-13-45_0630.csv", None, None, None, None),
        ("run7.csv", None, None, None, None),
        ("m3_axis_x_run12.csv", None, None, None, None),
    ],
)
def test_a_name_says_it(
    name: str, preload: float | None, payload: float | None, position: float | None, began: str | None
) -> None:
    facts = file_facts(name)
    assert (facts.preload_n, facts.payload_kg, facts.position_mm) == (preload, payload, position)
    assert facts.started_at == began


def test_what_stands_in_the_file_goes_before_its_name(tmp_path: Path) -> None:
    path = tmp_path / "100N_x250.csv"
    rows = [f"{i / 1000:.3f},{i % 7},{i % 5}" for i in range(200)]
    path.write_text("\n".join(["Preload: 150 N", "Position,400", "Time [s],Torque [Nm],Acc [m/s2]", *rows]) + "\n")
    read = check_file(path).read
    assert read is not None
    facts = file_facts(path.name, read.channels)
    assert (facts.preload_n, facts.position_mm, facts.payload_kg) == (150.0, 400.0, None)


@pytest.mark.parametrize(
    ("first", "states_start"),
    [
        ("time", True),  # texts of a date and time, which the map takes
        ("Time [s]", False),
        ("Time [s],time", False),  # numbers of seconds go before texts
    ],
)
def test_a_start_is_proposed_from_the_name_only_where_the_map_asks_for_one(
    tmp_path: Path, first: str, states_start: bool
) -> None:
    path = tmp_path / "2026-03-01_0630.csv"
    times = {"time": "2025-03-01T06:00:00.{:03d}Z", "Time [s]": "0.{:03d}"}
    rows = [",".join(times[name].format(i) for name in first.split(",")) + f",{i % 7},{i % 5}" for i in range(200)]
    path.write_text("\n".join([f"{first},Torque [Nm],Acc [m/s2]", *rows]) + "\n")
    read = check_file(path).read
    assert read is not None
    facts = file_facts(path.name, read.channels, proposed_map(read.channels, read.layout))
    assert facts.states_start == states_start
    assert facts.started_at == (None if states_start else "2026-03-01T06:30")
