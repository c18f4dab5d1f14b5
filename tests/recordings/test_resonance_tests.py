"""Files as Klipper and LinuxCNC write them, of axes that are simulated, to a frequency in two commands."""

import re
import tomllib

import numpy as np
import pytest
import scipy.signal

from monitor_core.recordings.raw.formats import read_channels
from tests.conftest import PROJECT_ROOT

PAGE = (PROJECT_ROOT / "docs/how-to/resonance-tests.md").read_text(encoding="utf-8")
MAP, MAP_OF_MILL = re.findall(r'```toml title=".*?"\n(.*?)```', PAGE, re.DOTALL)
FREQUENCY, DAMPING = 58.3, 0.06
#: Counts of an ADXL345, as Klipper scales them [mm/s²].
COUNT = 0.003774 * 9806.65


def commanded(stated, times):
    """Acceleration at times since the test began [mm/s²], one quarter of a period after the other, as documented."""
    ends, levels, end, frequency, sign = [], [], 0.0, stated["min_freq"], 1.0
    while frequency <= stated["max_freq"]:
        for direction in (sign, -sign):
            end += 0.25 / frequency
            ends.append(end)
            levels.append(direction * stated["accel_per_hz"] * frequency)
        frequency, sign = frequency + 0.5 / frequency * stated["hz_per_sec"], -sign
    number = np.searchsorted(ends, times, side="right")
    inside = (times >= 0.0) & (number < len(levels))
    period, first = stated["sweeping_period"], np.sqrt(0.125) / 2.0
    turned = (times / period > first).astype(int) + np.clip(
        np.floor(2.0 * (times / period - 2.0 * first - 0.25)) + 1, 0, None
    )
    slow = stated["sweeping_accel"] * np.where(turned % 2 == 0, 1.0, -1.0)
    return np.where(inside, np.append(levels, 0.0)[number] + slow, 0.0), end


def raw_data(path, stated, *, late=0.317, rate=3213.7, noise=300.0):
    """Write what Klipper writes: the printer's time, the table behind a belt that gives, and noise in counts."""
    fine = 16_000.0
    _, lasts = commanded(stated, np.zeros(1))
    times = np.arange(int((lasts + 1.0) * fine)) / fine
    w = 2.0 * np.pi * FREQUENCY
    belt = ([2.0 * DAMPING * w, w * w], [1.0, 2.0 * DAMPING * w, w * w])
    numerator, denominator, _ = scipy.signal.cont2discrete(belt, 1.0 / fine)  # exact for what holds over a step
    table = scipy.signal.lfilter(numerator[0], denominator, commanded(stated, times - late)[0])
    sampled, rng = np.arange(int(times[-1] * rate)) / rate, np.random.default_rng(7)
    seen = np.stack([np.interp(sampled, times, table), np.zeros(sampled.size), np.full(sampled.size, 9806.65)])
    counts = COUNT * np.round((seen + rng.normal(0.0, noise, seen.shape)) / COUNT)
    columns = np.column_stack([812.345678 + sampled, *counts])
    np.savetxt(path, columns, "%.6f", ",", header="time,accel_x,accel_y,accel_z", comments="#")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("klipper")
    (folder / "printer-x.toml").write_text(MAP, encoding="utf-8")
    raw_data(folder / "raw_data_x.csv", tomllib.loads(MAP)["excitation"]["sweep"])
    return folder


def test_what_klipper_writes_states_its_units_and_its_clock(folder):
    time, *accelerations = read_channels(folder / "raw_data_x.csv").channels
    assert (time.name, time.unit) == ("time", "s")
    assert [(c.name, c.unit, c.time.clock) for c in accelerations] == [
        (f"accel_{axis}", "mm/s2", "time") for axis in "xyz"
    ]


def found_by_the_page(preload, name):
    """Run the two commands that the page has for a file, in the folder of this process."""
    commands = re.findall(rf"^\$ \.venv/bin/preload (.*{re.escape(name)}.*)$", PAGE, re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        answer = preload(*command.split(), "--json")
        assert answer.exit_code == 0, answer.err
    (found,) = answer.json()["measurements"]
    return found, answer.err


def test_a_resonance_test_gives_the_frequency_of_the_axis_in_two_commands(folder, preload, monkeypatch):
    monkeypatch.chdir(folder)
    found, _ = found_by_the_page(preload, "raw_data_x.csv")
    assert found["frequency_hz"] == pytest.approx(FREQUENCY, abs=4.0 * found["frequency_standard_uncertainty_hz"])
    assert found["frequency_standard_uncertainty_hz"] < 0.01
    assert found["damping_ratio"] == pytest.approx(DAMPING, rel=0.02)


def test_settings_of_another_test_are_refused(folder, preload):
    wrong = {
        "hz_per_sec = 2": ("hz_per_sec = 1", "expected one test without a break, which lasts"),
        "accel_per_hz = 60": ("accel_per_hz = 130", "expected an axis that follows the map"),
        "sweeping_period = 1.2": ("sweeping_period = 1e-7", "expected a sweeping_period of at least"),
        'channel = "accel_x"': ('channel = "accel_y"', "expected an axis that follows the map"),
    }
    for stated, (other, sentence) in wrong.items():
        assert stated in MAP
        (folder / "wrong.toml").write_text(MAP.replace(stated, other), encoding="utf-8")
        answer = preload("frf", folder / "raw_data_x.csv", "--map", folder / "wrong.toml")
        assert (answer.exit_code, sentence in answer.err) == (2, True), (other, answer.err)


def test_samples_of_a_hal_give_the_frequency_and_no_window_crosses_an_overrun(tmp_path, preload, monkeypatch):
    """What halsampler prints: the number and the pins, a blank behind each, and "overrun" where the numbers leap."""
    rate, n, lost, rng = 1000.0, 60_000, range(20_000, 20_373), np.random.default_rng(0)
    w = 2.0 * np.pi * 87.3
    axis = ([9.0, 0.0, 0.0], [1.0, 2.0 * 0.018 * w, w * w])
    numerator, denominator, _ = scipy.signal.cont2discrete(axis, 1.0 / rate)
    torque = 0.4 * rng.normal(size=n)
    acceleration = scipy.signal.lfilter(numerator[0], denominator, torque) + 0.3 * rng.normal(size=n)
    position = 250.0 + 1e-5 * np.cumsum(rng.normal(size=n))
    rows = [f"{i} {torque[i]:f} {acceleration[i]:f} {position[i]:f} \n" for i in range(n) if i not in lost]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "axis-x.toml").write_text(MAP_OF_MILL, encoding="utf-8")
    for mark in ("overrun\n", ""):
        content = "".join(rows[: lost.start]) + mark + "".join(rows[lost.start :])
        (tmp_path / "axis-x.txt").write_text(content, encoding="utf-8")
        found, said = found_by_the_page(preload, "axis-x.txt")
        assert found["frequency_hz"] == pytest.approx(87.3, abs=4.0 * found["frequency_standard_uncertainty_hz"])
        assert found["frequency_standard_uncertainty_hz"] < 0.05
        assert "samples are missing behind sample 19999" in said
        assert found["n_averages"] <= 20_000 // 2048 + (n - lost.stop) // 2048
    (tmp_path / "without.toml").write_text(
        MAP_OF_MILL.replace('[time]\nchannel = "1"\nsample_rate_hz = 1000', "").replace(
            "[window]", "[window]\nsample_rate_hz = 1000"
        ),
        encoding="utf-8",
    )
    answer = preload("frf", "axis-x.txt", "--map", "without.toml")
    assert "'1' numbers them, and leaps by 374 behind sample 19999" in answer.err
