"""Hostile bodies: the memory that the largest bodies take in each encoding.

``python -m benchmarks.hostile_bodies [--mib 63]`` starts a service of its own for each body, posts it once, and reports
the status and the peak of memory above that of the idle service, as a multiple of the body.
"""

import argparse
import http.client
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.service.conftest import CONFIGURATION
from tests.service.hostile import JSON, bodies


def memory(process: int, name: str) -> int:
    """Return a figure of a process in bytes: VmRSS, or VmHWM, its peak."""
    found = re.search(rf"{name}:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    assert found
    return int(found[1]) * 1024


def post(content_type: str, body: bytes) -> tuple[int, str, int]:
    """Post a body to a service of its own and return the status, what was said, and the bytes that it took."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "service.cli.main", "serve", "--port", "0", "--data-dir", folder]
        service = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            assert service.stderr
            address = re.search(r"http://([\w.]+:\d+)", next(line for line in service.stderr if "dashboard" in line))
            assert address
            http_ = http.client.HTTPConnection(address[1], timeout=300)
            configuration = json.dumps({"name": "a", "configuration": CONFIGURATION | {"sample_rate_hz": None}})
            http_.request("PUT", "/v1/axes/a", configuration, {"Content-Type": JSON})
            http_.getresponse().read()
            before = memory(service.pid, "VmRSS")
            Path(f"/proc/{service.pid}/clear_refs").write_text("5")  # the peak from here on
            http_.request("POST", "/v1/axes/a/windows", body, {"Content-Type": content_type})
            answer = http_.getresponse()
            said = answer.read().decode()
            http_.close()
            return answer.status, said, memory(service.pid, "VmHWM") - before
        finally:
            service.terminate()
            service.wait()


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
