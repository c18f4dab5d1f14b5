"""Damage done to text files: each is read or refused in one sentence, within 2 s and 1 GiB.

The number of files of a format is that of the environment variable ``PRELOAD_FUZZ`` (30 without it; 2,000 were run).
"""

import json
import os
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.proposal import propose
from tests.conftest import canary
from tests.recordings.text_files import logger_files, lvm, trace_files, twincat

N_FILES = int(os.environ.get("PRELOAD_FUZZ", "30"))
SLOWEST = 2.0  # s of one file
MEMORY = 2**30

_LVM = ({}, {"of_x": "One", "comments": True}, {"of_x": "Multi", "comma": True}, {"n_segments": 3}, {"special": True},
        {"separator": "Comma"})  # fmt: skip
_TWINCAT = ({}, {"separator": ";", "last": ";"}, {"comma": True}, {"full": True}, {"separator": ",", "end_tag": True})
#: Format → ending, and files to damage.
GOOD: dict[str, tuple[str, Callable[[], list[bytes]]]] = {
    "csv": (".csv", lambda: [file.content for file in logger_files().values()]),
    "lvm": (".lvm", lambda: [lvm(**manner)[0] for manner in _LVM]),
    "twincat": (".csv", lambda: [twincat(**manner)[0] for manner in _TWINCAT]),
    "siemens": (".csv", lambda: [file.content for file in trace_files().values()]),
}
TOKENS = (
    b"", b"\t", b";", b",", b".", b'"', b'""', b"-", b"e", b"nan", b"inf", b"1e999", b"0x10", b"1_0", b"\0", b"\xff",
    b"\xfe", b"\r", b"\n", b"\n\n", b"#", b" ", b"\xc2\x85", b"\xe2\x80\xa8", b"\x1b[31m", b"9" * 400, b"*** ", b"EOF",
    b"Name", b"X_Value", b"999999999", b"-1", b"0", b"\x1f", b"\xef\xbb\xbf", "１".encode(),
)  # fmt: skip


def peak_mib() -> int:
    """Return the most memory of this process; ``ru_maxrss`` would begin with that of the process that started it."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) // 1024


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Return a file with one to eight faults of the kinds that disks, editors and programs make."""
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        at = rng.randrange(max(min(len(content), 900 if rng.random() < 0.5 else len(content)), 1))
        lines = content.split(b"\n")
        kind = rng.randrange(10)
        if kind == 0:
            content = content[:at]
        elif kind == 1:
            content = content[:at] + bytes((rng.randrange(256),)) + content[at + 1 :]
        elif kind in (2, 3):
            content = content[:at] + rng.choice(TOKENS) + content[at + rng.randrange(3) :]
        elif kind == 4:
            del lines[rng.randrange(len(lines))]
            content = b"\n".join(lines)
        elif kind == 5:
            rng.shuffle(lines)
            content = b"\n".join(lines)
        elif kind == 6:
            number = rng.randrange(len(lines))
            lines[number : number + 1] = [lines[number]] * rng.choice((2, 3, 1000))
            content = b"\n".join(lines)
        elif kind == 7:
            old, new = rng.sample((b"\t", b";", b",", b".", b" ", b"\n", b'"'), 2)
            content = content.replace(old, new, rng.choice((1, 5, 1 << 30)))
        elif kind == 8:
            content = content[:at] + rng.choice(TOKENS) * rng.choice((50, 5000, 50_000)) + content[at:]
        else:
            other = rng.randrange(len(content) + 1)
            content = content[:at] + content[min(at, other) : max(at, other)] + content[at:]
    return content[:3_000_000]


@pytest.mark.parametrize("case", canary(GOOD))
def test_damaged_texts_are_read_or_refused_in_one_sentence(tmp_path, case):
    ending, files = GOOD[case]
    rng = random.Random(case)  # noqa: S311  # seeded, so that a failure comes back
    good = files()
    for number in range(N_FILES):
        (tmp_path / f"{number:05d}{ending}").write_bytes(damaged(rng.choice(good), rng))
    run = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.recordings.test_text_fuzz", str(tmp_path)],
        cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=60 + 2 * N_FILES, check=False,
    )  # fmt: skip
    assert run.returncode == 0, f"last file {run.stdout.splitlines()[-1:]}: {run.stderr[-2000:]}"
    outcome = json.loads(run.stdout.splitlines()[-1])
    assert outcome["read"] + outcome["refused"] == 2 * N_FILES
    assert outcome["refused"] > N_FILES // 10  # damage was done
    assert outcome["lines"] == 1  # one sentence
    assert outcome["slowest_s"] < SLOWEST
    if "PRELOAD_FUZZ" in os.environ:
        sys.stderr.write(f"\n{case}: {json.dumps(outcome)}\n")


def _layouts(path: Path, rng: random.Random) -> TextLayout | None:
    """Return the layout that is proposed, or one that fits by chance."""
    try:
        proposed = proposal.layout if (proposal := propose(path)).reasons else None
    except RecordingFormatError as error:
        proposed = None
        if len(str(error).splitlines()) != 1:
            raise AssertionError(str(error)) from error
    if proposed is not None and rng.random() < 0.8:
        return TextLayout.from_fields(Fields(proposed.entries(), "map.toml [text]"))
    return TextLayout(rng.choice(("tab", "semicolon", "comma", "blank")), rng.choice(("point", "comma")),
                      rng.choice((0, 1, 2)), comment=rng.choice((None, "#")),
                      encoding=rng.choice(("utf-8", "latin-1", "utf-16")))  # fmt: skip


def _read_all(folder: Path) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    rng = random.Random(0)  # noqa: S311
    outcome = {"read": 0, "refused": 0, "slowest_s": 0.0, "lines": 0, "most_mib": 0}
    for path in sorted(folder.iterdir()):
        print(path.name, flush=True)
        for plain in (True, False):
            begin = time.process_time()
            try:
                read_channels(path, None if plain or path.suffix == ".lvm" else _layouts(path, rng))
                outcome["read"] += 1
            except RecordingFormatError as error:
                outcome["refused"] += 1
                message = str(error)
                assert len(message) < 2000, message[:100]
                assert all(letter.isprintable() for letter in message), message
                outcome["lines"] = max(outcome["lines"], len(message.splitlines()))
            outcome["slowest_s"] = max(outcome["slowest_s"], time.process_time() - begin)
    outcome["most_mib"] = peak_mib()
    print(json.dumps(outcome))


if __name__ == "__main__":
    _read_all(Path(sys.argv[1]))
