"""``preload import`` and commands that take raw files with their map: the same answers as from the session."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.recording import Session
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.frf_set import read_frf_set
from monitor_core.recordings.session_hdf5 import write_session
from tests.service.conftest import START, Api, simulated_measurement

PRELOADS = (150.0, 250.0, 350.0)


def answer_of(run: Any, *words: object) -> Any:
    return run(*words, "--json").json()


def sentence_of(run: Any, *words: object) -> str:
    code, out, err = run(*words)
    assert (code, out, err.count("\n")) == (2, "", 1), err
    return str(err)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a session of three measurements, the same as raw files with a map, and return the folder."""
    folder = tmp_path_factory.mktemp("recorded")
    rng = np.random.default_rng(1)
    windows, lines = [], []
    for number, force in enumerate(PRELOADS):
        started_at = START + timedelta(hours=number)
        measured = simulated_measurement(rng, f"m{number}", preload=force, n_windows=10, started_at=started_at)
        # evenly spaced in time, as rows of an array are
        conditions = replace(measured[0].conditions, preload=force)
        measured = [
            replace(window, started_at=started_at + timedelta(seconds=20 * i), conditions=conditions)
            for i, window in enumerate(measured)
        ]
        windows += measured
        np.savez(
            folder / f"m{number}.npz",
            torque=np.array([window.excitation for window in measured]),
            acc=np.array([window.response for window in measured]),
        )
        lines += [
            "[[files]]",
            f'name = "m{number}.npz"',
            f"preload_n = {force}",
            f"started_at = {started_at.isoformat()}",
        ]
    first = windows[0]
    text = f"""
axis_id = "axis"
excitation = {{channel = "torque", quantity = "torque", source = "{first.excitation_source}", unit = "N.m"}}
response = {{channel = "acc", unit = "m/s2"}}
[window]
sample_rate_hz = {first.sample_rate}
position_mm = {to_millimetres(first.conditions.position)}
position_span_mm = {to_millimetres(first.position_span)}
windows_in = "rows"
window_interval_s = 20
"""
    for name, value in (("payload_kg", first.conditions.payload_mass), ("temperature_c", first.conditions.temperature)):
        text += "" if value is None else f"{name} = {value}\n"
    (folder / "map.toml").write_text(text + "\n".join(lines) + "\n", encoding="utf-8")
    write_session(folder / "recorded.session.h5", Session("axis", tuple(windows)))
    return folder


def raw(folder: Path) -> list[object]:
    return [*sorted(folder.glob("*.npz")), "--map", folder / "map.toml"]


