"""Every refusal is a problem document with one clear sentence, and changes nothing."""
# ruff: noqa: E501 - the tables read better with one case a line

import json
import socket
from typing import Any

import msgpack
import numpy as np
import pytest
from pydantic import ValidationError

from service.cli.remote.client import window_document
from service.errors import STATUS_OF_ERROR, ServiceError, first_refusal, status_of
from service.operations.monitoring.axis_configuration import AxisConfiguration
from tests.service.conftest import Api, assert_problem, running_service, simulated_measurement
from tests.service.test_ingest import as_base64, as_lists

MSGPACK = {"content-type": "application/msgpack"}
JSON = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def axis(shared_api: Api) -> str:
    shared_api.register("axis")
    return "axis"


def window_json() -> dict[str, Any]:
    (window,) = simulated_measurement(np.random.default_rng(1), "m", n_windows=1)
    return as_lists(window_document(window))


def changed(**fields: Any) -> dict[str, Any]:
    return window_json() | fields


BAD_WINDOWS: dict[str, tuple[dict[str, Any], str, str]] = {
    "no fields": ({}, "/started_at", "Field required"),
    "unknown field": (changed(colour="red"), "/colour", "Extra inputs are not permitted"),
    "time without zone": (changed(started_at="2026-03-02T06:00:00"), "/started_at", "RFC 3339"),
    "unix time": (changed(started_at=1772431200), "/started_at", "RFC 3339"),
    "date alone": (changed(started_at="2026-03-02"), "/started_at", "RFC 3339"),
    "time before all conversions": (changed(started_at="0001-01-01T00:00:00+14:00"), "/started_at", "from 1970"),
    "time after all conversions": (changed(started_at="9999-12-31T23:59:59-14:00"), "/started_at", "from 1970"),
    "negative rate": (changed(sample_rate_hz=-1.0), "/sample_rate_hz", "greater than or equal to 0.001; got -1.0"),
    "number as text": (changed(position_mm="500"), "/position_mm", "valid number; got '500'"),
    "boolean as number": (changed(payload_kg=True), "/payload_kg", "valid number; got True"),
    "unit of another quantity": (changed(excitation_unit="N"), "body", "must be N.m; got N"),
    "undeclared unit": (changed(response_unit="g"), "/response_unit", "'m/s2', 'm/s', 'm', 'rad/s' or 'rad'; got 'g'"),
    "samples of two lengths": (changed(response=[1.0, 2.0]), "body", "excitation (1024); got 2"),
    "no samples": (changed(excitation=[], response=[]), "body", "at least one sample"),
    "null among samples": (changed(response=[1.0, None]), "/response", "got NoneType"),
    "text among samples": (changed(response=["1.0"]), "/response", "got str"),
    "nested samples": (changed(response=[[1.0]]), "/response", "got list"),
    "bool among samples": (changed(response=[True]), "/response", "got bool"),
    "number beyond float64": (changed(response=[10**400]), "/response", "range of float64"),
    "no base64": (changed(response="!!!"), "/response", "base64"),
    "base64 with an accent": (changed(response="é==="), "/response", "base64"),
    "base64 of 3 bytes": (changed(response="AAAA"), "/response", "multiple of 4 bytes; got 3 bytes"),
    "samples as object": (changed(response={"a": 1}), "/response", "got dict"),
    "control character in a name": (changed(measurement="a\u0000b"), "/measurement", "pattern"),
    "empty list": ({"windows": []}, "/windows", "at least 1 item"),
    "one bad window of two": (
        {"windows": [window_json(), changed(position_mm=1e9)]},
        "/windows/1/position_mm",
        "less than or equal to 100000; got 1000000000.0",
    ),
}


def test_malformed_window_is_named_in_one_sentence(shared_api: Api, axis: str, subtests: pytest.Subtests) -> None:
    for case, (body, pointer, words) in BAD_WINDOWS.items():
        with subtests.test(case=case):
            answer = shared_api.http.post(f"/v1/axes/{axis}/windows", content=json.dumps(body), headers=JSON)
            problem = assert_problem(answer, 422, "invalid-request")
            assert problem["detail"].startswith(pointer + ":")
            assert words in problem["detail"]
            assert problem["errors"][0]["pointer"] == pointer.removeprefix("body")
            assert shared_api.trend(axis) == []
            assert shared_api.axis(axis)["refused_windows"] == {}
            assert not (shared_api.data_dir / "raw").exists()


