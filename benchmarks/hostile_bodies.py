"""Hostile bodies: the memory that the largest bodies take in each encoding.

``python -m benchmarks.hostile_bodies [--mib 63]`` starts a service of its own for each body, posts it once, and reports
the status and the peak of memory above that of the idle service, as a multiple of the body.
"""

import argparse
import http.client
import json
import re
import tempfile
from pathlib import Path

from benchmarks.hostile_connections import service
from tests.service.conftest import CONFIGURATION
from tests.service.hostile import JSON, bodies


def memory(process: int, name: str) -> int:
    """Return a figure of a process in bytes: VmRSS, or VmHWM, its peak."""
    found = re.search(rf"{name}:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    assert found
    return int(found[1]) * 1024


def post(content_type: str, body: bytes) -> tuple[int, str, int]:
    """Post a body to a service of its own and return the status, what was said, and the bytes that it took."""
    with tempfile.TemporaryDirectory() as folder, service(Path(folder)) as (port, process):
        connection = http.client.HTTPConnection(f"127.0.0.1:{port}", timeout=300)
        configuration = json.dumps({"name": "a", "configuration": CONFIGURATION | {"sample_rate_hz": None}})
        connection.request("PUT", "/v1/axes/a", configuration, {"Content-Type": JSON})
        connection.getresponse().read()
        before = memory(process.pid, "VmRSS")
        Path(f"/proc/{process.pid}/clear_refs").write_text("5")  # the peak from here on
        connection.request("POST", "/v1/axes/a/windows", body, {"Content-Type": content_type})
        answer = connection.getresponse()
        said = answer.read().decode()
        connection.close()
        return answer.status, said, memory(process.pid, "VmHWM") - before


def main() -> None:
    """Post each body and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mib", type=int, default=63)
    n_bytes = parser.parse_args().mib * 2**20
    print(f"{'body':30} {'MiB':>6} {'status':>6} {'peak, MiB':>10} {'× body':>7}")
    for name, (content_type, body) in bodies(n_bytes).items():
        status, said, peak = post(content_type, body)
        print(f"{name:30} {len(body) / 2**20:6.1f} {status:6} {peak / 2**20:10.1f} {peak / len(body):7.2f}", flush=True)
        if status >= 400:
            print(f"    {json.loads(said)['detail'][:110]}")


if __name__ == "__main__":
    main()