def test_import_gives_the_session_byte_for_byte(preload: Any, recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "made.session.h5"
    answer = answer_of(preload, "import", *raw(recorded), "--out", out)
    assert (answer["written"], answer["windows"], answer["left_out"]) == (str(out), 30, [])
    assert out.read_bytes() == (recorded / "recorded.session.h5").read_bytes()


def test_commands_take_raw_files_with_their_map(preload: Any, recorded: Path, tmp_path: Path) -> None:
    session = recorded / "recorded.session.h5"
    assert answer_of(preload, "frf", *raw(recorded)) == answer_of(preload, "frf", session)
    calibrations = [
        answer_of(preload, "calibrate", *data, "--moving-mass-kg", 20, 1, "--prior", prior)
        for prior in [_prior(preload, tmp_path)]
        for data in (raw(recorded), [session])
    ]
    assert calibrations[0] == calibrations[1]
    estimates = [
        answer_of(preload, "estimate", *data, "--calibration", tmp_path / "prior.json")
        for data in (raw(recorded), [session])
    ]
    assert estimates[0] == estimates[1]


def _prior(run: Any, folder: Path) -> Path:
    table = Path(__file__).parents[2] / "replay_data" / "published" / "nguyen_table2.csv"
    code, _, err = run(
        "calibrate", table, "--excitation-source", "sensor", "--moving-mass-kg", 20, 1, "--out", folder / "prior.json"
    )
    assert code == 0, err
    return folder / "prior.json"


def test_raw_files_are_posted_as_the_session_is(preload: Any, recorded: Path, shared_api: Api) -> None:
    words = ("--url", shared_api.http.base_url, "--axis", "from-raw-files")
    shared_api.register("from-raw-files", windows_per_measurement=10)
    assert answer_of(preload, "replay", *raw(recorded), *words)["windows_posted"] == 30
    again = answer_of(preload, "replay", recorded / "recorded.session.h5", *words)
    assert (again["windows_posted"], again["windows_already_there"]) == (0, 30)


def test_frf_lists_several_modes_of_each_measurement(preload: Any, recorded: Path) -> None:
    for measurement in answer_of(preload, "frf", recorded / "recorded.session.h5", "--modes", 2)["measurements"]:
        found = [mode["frequency_hz"] for mode in measurement["modes"] if not mode["refused"]]
        assert min(abs(frequency - measurement["frequency_hz"]) for frequency in found) < 0.1
        assert found == sorted(found)


def test_what_is_out_of_order_is_said_before_any_file_is_read(preload: Any, recorded: Path, tmp_path: Path) -> None:
    nothing, chart = tmp_path / "nothing.npz", recorded / "map.toml"
    there = tmp_path / "there.session.h5"
    there.write_bytes(b"mine")
    words = ("import", nothing, "--map", chart, "--out")
    assert "already exists; --force replaces it" in sentence_of(preload, *words, there)
    assert "folder" in sentence_of(preload, *words, tmp_path / "no" / "a.session.h5")
    assert "--out ends in .session.h5" in sentence_of(preload, *words, tmp_path / "a.xlsx")
    assert "a.csv would be a motion record" in sentence_of(preload, *words, tmp_path / "a.csv")
    assert "nothing is at this path" in sentence_of(preload, *words, tmp_path / "a.session.h5")
    assert there.read_bytes() == b"mine"


@pytest.mark.parametrize("command", ["frf", "calibrate", "estimate", "replay", "identify", "explain"])
def test_a_raw_file_alone_is_told_what_it_needs(preload: Any, recorded: Path, command: str) -> None:
    options = {
        "estimate": ("--calibration", "c.json"),
        "replay": ("--url", "http://127.0.0.1:9", "--axis", "a"),
        "identify": ("--model", "m.toml"),
        "explain": ("--baseline", "m.toml"),
    }
    sentence = sentence_of(preload, command, recorded / "m0.npz", *options.get(command, ()))
    assert "got a NumPy archive" in sentence
    assert "preload check m0.npz --write-map m0.toml" in sentence
    assert "preload import m0.npz --map m0.toml" in sentence
    several = (recorded / "m0.npz", recorded / "m1.npz", *options.get(command, ()))
    assert "need --map" in sentence_of(preload, command, *several)


def test_a_map_of_another_kind_is_refused(preload: Any, tmp_path: Path) -> None:
    text = (
        '[motion]\nposition = {channel = "x", unit = "m"}\nforce = {channel = "f", unit = "N"}\nsample_rate_hz = 1000\n'
    )
    (tmp_path / "motion.toml").write_text(text, encoding="utf-8")
    sentence = sentence_of(preload, "frf", tmp_path / "a.npz", "--map", tmp_path / "motion.toml")
    assert "motion.toml makes a motion record of raw files; expected" in sentence


def test_frf_lists_the_modes_of_a_set(preload: Any, tmp_path: Path) -> None:
    # Two modes of closed form, 100 Hz of 2 % and 160 Hz of 1 %, as displacement by force.
    f = np.arange(1.0, 400.0, 0.25)
    h = sum(
        1e-9 * fn**2 / (fn**2 - f**2 + 2j * zeta * fn * f) for fn, zeta in ((100.0, 0.02), (160.0, 0.01))
    )  # fmt: skip
    np.savez(tmp_path / "h.npz", f=f, re=np.real(h), im=np.imag(h))
    text = (
        '[frf]\ninput = "force-at-table"\noutput = "displacement-at-table"\nfrequency = {channel = "f", unit = "Hz"}\n'
        'real = {channel = "re", unit = "m/N"}\nimaginary = {channel = "im", unit = "m/N"}\nrelative = 0.01\n'
        "[window]\nposition_mm = 250\npreload_n = 300\n"
    )
    (tmp_path / "h.toml").write_text(text, encoding="utf-8")
    answer = answer_of(preload, "frf", tmp_path / "h.npz", "--map", tmp_path / "h.toml")
    (group,) = answer["responses"]
    assert [mode["frequency_hz"] for mode in group["modes"]] == pytest.approx([100.0, 160.0], rel=1e-6)
    assert [mode["damping_ratio"] for mode in group["modes"]] == pytest.approx([0.02, 0.01], rel=1e-4)
    assert (group["position_mm"], group["preload_n"]) == (250.0, 300.0)
    code, _, err = preload("import", tmp_path / "h.npz", "--map", tmp_path / "h.toml", "--out", tmp_path / "h.frf.h5")
    assert code == 0, err
    np.testing.assert_array_equal(read_frf_set(tmp_path / "h.frf.h5").observations[0].response, h)
    code, out, _ = preload("frf", tmp_path / "h.frf.h5")
    assert code == 0
    assert "160 Hz" in out