UNREADABLE: dict[str, tuple[bytes, dict[str, str], int, str, str]] = {
    "cut JSON": (b'{"started_at": ', JSON, 400, "unreadable-body", "not JSON"),
    "NaN literal": (b'{"position_mm": NaN}', JSON, 400, "unreadable-body", "not JSON"),
    "Infinity literal": (b'{"excitation": [Infinity]}', JSON, 400, "unreadable-body", "not JSON"),
    "no UTF-8": (b'{"measurement": "\xff"}', JSON, 400, "unreadable-body", "not JSON"),
    "half a character": (b'{"measurement": "\\ud800"}', JSON, 400, "unreadable-body", "not JSON"),
    "too deep": (b"[" * 100_000, JSON, 400, "unreadable-body", "recursion"),
    "empty body": (b"", JSON, 400, "unreadable-body", "not JSON"),
    "cut msgpack": (msgpack.packb({"a": b"x" * 100})[:20], MSGPACK, 400, "unreadable-body", "not MessagePack"),
    "two msgpack values": (b"\x01\x02", MSGPACK, 400, "unreadable-body", "not MessagePack"),
    "deep msgpack": (b"\x91" * 100_000, MSGPACK, 400, "unreadable-body", "not MessagePack"),
    "msgpack list": (msgpack.packb([1, 2]), MSGPACK, 422, "invalid-request", "dictionary"),
    "msgpack extension": (msgpack.packb(msgpack.ExtType(5, b"x")), MSGPACK, 422, "invalid-request", "dictionary"),
    "JSON number": (b"3", JSON, 422, "invalid-request", "dictionary"),
    "form": (b"a=b", {"content-type": "application/x-www-form-urlencoded"}, 415, "unsupported-content", "got application/x"),
    "csv": (b"1,2", {"content-type": "text/csv"}, 415, "unsupported-content", "got text/csv"),
}  # fmt: skip


def test_unreadable_body_is_refused(shared_api: Api, axis: str, subtests: pytest.Subtests) -> None:
    for case, (content, headers, status, name, words) in UNREADABLE.items():
        with subtests.test(case=case):
            answer = shared_api.http.post(f"/v1/axes/{axis}/windows", content=content, headers=headers)
            assert words in assert_problem(answer, status, name)["detail"]


