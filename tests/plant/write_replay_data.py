"""Write ``replay_data/`` again: ``python -m tests.plant.write_replay_data``."""

import hashlib
import sys
import time
from pathlib import Path

from tests.plant.recorder import write_session
from tests.plant.scenarios import AXIS_ID, all_scenarios, record

REPLAY_DATA = Path(__file__).resolve().parents[2] / "replay_data"


def main() -> None:
    """Write every session and the checksums, one line of progress for each."""
    scenarios = all_scenarios()
    for number, scenario in enumerate(scenarios, start=1):
        begin = time.perf_counter()
        windows = record(scenario)
        path = REPLAY_DATA / f"{scenario.key}.session.h5"
        write_session(path, AXIS_ID, scenario.description, windows[-1].started_at, windows)
        sys.stderr.write(
            f"[{number}/{len(scenarios)}] {path.name}: {len(windows)} windows, "
            f"{path.stat().st_size / 1e6:.2f} MB, {time.perf_counter() - begin:.1f} s\n"
        )
    (REPLAY_DATA / "SHA256SUMS").write_text(checksums(REPLAY_DATA))


def checksums(folder: Path) -> str:
    """Return the checksums of all sessions, tables, model files and responses, as ``sha256sum -c`` reads them."""
    patterns = ("*.session.h5", "published/*.csv", "models/*", "hidden-effect/*")
    files = sorted(file for pattern in patterns for file in folder.glob(pattern))
    return "".join(f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(folder).as_posix()}\n" for f in files)


if __name__ == "__main__":
    main()
