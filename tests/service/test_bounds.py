"""Whatever number a request holds, it is answered or refused, and soon; nobody who reads keeps anybody waiting."""

import itertools
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator
from datetime import timedelta
from typing import Any

import httpx
import numpy as np
import pytest

from monitor_core.preload import Calibration
from monitor_core.recordings.calibration_file import calibration_document
from monitor_core.recordings.model_file import parse_model
from service.cli.remote.client import window_document
from tests.browser.states import CONFIGURATION, WORN, learn, measure, measurement
from tests.recordings.test_calibration_file import FULL, WITNESSED
from tests.service.conftest import START, Api, readings, running_service, simulated_measurement
from tests.service.sweep import FEW, SWEPT, Description, NumberField, Pointer, numbers_in
from tests.service.test_cli_identify import MODEL
from tests.service.test_identifications import published_peaks
from tests.service.test_ingest import as_lists

AXIS = "swept"
#: What one request may compute: far more than any of them needs [s of processor time].
MOST_CPU_S = 2.0
TEXT, HEAD = MODEL.read_text(encoding="utf-8"), 'family = "receptance"\n[parameters]'
_MEASUREMENTS = itertools.count()
_PREDICTION = {
    "mode_hz": [150.0, 250.0], "preload_n": 300.0, "preload_standard_uncertainty_n": 10.0, "scatter_hz": 0.2
}  # fmt: skip
#: Documents that are taken, where the example of the description is too small to be.
DOCUMENTS: dict[str, Any] = {
    "/v1/axes/{axis}/calibrations": {"readings": [each | {"frequency_std_hz": 0.1} for each in readings()]},
    "/v1/axes/{axis}/identifications": {"model": TEXT, "peaks": published_peaks(), "prediction": _PREDICTION},
    "/v1/axes/{axis}/discrepancies": {"baseline": TEXT, "peaks": published_peaks()},
    "/v1/axes/{axis}/windows": {
        "windows": [as_lists(window_document(measurement(AXIS, 13)[0])) | {"measurement": "swept"}],
        "complete": True,
    },
}


def path_of(field: NumberField, value: float) -> str:
    """Return the path with what there is in it: the first of everything, and the number that is tried."""
    names = dict.fromkeys(("measurement", "alarm", "calibration", "recording", "pin"), "1") | {"axis": AXIS}
    if field.place == "path":
        names[str(field.pointer[0])] = repr(value)
    return field.path.format(**names)


def ask(api: Api, field: NumberField, value: float) -> httpx.Response:
    """Send a request with this number; a job that it begins is cancelled."""
    whole = field.bounds["type"] == "integer" and float(value).is_integer()
    value = int(value) if whole else value
    query = {str(field.pointer[0]): repr(value)} if field.place == "query" else {}
    if field.path == "/v1/axes/{axis}" and field.method == "PUT":
        query["dry_run"] = "true"
    content = None
    if field.method != "GET":
        document = field.with_value(value) if field.place == "body" else {"comment": "swept"}
        content = json.dumps(never_sent(document) if field.path.endswith("/windows") else document)
    answer = api.http.request(
        field.method, path_of(field, value), params=query, content=content, headers={"content-type": "application/json"}
    )
    if answer.status_code == 202:
        api.http.post(f"{answer.headers['location']}/cancel").raise_for_status()
    return answer


def never_sent(document: dict[str, Any]) -> dict[str, Any]:
    """Return windows as they were not sent before, a whole measurement of them."""
    began = START + timedelta(days=1000 + next(_MEASUREMENTS))
    if "windows" not in document:
        return document | {"started_at": began.isoformat()}
    (window,) = document["windows"]
    moments = (began + timedelta(seconds=2 * i) for i in range(4))
    return document | {"windows": [window | {"started_at": moment.isoformat()} for moment in moments]}