REFUSED: dict[str, tuple[str, str, Any, int, str, str]] = {
    "unknown route": ("GET", "/v2/axes", None, 404, "unknown-resource", "/v2/axes"),
    "unknown file": ("GET", "/static/none.js", None, 404, "unknown-resource", "/static/none.js"),
    "wrong method": ("DELETE", "/v1/axes/axis", None, 405, "method-not-allowed", "takes GET, PUT; got DELETE"),
    "unknown axis": ("GET", "/v1/axes/nobody", None, 404, "unknown-resource", "PUT /v1/axes/nobody"),
    "windows of an unknown axis": ("POST", "/v1/axes/nobody/windows", window_json(), 404, "unknown-resource", "nobody"),
    "name of an axis": ("PUT", "/v1/axes/a%00b", {"name": "x"}, 422, "invalid-request", "/path/axis"),
    "configuration": ("PUT", "/v1/axes/axis", {"name": "x", "configuration": {"search_band_hz": [230, 140]}}, 422, "invalid-request", "low < high"),
    "unknown setting": ("PUT", "/v1/axes/axis", {"name": "x", "configuration": {"colour": 1}}, 422, "invalid-request", "/configuration/colour"),
    "impossible rate": ("PUT", "/v1/axes/axis", {"name": "x", "configuration": {"false_alarms_per_year": 200}}, 422, "outside-validity", "ask for fewer"),
    "more averages than windows": ("PUT", "/v1/axes/axis", {"name": "x", "configuration": {"minimum_averages": 20}}, 422, "invalid-request", "minimum_averages (20)"),
    "unknown measurement": ("GET", "/v1/axes/axis/measurements/99", None, 404, "unknown-resource", "no measurement 99"),
    "measurement beyond all rows": ("GET", f"/v1/axes/axis/measurements/{10**30}", None, 422, "invalid-request", "/path/measurement"),
    "trend with a slip": ("GET", "/v1/axes/axis/trend?form=2026-03-02T06:00:00Z", None, 422, "invalid-request", "/query/form"),
    "trend without zone": ("GET", "/v1/axes/axis/trend?from=2026-03-02T06:00:00", None, 422, "invalid-request", "/query/from"),
    "trend with a strange cursor": ("GET", "/v1/axes/axis/trend?cursor=abc", None, 400, "unreadable-body", "cursor"),
    "trend without end": ("GET", "/v1/axes/axis/trend?limit=1000000", None, 422, "invalid-request", "10000; got '1000000'"),
    "calibration from nowhere": ("POST", "/v1/axes/axis/calibrations", {}, 422, "invalid-request", "got none"),
    "calibration from nothing": ("POST", "/v1/axes/axis/calibrations", {"measurements": {}}, 422, "not-identifiable", "preload_n"),
    "calibration from three readings": ("POST", "/v1/axes/axis/calibrations", {"readings": [{"position_mm": 1, "preload_n": 1, "frequency_hz": 1}] * 3}, 422, "not-identifiable", "position"),
    "calibration from no readings": ("POST", "/v1/axes/axis/calibrations", {"readings": []}, 422, "invalid-request", "at least 1"),
    "calibration with a foreign prior": ("POST", "/v1/axes/axis/calibrations", {"readings": [{"position_mm": 1, "preload_n": 1, "frequency_hz": 1}], "prior": {"a": 1}}, 422, "recording-format", "format"),
    "calibration from one place": ("POST", "/v1/axes/axis/calibrations", {"readings": [{"position_mm": 1, "preload_n": 1, "frequency_hz": 1}] * 9}, 422, "not-identifiable", "position"),
    "calibration from a foreign document": ("POST", "/v1/axes/axis/calibrations", {"document": {"a": 1}}, 422, "recording-format", "format"),
    "activation of nothing": ("POST", "/v1/axes/axis/calibrations/99/activate", {"reason": "x"}, 404, "unknown-resource", "no calibration 99"),
    "activation without reason": ("POST", "/v1/axes/axis/calibrations/99/activate", {"reason": ""}, 422, "invalid-request", "/reason"),
    "unknown alarm": ("GET", "/v1/alarms/99", None, 404, "unknown-resource", "no alarm 99"),
    "unknown alarm status": ("GET", "/v1/alarms?status=new", None, 422, "invalid-request", "'cleared' or 'withdrawn'; got 'new'"),
    "unknown session": ("POST", "/v1/axes/axis/replays", {"session": "none"}, 404, "unknown-resource", "no recorded session 'none'"),
    "session outside the folder": ("POST", "/v1/axes/axis/replays", {"session": "../../etc/passwd"}, 422, "invalid-request", "/session"),
    "endless speed": ("POST", "/v1/axes/axis/replays", {"session": "x", "speed": 0}, 422, "invalid-request", "/speed"),
    "unknown job": ("GET", "/v1/jobs/00000000-0000-0000-0000-000000000000", None, 404, "unknown-resource", "no job"),
}  # fmt: skip


def test_request_is_refused_in_one_sentence(shared_api: Api, axis: str, subtests: pytest.Subtests) -> None:
    for case, (method, path, body, status, name, words) in REFUSED.items():
        with subtests.test(case=case):
            before = shared_api.axis(axis)
            answer = (
                shared_api.http.request(method, path, json=body)
                if body is not None
                else shared_api.http.request(method, path)
            )
            assert words in assert_problem(answer, status, name)["detail"]
            if status == 405:
                assert answer.headers["allow"] == "GET, PUT"
            assert shared_api.axis(axis) == before


