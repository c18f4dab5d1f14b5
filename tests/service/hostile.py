"""Bodies that take as much memory as a body of their size can, in each encoding; honest ones and others."""

import base64
import json
from collections.abc import Callable

import msgpack
import numpy as np

JSON, MSGPACK = "application/json", "application/msgpack"
START = "2026-03-02T06:{:02d}:{:02d}.000000Z"


def window(number: int, excitation: object, response: object) -> dict[str, object]:
    """Return one window on the wire."""
    return {
        "started_at": START.format(number // 60, number % 60), "measurement": "m", "sample_rate_hz": 10_000.0,
        "position_mm": 500.0, "position_span_mm": 1.0, "excitation_unit": "N.m", "excitation_source": "sensor",
        "response_unit": "m/s2", "excitation": excitation, "response": response,
    }  # fmt: skip


def of_windows(
    n_bytes: int, of_one: int, written: Callable[[list[dict[str, object]]], bytes], samples: object
) -> bytes:
    """Return a body of as many windows as fit and may be sent at once."""
    return written([window(i, samples, samples) for i in range(min(1000, n_bytes // (2 * of_one)))])


def bodies(n_bytes: int) -> dict[str, tuple[str, bytes]]:
    """Return the bodies by name, each with its content type."""
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(8192).astype("<f4")
    large = rng.standard_normal(2**20).astype("<f4")
    lists, packed = json.dumps(noise.tolist()), noise.tobytes()
    large_text = base64.b64encode(large).decode()

    def as_json(windows: list[object]) -> bytes:
        return json.dumps({"windows": windows}).encode()

    def as_msgpack(windows: list[object]) -> bytes:
        return msgpack.packb({"windows": windows})

    def one_list(number: str) -> bytes:
        n = (n_bytes - 600) // (2 * len(number))
        body = json.dumps(window(0, "@1", "@2"))
        text = "[" + number * (n - 1) + number.rstrip(",") + "]"
        return body.replace('"@1"', text).replace('"@2"', text).encode()

    def packed_list(element: bytes) -> bytes:
        n = (n_bytes - 600) // (2 * len(element))
        mark = {"excitation": b"@1", "response": b"@2"}
        body = msgpack.packb(window(0, *mark.values()))
        for value in mark.values():
            body = body.replace(msgpack.packb(value), b"\xdd" + n.to_bytes(4) + element * n)
        return body

    text = base64.b64encode(packed).decode()
    return {
        "JSON, base64, many windows": (JSON, of_windows(n_bytes, len(text) + 200, as_json, text)),
        "JSON, base64, large windows": (JSON, of_windows(n_bytes, len(large_text), as_json, large_text)),
        "JSON, lists, many windows": (JSON, of_windows(n_bytes, len(lists) + 200, as_json, noise.tolist())),
        "JSON, list of 0": (JSON, one_list("0,")),
        "JSON, list of 0.1": (JSON, one_list("0.1,")),
        "JSON, lists of 0, 1": (JSON, of_windows(n_bytes, 3 * 2**14, as_json, [0, 1] * 2**13)),
        "JSON, lists of 0.1, 1": (JSON, of_windows(n_bytes, 4 * 2**14, as_json, [0.1, 1] * 2**13)),
        "JSON, list of lists": (JSON, b'{"windows":[' + b"[]," * (n_bytes // 3 - 10) + b"[]]}"),
        "JSON, empty windows": (JSON, b'{"windows":[' + b"{}," * (n_bytes // 3 - 10) + b"{}]}"),
        "JSON, deep": (JSON, b"[" * n_bytes),
        "JSON, long name": (JSON, b'{"' + b"a" * (n_bytes - 10) + b'":1}'),
        "MessagePack, many windows": (MSGPACK, of_windows(n_bytes, len(packed) + 150, as_msgpack, packed)),
        "MessagePack, large windows": (MSGPACK, of_windows(n_bytes, 2**22, as_msgpack, large.tobytes())),
        "MessagePack, list of 0": (MSGPACK, packed_list(b"\x00")),
        "MessagePack, lists of float64": (MSGPACK, of_windows(n_bytes, 9 * 2**16, as_msgpack, [0.1, 1.0] * 2**15)),
        "MessagePack, lists of 0, 1": (MSGPACK, of_windows(n_bytes, 2**16, as_msgpack, [0, 1] * 2**15)),
        "MessagePack, list of lists": (MSGPACK, b"\x81\xa7windows\xdd" + n_bytes.to_bytes(4) + b"\x90" * n_bytes),
        "MessagePack, announced": (MSGPACK, b"\x81\xa7windows\xdd\xff\xff\xff\xff"),
        "MessagePack, text": (MSGPACK, b"\x81\xabmeasurement\xdb" + n_bytes.to_bytes(4) + b"a" * n_bytes),
    }  # fmt: skip
