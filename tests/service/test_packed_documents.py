"""Documents of measurements take little room, and those of before are read."""

import json
import sqlite3
import time
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given, strategies as st

from service.json_types import JsonObject
from service.store.packed_documents import VERSION, packed, unpacked
from tests.service.conftest import START, Api, running_service, simulated_measurement

#: Of a judged measurement, outcome and response together [bytes]; its JSON has 2.8 kB.
MOST_BYTES = 1000

TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False) | TEXTS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(TEXTS, VALUES, max_size=5))
def test_a_document_comes_back_as_it_was(document: JsonObject) -> None:
    stored = packed(document)
    assert unpacked(stored) == json.loads(json.dumps(document))


@given(st.data())
def test_a_damaged_document_is_said_to_be_one(data: st.DataObject) -> None:
    stored = bytearray(packed({"measurement": "m", "frequency_hz": 179.5}))
    place = data.draw(st.integers(0, len(stored) - 1))
    stored[place] ^= data.draw(st.integers(1, 255))
    assert not isinstance(unpacked(bytes(stored)), dict)


def test_a_dictionary_never_changes() -> None:
    """What was packed once is unpacked by every later program."""
    packed_by_the_first = bytes.fromhex("0128b52ffd243c6d000018372c7d020046074b1cc4cb4118737e59")
    assert unpacked(packed_by_the_first) == {"measurement_id": 7, "refused": True, "reason": "low-coherence"}


def documents(folder: Path) -> list[tuple[Any, Any]]:
    with closing(sqlite3.connect(folder / "preload.db")) as database:
        query = "SELECT outcome, response FROM measurement_documents ORDER BY measurement_id"
        return database.execute(query).fetchall()


def test_measurements_take_little_room_and_older_ones_are_read(tmp_path: Path) -> None:
    def ask(api: Api) -> list[Any]:
        numbers = [point["measurement_id"] for point in api.trend("axis")]
        return [api.http.get(f"/v1/axes/axis/measurements/{number}").json() for number in numbers]

    rng = np.random.default_rng(1)
    with running_service(tmp_path) as api:
        api.register("axis", minimum_averages=2)
        for number in range(2):
            if number == 1:
                api.calibrate("axis")  # a job judges by it what was watched without
                deadline = time.monotonic() + 30.0
                while api.trend("axis")[0]["preload_n"] is None:
                    assert time.monotonic() < deadline
                    time.sleep(0.05)
            at = START + timedelta(hours=number)
            api.accept("axis", simulated_measurement(rng, f"m{number}", n_windows=4, started_at=at), complete=True)
        told = ask(api)
    stored = documents(tmp_path)
    sizes = [sum(len(document) for document in row if document is not None) for row in stored]
    assert sizes[-1] < MOST_BYTES
    with closing(sqlite3.connect(tmp_path / "preload.db")) as database:  # as they were written before
        texts = [[None if each is None else json.dumps(unpacked(each)) for each in row] for row in stored]
        database.executemany(
            "UPDATE measurement_documents SET outcome = ?, response = ? WHERE measurement_id = ?",
            [(*row, number + 1) for number, row in enumerate(texts)],
        )
        database.commit()
    with running_service(tmp_path) as api:
        assert ask(api) == told


@pytest.mark.parametrize("content", [b"", b"\x02", VERSION, VERSION + zstandard.compress(b"[")])
def test_what_is_no_packed_document_is_told_as_such(content: bytes) -> None:
    assert isinstance(unpacked(content), str)
