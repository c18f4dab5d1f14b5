"""A name that is used again and again: a measurement is a name and a time, on every road and in every order."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from random import Random

import click
import numpy as np
import pytest

import preload_client
from monitor_core import recording
from monitor_core.recording import Conditions, Session, Window, measurements_of
from monitor_core.recordings.session_hdf5 import open_session, write_session
from service.cli.remote.client import Client, window_document
from service.cli.replay import post_session
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.operations.monitoring.intake.admission import Admission, Measured
from service.store.intake import JUDGED, OPEN, MeasurementRecord, StoredMember
from tests.conftest import canary
from tests.service.conftest import START, Api, simulated_measurement
from tests.service.test_jobs import wait_for
from tests.service.uploads import MAP, session_bytes, upload


@dataclass
class Memory:
    """What a store keeps of measurements, as plain lists."""

    rows: dict[int, MeasurementRecord] = field(default_factory=dict)
    members: dict[int, dict[datetime, StoredMember]] = field(default_factory=dict)
    known: dict[int, Measured] = field(default_factory=dict)
    n_numbers: int = 0
    n_loads: int = 0
    closed_numbers: set[int] = field(default_factory=set)

    def called(self, name: str, since: datetime, until: datetime) -> list[Measured]:
        rows = [row for row in self.rows.values() if row.name == name and row.ended_at >= since]
        found = sorted((row for row in rows if row.started_at <= until), key=lambda row: row.started_at)
        was = {row.id: [] if row.status == OPEN else [(row.started_at, row.id)] for row in found}
        return [self.known.setdefault(row.id, Measured(row, was[row.id])) for row in found]

    def members_of(self, row: MeasurementRecord) -> list[StoredMember]:
        self.n_loads += 1
        return [self.members[row.id][start] for start in sorted(self.members[row.id])]

    def closed(self, row: MeasurementRecord) -> str | None:
        return "it takes no more" if row.id in self.closed_numbers else None

    def take(self, windows: list[Window], *, complete: bool) -> Admission:
        """Put windows in as a request would, and write down what came of it."""
        self.known.clear()
        admission = Admission("axis", AxisConfiguration(windows_per_measurement=4), START + 40 * DAY, self)
        admission.admit(sorted(windows, key=lambda window: window.started_at), lambda _: None)
        for measurement in admission.changed():
            if measurement.row.id is None:
                self.n_numbers += 1
                measurement.row.id = self.n_numbers
            self.rows[measurement.row.id] = measurement.row
            self.members.setdefault(measurement.row.id, {})
        for item in admission.admitted:
            if item.refusal is None:
                self.members[item.of.row.id][item.placed.started_at] = StoredMember(item.placed, item.accepted)
        for start, before, measurement in admission.moved:
            self.members[measurement.row.id][start] = self.members[before.row.id].pop(start)
        for gone in admission.joined:
            assert not self.members.pop(gone.row.id)
            del self.rows[gone.row.id]
        for measurement in admission.complete(set(admission.measured.values()) if complete else ()):
            assert [member.placed for member in measurement.members] == [
                m.placed for m in self.members_of(measurement.row)
            ]
            measurement.row.status = JUDGED
        return admission


DAY, SECOND = timedelta(days=1), timedelta(seconds=1)
WINDOW = Window(np.zeros(8), np.zeros(8), 8.0, START, Conditions(0.5), "X")
#: Pauses of no doubt, and just within and beyond the longest.
PAUSES_S = (2.0, 2.0, 2.0, 599.0, 601.0, 602.0, 4000.0, 86400.0)


def random_requests(random: Random) -> list[list[Window]]:
    """Return windows of few names at few places, in any order, cut into requests."""
    windows, at = [], START
    for _ in range(random.randint(1, 24)):
        at += timedelta(seconds=random.choice(PAUSES_S))
        position, preload = random.choice([(0.5, None)] * 4 + [(0.515, None), (0.53, None), (0.5, 300.0), (0.5, 500.0)])
        conditions = Conditions(position, preload=preload)
        windows.append(replace(WINDOW, started_at=at, measurement=random.choice("XXXY"), conditions=conditions))
    random.shuffle(windows)
    cuts = sorted({0, len(windows), *random.choices(range(len(windows)), k=8)})
    return [windows[first:end] for first, end in pairwise(cuts)]


def as_set(groups: object) -> set[tuple[datetime, ...]]:
    return {tuple(sorted(group)) for group in groups}


@pytest.mark.parametrize("n_histories", canary([150, 5000]))
def test_any_order_and_cut_makes_the_measurements_of_the_whole(
    n_histories: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(n_histories):
        monkeypatch.setattr(recording, "_MOST_WINDOWS", 3 if seed % 3 == 0 else 1000)
        random, memory = Random(seed), Memory()  # noqa: S311 - no secret
        requests = random_requests(random)
        for windows in requests:
            memory.take(windows, complete=random.random() < 0.3)
            assert all(memory.members.values()), seed
        whole = measurements_of(window.placed for windows in requests for window in windows)
        assert as_set(memory.members.values()) == as_set([w.started_at for w in group] for group in whole), seed
        for row in memory.rows.values():
            placed = [member.placed for member in memory.members_of(row)]
            assert (row.started_at, row.ended_at) == (placed[0].started_at, placed[-1].ended_at), seed
            assert row.n_accepted == len(placed), seed


def at(*seconds: float, position: float = 0.5, preload: float | None = None) -> list[Window]:
    conditions = Conditions(position, preload=preload)
    return [replace(WINDOW, started_at=START + timedelta(seconds=s), conditions=conditions) for s in seconds]


def test_what_lies_between_two_windows_of_a_request_is_not_looked_at() -> None:
    memory, n_between = Memory(), 40
    for hour in range(1, n_between):
        memory.take(at(3600.0 * hour), complete=True)
    memory.n_loads = 0
    memory.take(at(0.0, 1800.0, 3600.0 * n_between, 3600.0 * n_between + 2.0), complete=True)
    assert sorted(len(members) for members in memory.members.values()) == [1] * (n_between + 1) + [2]
    assert memory.n_loads <= 4


def test_late_window_of_a_sender_that_never_pauses_changes_what_is_near_it() -> None:
    memory, started = Memory(), [250.0 * i for i in range(8 * 24 * 14)]
    late_starts = Random(7).sample(started[1:], 30)  # noqa: S311 - no secret
    late, sent = at(*late_starts), at(*(seconds for seconds in started if seconds not in late_starts))
    sent += at(*(seconds + 1.0 for seconds in started[700:900:50]), position=0.1)
    for first in range(0, len(sent), 100):
        memory.take(sent[first : first + 100], complete=True)
    for window in [*late, *at(86400.0 * 3 + 7, position=0.1)]:
        admission = memory.take([window], complete=True)
        assert len(admission.changed()) + len(admission.joined) <= 4, window.started_at
        sent.append(window)
    whole = measurements_of(window.placed for window in sent)
    assert as_set(memory.members.values()) == as_set([w.started_at for w in group] for group in whole)
    lengths = [row.ended_at - row.started_at for row in memory.rows.values()]
    assert max(lengths) <= timedelta(hours=18)


def test_window_that_would_change_many_measurements_is_refused_and_changes_none() -> None:
    memory = Memory()
    for number in range(21):
        memory.take(at(605.0 * number), complete=True)
    bridges = [605.0 * number + 300.0 for number in range(20)]
    assert {item.refusal.reason for item in memory.take(at(*bridges), complete=True).admitted} == {"too-late"}
    assert [len(members) for members in memory.members.values()] == [1] * 21
    memory.take(at(*bridges[:3]), complete=True)
    assert sorted(len(members) for members in memory.members.values()) == [1] * 17 + [7]


def test_window_within_a_closed_measurement_is_refused_whatever_came_before_it_in_its_request() -> None:
    memory = Memory()
    memory.take(at(100.0, 200.0, 300.0), complete=True)
    memory.closed_numbers.add(1)
    admission = memory.take(at(50.0, position=0.1) + at(250.0), complete=False)
    assert [item.refusal is not None for item in admission.admitted] == [False, True]
    assert sorted(len(members) for members in memory.members.values()) == [1, 3]


def test_measurement_of_nothing_but_wrong_clocks_does_not_hide_the_one_that_goes_on() -> None:
    memory = Memory()
    memory.take(at(0.0, 2.0, 4.0), complete=True)
    hollow = replace(memory.rows[1], id=2, started_at=START + 5 * SECOND, ended_at=START + 5 * SECOND, status=OPEN)
    memory.rows[2], memory.members[2], memory.n_numbers = hollow, {}, 2
    memory.take(at(8.0), complete=False)
    assert {number: len(members) for number, members in memory.members.items()} == {1: 4, 2: 0}


def recorded(name: str, preload: float, after: timedelta = timedelta(), position_mm: float = 500.0) -> list[Window]:
    rng = np.random.default_rng(int(preload))
    start = START + after
    return simulated_measurement(rng, name, preload=preload, started_at=start, n_windows=8, position_mm=position_mm)


FIRST, LATER = recorded("record", 300.0), recorded("record", 150.0, DAY)
#: What is sent, file by file, and what must be there then: when it began, its preload, and of how many windows it is.
CASES: dict[str, tuple[list[list[Window]], list[tuple[timedelta, float, int]]]] = {
    "same day": (
        [FIRST, recorded("record", 150.0, timedelta(minutes=11))],
        [(timedelta(), 300.0, 8), (timedelta(minutes=11), 150.0, 8)],
    ),
    "next day": ([FIRST, LATER], [(timedelta(), 300.0, 8), (DAY, 150.0, 8)]),
    "out of order": ([LATER, FIRST], [(timedelta(), 300.0, 8), (DAY, 150.0, 8)]),
    "late rest": ([FIRST[:5], LATER, FIRST[5:]], [(timedelta(), 300.0, 8), (DAY, 150.0, 8)]),
    "no date": ([FIRST, recorded("record", 150.0)], [(timedelta(), 300.0, 8)]),
}
#: Of a road: takes a file to an axis, and returns the sentence that it is refused by, if so.
Send = Callable[[Api, str, list[Window], Path], str | None]


def by_post(api: Api, axis: str, windows: list[Window], folder: Path) -> str | None:
    del folder
    answer = api.post(axis, windows, complete=True)
    return None if answer.is_success else answer.json()["detail"]


def by_client(api: Api, axis: str, windows: list[Window], folder: Path) -> str | None:
    """Post JSON, as the client does."""
    del folder
    with preload_client.Client(str(api.http.base_url)) as client:
        try:
            client.post_windows(axis, [window_document(window) for window in windows], complete=True)
        except preload_client.ProblemError as error:
            return str(error)
    return None


def by_replay(api: Api, axis: str, windows: list[Window], folder: Path) -> str | None:
    """Do what ``preload replay`` does."""
    write_session(folder / "record.session.h5", Session(axis, tuple(windows)))
    with open_session(folder / "record.session.h5") as session, Client(str(api.http.base_url)) as client:
        try:
            post_session(session, client, axis)
        except click.ClickException as error:
            return error.message
    return None


def _uploaded(api: Api, axis: str, *file: tuple[str, bytes], channel_map: str | None = None) -> str | None:
    job = upload(api, *file, channel_map=channel_map, axis=axis).json()
    return wait_for(api, job["id"], "done", "failed")["error"]


def by_upload(api: Api, axis: str, windows: list[Window], folder: Path) -> str | None:
    return _uploaded(api, axis, ("record.session.h5", session_bytes(folder, windows, axis)))


def by_raw_upload(api: Api, axis: str, windows: list[Window], folder: Path) -> str | None:
    """Upload a raw file with a map that calls every measurement alike."""
    del folder
    file = io.BytesIO()
    np.savez(file, torque=np.stack([w.excitation for w in windows]), acc=np.stack([w.response for w in windows]))
    own = MAP.replace("2026-03-02T06:00:00Z", windows[0].started_at.isoformat()).replace('"axis"', f'"{axis}"')
    return _uploaded(api, axis, ("record.npz", file.getvalue()), channel_map=f'{own}measurement = "record"\n')


@pytest.mark.parametrize("send", canary([by_post, by_client, by_replay, by_upload, by_raw_upload]))
def test_a_measurement_is_a_name_and_a_time_on_every_road(shared_api: Api, tmp_path: Path, send: Send) -> None:
    failures = []
    for number, (case, (files, expected)) in enumerate(CASES.items()):
        axis = f"{send.__name__}-{number}".replace("_", "-")
        shared_api.register(axis, windows_per_measurement=8)
        shared_api.calibrate(axis)
        said = [sentence for windows in files if (sentence := send(shared_api, axis, windows, tmp_path))]
        trend = shared_api.trend(axis)
        found = [
            (datetime.fromisoformat(point["at"]) - START, point["preload_n"], windows_in(shared_api, axis, point))
            for point in trend
        ]
        near = [(at, pytest.approx(preload, rel=0.03), n) for at, preload, n in expected]
        if found != near or {point["measurement"] for point in trend} != {"record"}:
            failures.append((case, found))
        if [("never replaced" in sentence) for sentence in said] != [True] * (case == "no date"):
            failures.append((case, said))
    assert failures == []


def windows_in(api: Api, axis: str, point: dict) -> int:
    view = api.http.get(f"/v1/axes/{axis}/measurements/{point['measurement_id']}").json()
    return round(view["outcome"]["n_averages"])


def test_one_name_at_many_places_is_a_measurement_for_each_visit(shared_api: Api, tmp_path: Path) -> None:
    shared_api.register("places", windows_per_measurement=8)
    shared_api.calibrate("places")
    visits = [(300.0, 0), (500.0, 60), (700.0, 120), (300.0, 180)]
    windows = [w for mm, at in visits for w in recorded("X", 300.0, timedelta(seconds=at), mm)]
    assert by_replay(shared_api, "places", windows, tmp_path) is None
    found = [(point["position_mm"], point["preload_n"]) for point in shared_api.trend("places")]
    assert found == [(pytest.approx(mm), pytest.approx(300.0, rel=0.05)) for mm, _ in visits]
    session = Session("places", tuple(windows))
    assert session.measurements == tuple(f"X ({(START + timedelta(seconds=at)).isoformat()})" for _, at in visits)
    assert [len(session.windows_of(name)) for name in session.measurements] == [8] * 4


def test_who_waits_longer_lets_windows_be_as_far_apart(shared_api: Api) -> None:
    """An axis whose settings were stated before there was a pause takes what it took."""
    found = {}
    for timeout_s, pause_s in ((3600.0, None), (60.0, None), (3600.0, 600.0)):
        axis = f"waits-{timeout_s:g}-{pause_s}"
        shared_api.register(axis, measurement_timeout_s=timeout_s, measurement_pause_s=pause_s)
        for minutes in (0, 8, 16, 61):  # pauses of 8, 8 and 45 minutes
            shared_api.accept(axis, recorded("X", 300.0, timedelta(minutes=minutes))[:1])
        shared_api.accept(axis, recorded("X", 300.0)[1:2], complete=True)
        found[timeout_s, pause_s] = [windows_in(shared_api, axis, point) for point in shared_api.trend(axis)]
    assert found == {(3600.0, None): [5], (60.0, None): [4], (3600.0, 600.0): [4]}


def test_what_is_made_of_pinned_windows_is_pinned(shared_api: Api) -> None:
    shared_api.register("parted")
    shared_api.accept("parted", FIRST, complete=True)
    (whole,) = (point["measurement_id"] for point in shared_api.trend("parted"))

    def pin(measurement: int, reason: str) -> None:
        pin = {"measurement": measurement, "reason": reason}
        assert shared_api.http.post("/v1/axes/parted/pins", json=pin).status_code == 201

    def pins() -> dict[int, str]:
        listed = shared_api.http.get("/v1/axes/parted/pins").json()["pins"]
        return {pin["measurement_id"]: pin["reason"] for pin in listed}

    pin(whole, "of interest")
    between = FIRST[3].ended_at + (FIRST[4].started_at - FIRST[3].ended_at) / 2
    elsewhere = replace(FIRST[0], started_at=between, conditions=Conditions(0.1))
    shared_api.accept("parted", [elsewhere], complete=True)
    parts = {point["measurement_id"]: point["position_mm"] for point in shared_api.trend("parted")}
    assert pins() == {number: "of interest" for number, position in parts.items() if position != 100.0}
    assert len(pins()) == 2

    bridged = [replace(w, started_at=DAY + START + 300 * i * SECOND) for i, w in enumerate(FIRST)]
    for part in (bridged[:3], bridged[5:]):
        shared_api.accept("parted", part, complete=True)
    first, second = (point["measurement_id"] for point in shared_api.trend("parted")[-2:])
    pin(first, "before")
    pin(second, "after")
    shared_api.accept("parted", bridged[3:5])
    assert pins()[first] == "before; after"
    assert second not in pins()


def test_what_is_joined_keeps_its_alarms_and_pins(shared_api: Api) -> None:
    shared_api.register("bridged")
    windows = [replace(w, started_at=START + 300 * i * timedelta(seconds=1)) for i, w in enumerate(FIRST)]
    for part in (windows[:3], windows[5:]):
        shared_api.accept("bridged", part, complete=True)
    first, second = (point["measurement_id"] for point in shared_api.trend("bridged"))
    pin = {"measurement": second, "reason": "of interest"}
    assert shared_api.http.post("/v1/axes/bridged/pins", json=pin).status_code == 201
    answer = shared_api.accept("bridged", windows[3:5])
    assert [outcome["measurement_id"] for outcome in answer["measurements"]] == [first]
    assert answer["measurements"][0]["n_averages"] == pytest.approx(8.0)
    assert shared_api.http.get(f"/v1/axes/bridged/measurements/{second}").status_code == 404
    (pinned,) = shared_api.http.get("/v1/axes/bridged/pins").json()["pins"]
    assert pinned["measurement_id"] == first
    shared_api.accept("bridged", recorded("record", 300.0, DAY), complete=True)
    assert shared_api.trend("bridged")[-1]["measurement_id"] > second  # its number is not given again