def sweep(api: Api, fields: Iterable[NumberField], values: Iterable[float], subtests: pytest.Subtests) -> None:
    """Try the values and the own edges of each field."""
    for field in fields:
        with subtests.test(field.name):
            for value in (*values, *field.edges()):
                began = time.process_time()
                answer = ask(api, field, value)
                took = time.process_time() - began
                assert answer.status_code < 500, (value, answer.text)
                assert took < MOST_CPU_S, (value, answer.text)


def fields_of(api: Api) -> list[NumberField]:
    return list(Description(api.http.get("/openapi.json").json(), DOCUMENTS).fields())


def test_numbers_that_searches_rest_on_are_answered_or_refused(shared_api: Api, subtests: pytest.Subtests) -> None:
    shared_api.register(AXIS, **CONFIGURATION)
    swept = {"false_alarms_per_year", "measurements_per_year", "baseline_size", "screw_length_mm", "to_mm", "highest_n"}
    fields = [field for field in fields_of(shared_api) if field.pointer[-1] in swept]
    assert len(fields) == len(swept)
    sweep(shared_api, fields, FEW, subtests)


@pytest.fixture(scope="module")
def alarmed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """Serve an axis that has all there is to be asked for."""
    with running_service(tmp_path_factory.mktemp("bounds") / "var") as api:
        learn(api, AXIS)
        measure(api, AXIS, range(9, 13), WORN)
        yield api


@pytest.mark.release
def test_every_number_of_every_request_is_answered_or_refused(alarmed: Api, subtests: pytest.Subtests) -> None:
    sweep(alarmed, fields_of(alarmed), SWEPT, subtests)


@pytest.mark.release
def test_the_documents_of_the_sweep_are_taken(alarmed: Api, subtests: pytest.Subtests) -> None:
    """Else a field beside the one that is tried would be refused for it."""
    for path, document in DOCUMENTS.items():
        with subtests.test(path):
            sent = never_sent(document) if path.endswith("/windows") else document
            answer = alarmed.http.post(path.format(axis=AXIS), json=sent)
            assert answer.status_code in (201, 202), answer.text


@pytest.mark.release
def test_numbers_of_a_model_are_answered_or_refused(alarmed: Api, subtests: pytest.Subtests) -> None:
    configured = alarmed.axis(AXIS)["configuration"] | {"search_band_hz": [140.0, 230.0]}
    stated = dict(parse_model(TEXT, "model").parameters)
    for name in stated:
        with subtests.test(name):
            for value in SWEPT:
                text = "\n".join([HEAD, *(f"{key} = {number!r}" for key, number in (stated | {name: value}).items())])
                configuration = configured | {"drive_model": text}
                began = time.process_time()
                answers = [
                    alarmed.http.put(f"/v1/axes/{AXIS}", json={"name": AXIS, "configuration": configuration}),
                    alarmed.http.get(f"/v1/axes/{AXIS}/calibration-plan"),
                ]
                assert all(answer.status_code < 500 for answer in answers), (value, [a.text for a in answers])
                assert time.process_time() - began < MOST_CPU_S, value


# --- numbers of a calibration that is brought ------------------------------------------------------------------------

#: What rests on the newest calibrations of an axis, and on the one in force.
EVIDENCE, MEASURED = "/v1/axes/{axis}/measurements/{first}/evidence", "/v1/axes/{axis}/measurements/{number}"
RESTING = (
    "/v1/axes/{axis}/trend",
    "/v1/axes/{axis}/calibration-plan",
    "/axes/{axis}/measurements/{first}",
    "/axes/{axis}/measurements/{number}",
    "/axes/{axis}/calibrations/{calibration}",
    "/axes/{axis}/calibrate",
    "/axes/{axis}",
)