@pytest.mark.parametrize(
    "content", [b'{"name": ', b'{"name": "x", "configuration": {"moving_mass_kg": NaN}}', b"[1]", b"\xff"]
)
def test_bad_json_is_refused_by_other_routes_too(shared_api: Api, axis: str, content: bytes) -> None:
    answer = shared_api.http.put(f"/v1/axes/{axis}", content=content, headers=JSON)
    assert answer.status_code in (400, 422)
    assert_problem(answer, answer.status_code, "unreadable-body" if answer.status_code == 400 else "invalid-request")


@pytest.mark.parametrize("headers", [{}, {"content-type": "text/plain"}, MSGPACK])
def test_other_content_is_refused_by_routes_that_read_json(shared_api: Api, axis: str, headers: dict[str, str]) -> None:
    answer = shared_api.http.put(f"/v1/axes/{axis}", content=b'{"name": "x"}', headers=headers)
    assert "application/json" in assert_problem(answer, 415, "unsupported-content")["detail"]


def test_calibration_document_with_nan_is_refused(shared_api: Api, axis: str) -> None:
    number = shared_api.calibrate(axis)
    document = shared_api.http.get(f"/v1/axes/{axis}/calibrations/{number}").json()["document"]
    document["residual_rms_hz"] = float("nan")
    answer = shared_api.http.post(
        f"/v1/axes/{axis}/calibrations", content=json.dumps({"document": document}), headers=JSON
    )
    assert_problem(answer, 422, "recording-format")


def test_body_beyond_the_limit_is_refused(tmp_path: Any) -> None:
    with running_service(tmp_path, max_body_mib=1) as api:
        api.register("axis")
        large = b"x" * (2**20 + 1)
        for path, method in (("/v1/axes/axis/windows", "POST"), ("/v1/axes/axis", "PUT")):
            problem = assert_problem(api.http.request(method, path, content=large, headers=JSON), 413, "body-too-large")
            assert "1048576 bytes" in problem["detail"]
            pieces = (large[i : i + 4096] for i in range(0, len(large), 4096))  # sent without a stated length
            assert_problem(api.http.request(method, path, content=pieces, headers=JSON), 413, "body-too-large")
        (window,) = simulated_measurement(np.random.default_rng(2), "m", n_windows=1)
        answer = api.http.post("/v1/axes/axis/windows", json=as_base64(window_document(window)))
        assert answer.status_code == 201


def test_slow_sender_that_gives_up_changes_nothing(shared_api: Api, axis: str) -> None:
    host, port = shared_api.http.base_url.host, shared_api.http.base_url.port
    with socket.create_connection((host, port)) as connection:
        connection.sendall(
            b"POST /v1/axes/axis/windows HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\n"
            b"content-length: 1000\r\n\r\n{"
        )
    assert shared_api.http.get("/healthz").status_code == 200
    assert shared_api.trend(axis) == []


def test_table_from_error_to_status() -> None:
    def leaves(kind: type[Exception]) -> list[type[Exception]]:
        return [kind, *(leaf for child in kind.__subclasses__() for leaf in leaves(child))]

    named = {kind for kind, _, _ in STATUS_OF_ERROR}
    assert set(leaves(ServiceError)) - {ServiceError} <= named
    for kind, status, name in STATUS_OF_ERROR:
        assert status_of(kind("x")) == (status, name)
    assert status_of(RuntimeError("x")) == (500, "internal-error")


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"search_band_hz": (230, 140)}, "search_band_hz must be [low, high] with low < high; got [230.0, 140.0]"),
        (
            {"false_alarms_per_year": -1},
            "false_alarms_per_year: Input should be greater than or equal to 0.000001; got -1",
        ),
        ({"machine": "\n"}, "machine: String should match pattern '^[^\\x00-\\x1f\\x7f]+$'; got '\\n'"),
    ],
)
def test_what_a_model_refuses_is_one_sentence(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError) as refused:
        AxisConfiguration(**settings)
    assert first_refusal(refused.value) == sentence
    assert "; got" not in first_refusal(refused.value, shows_input=False).replace("got [230.0, 140.0]", "")
