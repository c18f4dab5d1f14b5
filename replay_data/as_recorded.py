"""Write bundled measurements the way a shop's own acquisition would have: TDMS, CSV and MAT, to try an import on.

``python replay_data/as_recorded.py FOLDER`` writes

* ``day-01.tdms`` … ``day-48.tdms``: a LabVIEW recorder on the machine, every morning of ``slow-wear``: torque sensor in
  V (1.25 V/N·m), nut in g, scale in mm; rate and start are in the file. Each runs on for a third of a second.
* ``logger.csv``: a data logger with a German preamble, semicolons, decimal commas, a row of units and the date and time
  in two columns; the first measurement of ``hidden``.
* ``bench.mat``: MATLAB, a variable for each signal, its unit in its name; the second one of ``hidden``.
"""

import sys
from collections.abc import Sequence
from datetime import UTC
from pathlib import Path

import numpy as np
import scipy.io
from nptdms import ChannelObject, RootObject, TdmsWriter

from monitor_core.recording import Window
from monitor_core.recordings import open_session

BUNDLED = Path(__file__).resolve().parent
GRAVITY = 9.80665  # [m/s²] of one g
TORQUE_SENSOR = 1.25  # [V/(N·m)]


def windows_of(session: str, number: int) -> tuple[Window, ...]:
    """Read one measurement of a bundled session."""
    with open_session(BUNDLED / f"{session}.session.h5") as reader:
        return reader.windows_of(reader.measurements[number])


def one_record(windows: Sequence[Window]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return torque [N·m], acceleration [m/s²] and position [m] of all windows, one behind the other."""
    traces = [window.position_trace for window in windows]
    parts = ([w.excitation for w in windows], [w.response for w in windows], [t for t in traces if t is not None])
    torque, acceleration, position = (np.concatenate(part).astype(np.float64) for part in parts)
    return torque, acceleration, position


def write_tdms(path: Path, windows: Sequence[Window]) -> None:
    """Write a record as LabVIEW does; the recorder was stopped by hand, a third of a second after the last move."""
    torque, acceleration, position = one_record(windows)
    rate = windows[0].sample_rate
    waveform = {
        "wf_increment": 1.0 / rate,
        "wf_start_time": np.datetime64(windows[0].started_at.astimezone(UTC).replace(tzinfo=None), "us"),
        "wf_start_offset": 0.0,
    }
    channels = (
        ("Torque sensor", "V", TORQUE_SENSOR * torque),
        ("Nut axial", "g", acceleration / GRAVITY),
        ("Scale", "mm", 1000.0 * position),
    )
    with TdmsWriter(str(path)) as writer:
        objects = [RootObject({"name": "X axis, morning moves"})]
        for name, unit, samples in channels:
            whole = np.concatenate([samples, samples[: int(rate / 3)]])
            objects.append(ChannelObject("Move", name, whole, {**waveform, "unit_string": unit}))
        writer.write_segment(objects)


def write_csv(path: Path, windows: Sequence[Window]) -> None:
    """Write a record as a data logger does whose language is German."""
    torque, acceleration, position = one_record(windows)
    begin = windows[0].started_at.astimezone(UTC).replace(tzinfo=None)
    offsets = (np.arange(torque.size) / windows[0].sample_rate * 1e6).astype("timedelta64[us]")
    lines = [
        "Messdatenrekorder DL-8;;;;",
        "Anlage;Fräsmaschine 3, X-Achse;;;",
        f"Abtastrate;{windows[0].sample_rate:g} Hz;;;",
        "",
        "Datum;Uhrzeit;Drehmoment;Beschleunigung Mutter;Maßstab",
        ";;Nm;m/s²;mm",
    ]
    columns = zip(np.datetime64(begin, "us") + offsets, torque, acceleration, 1000.0 * position, strict=True)
    for instant, *values in columns:
        date, time = str(instant).split("T")
        numbers = ";".join(f"{value:.6g}" for value in values).replace(".", ",")
        lines.append(f"{'.'.join(reversed(date.split('-')))};{time};{numbers}")
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("latin-1"))


def write_mat(path: Path, windows: Sequence[Window]) -> None:
    """Write a record as MATLAB does, a variable for each signal."""
    torque, acceleration, position = one_record(windows)
    times = np.arange(torque.size) / windows[0].sample_rate
    signals = {"t": times, "torque_Nm": torque, "acc_g": acceleration / GRAVITY, "x_mm": 1000.0 * position}
    scipy.io.savemat(path, signals, oned_as="column")


def main(folder: Path) -> None:
    """Write all files to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with open_session(BUNDLED / "slow-wear.session.h5") as reader:
        for day, measurement in enumerate(reader.measurements, start=1):
            write_tdms(folder / f"day-{day:02d}.tdms", reader.windows_of(measurement))
    write_csv(folder / "logger.csv", windows_of("hidden", 0))
    write_mat(folder / "bench.mat", windows_of("hidden", 1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