class Brought:
    """An axis that is measured once, and then by each calibration that it takes."""

    def __init__(self, api: Api, axis: str) -> None:
        self._api, self.axis, self._hours = api, axis, itertools.count()
        api.register(axis, **CONFIGURATION)
        first = self._measure()
        self._names: dict[str, Any] = {"axis": axis, "calibration": None, "first": first, "number": first}

    def _ask(self, method: str, path: str, expected: tuple[int, ...] = (200,), **body: Any) -> httpx.Response:
        began = time.process_time()
        answer = self._api.http.request(method, path.format(**self._names), **body)
        took = time.process_time() - began
        assert answer.status_code in expected, (path, answer.text)
        assert took < MOST_CPU_S, (path, took)
        return answer

    def _measure(self) -> int:
        began = START + timedelta(hours=next(self._hours))
        windows = simulated_measurement(np.random.default_rng(5), f"{began}", started_at=began, n_windows=4)
        (measured,) = self._api.accept(self.axis, windows, complete=True)["measurements"]
        assert "the computation failed" not in str(measured)
        return int(measured["measurement_id"])

    def take(self, document: dict[str, Any]) -> bool:
        """Bring a calibration, put it in force and measure by it; return whether it is taken."""
        brought = self._ask("POST", "/v1/axes/{axis}/calibrations", (201, 422), json={"document": document})
        if brought.status_code == 422:
            return False
        self._names["calibration"] = brought.json()["id"]
        self._ask("POST", "/v1/axes/{axis}/calibrations/{calibration}/activate", json={"reason": "swept"})
        self._names["number"] = self._measure()
        for path in (EVIDENCE, MEASURED):
            self._ask("GET", path)
        return True

    def look(self) -> None:
        """Ask for all else that rests on it."""
        for path in RESTING:
            self._ask("GET", path)


def numbers_of(document: dict[str, Any]) -> Iterator[tuple[Pointer, float]]:
    for pointer, place in numbers_in(document):
        if not ("covariance" in pointer and pointer[-1] < pointer[-2]):  # what is beside its diagonal stands twice
            yield pointer, place[pointer[-1]]


def with_number(document: dict[str, Any], pointer: Pointer, value: float) -> dict[str, Any]:
    """Return a calibration with this number in its place; a covariance stays symmetric."""
    changed = json.loads(json.dumps(document))
    mirrored = (*pointer[:-2], pointer[-1], pointer[-2]) if "covariance" in pointer else pointer
    for *steps, last in (pointer, mirrored):
        place = changed
        for step in steps:
            place = place[step]
        place[last] = value
    return changed


def swept_and_beside(stated: float) -> tuple[float, ...]:
    """Return numbers of every size, and what is near one that is taken."""
    nearest = (math.nextafter(stated, -math.inf), math.nextafter(stated, math.inf))
    edges = (stated - 1, stated + 1) if isinstance(stated, int) else nearest
    return (*SWEPT, -stated, 0.5 * stated, 2.0 * stated, *edges)


def bring_each(
    api: Api, document: dict[str, Any], pointers: Iterable[Pointer], values: Callable[[float], Iterable[float]],
    subtests: pytest.Subtests,
) -> None:  # fmt: skip
    stated = dict(numbers_of(document))
    for number, pointer in enumerate(pointers):
        axis = Brought(api, f"axis{number}")  # each its own: no axis has thousands of calibrations
        assert axis.take(document)
        with subtests.test(".".join(map(str, pointer))):
            for value in values(stated[pointer]):
                axis.take(with_number(document, pointer, value))
            axis.look()


def test_numbers_of_a_calibration_that_is_brought_are_answered_or_refused(
    shared_api: Api, subtests: pytest.Subtests
) -> None:
    document = json.loads(json.dumps(calibration_document(WITNESSED)))
    pointers = [("coefficients", "k3_s2_n13"), ("witnesses", 0, "scatter")]
    bring_each(shared_api, document, pointers, lambda _: FEW, subtests)


@pytest.mark.release
@pytest.mark.parametrize("calibration", [FULL, WITNESSED], ids=["plain", "witnessed"])
def test_every_number_of_a_calibration_that_is_brought_is_answered_or_refused(
    api: Api, calibration: Calibration, subtests: pytest.Subtests
) -> None:
    document = json.loads(json.dumps(calibration_document(calibration)))
    pointers = [pointer for pointer, _ in numbers_of(document)]
    bring_each(api, document, pointers, swept_and_beside, subtests)
