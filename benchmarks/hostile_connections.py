"""Hostile connections: what honest senders notice while others send slowly or never finish.

``python -m benchmarks.hostile_connections [--rounds 5]`` starts a service, and in turns leaves it to honest senders or
holds 64 slow bodies and 900 half headers open against it, opened again as soon as the service parts from one. Honest
senders (4) post windows one by one; the benchmark reports their p50 and p99 in both, and what they lost.
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgpack
import numpy as np
import psutil

from tests.service.conftest import CONFIGURATION
from tests.service.hostile import window

N_BODIES, N_HEADERS, N_HONEST, N_POSTS = 64, 900, 4, 250
SLOW_BODY = (
    b"POST /v1/axes/a0/windows HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    b"Content-Length: 1000000\r\n\r\n{"
)
HALF_HEADERS = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Long: "


async def _drip(port: int, first: bytes) -> None:
    """Open a connection and send a byte each second; open another one when the service parts from it."""
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(first)
            while not reader.at_eof():
                with suppress(TimeoutError):
                    await asyncio.wait_for(reader.read(1000), 1.0)
                writer.write(b" ")
            writer.close()
        await asyncio.sleep(0.1)


async def _attack(port: int) -> None:
    await asyncio.gather(
        *(_drip(port, SLOW_BODY) for _ in range(N_BODIES)), *(_drip(port, HALF_HEADERS) for _ in range(N_HEADERS))
    )


def attack(port: int) -> None:
    """Hold the connections of an attacker open until this process is ended."""
    asyncio.run(_attack(port))


def honest(port: int, axis: str, round_: int, seconds: list[float], lost: list[str]) -> None:
    """Post windows one by one over one connection and note how long each answer took."""
    rng = np.random.default_rng(round_)
    samples = [rng.standard_normal(8192).astype("<f4").tobytes() for _ in range(2)]
    with socket.create_connection(("127.0.0.1", port)) as connection, connection.makefile("rb") as answers:
        for i in range(N_POSTS):
            number = round_ * N_POSTS + i
            body = msgpack.packb(window(number % 3600, *samples) | {"measurement": f"m{number}"} | _moment(number))
            began = time.perf_counter()
            connection.sendall(
                b"POST /v1/axes/%b/windows HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/msgpack\r\n"
                b"Content-Length: %d\r\n\r\n" % (axis.encode(), len(body)) + body
            )
            status = answers.readline()
            length = 0
            while (line := answers.readline()) != b"\r\n":
                name, _, value = line.partition(b":")
                length = int(value) if name.lower() == b"content-length" else length
            said = json.loads(answers.read(length))
            seconds.append(time.perf_counter() - began)
            if b" 201 " not in status or said["accepted"] != 1:
                lost.append(f"{status!r} {said}")


def _moment(number: int) -> dict[str, object]:
    days, rest = divmod(number, 86400)
    return {"started_at": f"2026-03-{2 + days:02d}T{rest // 3600:02d}:{rest // 60 % 60:02d}:{rest % 60:02d}.000000Z"}


@contextmanager
def service(folder: Path, program: Path | None = None) -> Iterator[tuple[int, psutil.Process]]:
    """Run a service in a process of its own, of this program or of that in a folder; yield its port and the process."""
    command = [sys.executable, "-m", "service.cli.main", "serve", "--port", "0", "--data-dir", str(folder)]
    own = None if program is None else os.environ | {"PYTHONPATH": str(program)}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=program, env=own)
    try:
        assert process.stderr
        address = re.search(r"http://[\w.]+:(\d+)", next(line for line in process.stderr if "dashboard" in line))
        assert address
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield int(address[1]), psutil.Process(process.pid)
    finally:
        process.terminate()
        process.wait()


def register(port: int, axis: str) -> None:
    """Register an axis."""
    body = json.dumps({"name": axis, "configuration": CONFIGURATION | {"sample_rate_hz": None}}).encode()
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(
            b"PUT /v1/axes/%b HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nConnection: close\r\n"
            b"Content-Length: %d\r\n\r\n" % (axis.encode(), len(body)) + body
        )
        assert b" 201 " in connection.makefile("rb").readline()


def turn(port: int, round_: int, lost: list[str]) -> list[float]:
    """Let the honest senders post, and return the seconds of each answer."""
    seconds: list[float] = []
    threads = [threading.Thread(target=honest, args=(port, f"a{i}", round_, seconds, lost)) for i in range(N_HONEST)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return seconds


def main() -> None:
    """Run the rounds and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    lost: list[str] = []
    figures: dict[str, list[float]] = {"quiet": [], "attacked": []}
    with tempfile.TemporaryDirectory() as folder, service(Path(folder)) as (port, process):
        for i in range(N_HONEST):
            register(port, f"a{i}")
        turn(port, 0, lost)
        for round_ in range(1, 2 * rounds + 1, 2):
            figures["quiet"] += turn(port, round_, lost)
            attacker = multiprocessing.get_context("spawn").Process(target=attack, args=(port,), daemon=True)
            attacker.start()
            while process.num_fds() < N_BODIES + N_HEADERS:
                time.sleep(0.1)
            figures["attacked"] += turn(port, round_ + 1, lost)
            attacker.terminate()
            attacker.join()
            while process.num_fds() > N_HEADERS // 2:
                time.sleep(0.1)
        memory = process.memory_info().rss / 2**20
    p99 = {}
    for name, seconds in figures.items():
        p50, p99[name] = np.percentile(seconds, [50, 99])
        print(f"{name:10} {len(seconds)} posts, p50 {1e3 * p50:.1f} ms, p99 {1e3 * p99[name]:.1f} ms")
    print(f"p99 attacked / quiet {p99['attacked'] / p99['quiet']:.2f}; lost {len(lost)}; {memory:.0f} MiB at the end")
    for line in lost[:5]:
        print(line)


if __name__ == "__main__":
    main()
