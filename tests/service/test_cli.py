"""The command line: what each command prints, where, and with which exit code."""

import json
import subprocess
import sys
from dataclasses import fields, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from monitor_core.preload import VarianceShares
from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import read_session, write_session
from service.cli import main as command_line
from service.cli.output import finite_or_null
from tests.conftest import Answer
from tests.service.conftest import START, Api, axial_frequency, simulated_measurement

#: Refit of the paper's Table 2: k in units of 1e-8, residual rms in hertz.
UNWEIGHTED, UNWEIGHTED_RMS = (-4848.6, 5741.6, 1915.2, 1154.6), 0.2215
WEIGHTED = (-4867.5, 5754.2, 1893.7, 1156.0)
K_NAMES = ("k1_s2_per_m2", "k2_s2_per_m", "k3_s2_n13", "k4_s2")


def assert_refused(answer: Answer, words: str) -> None:
    """Bad input: exit 2, one line on standard error, nothing on standard output."""
    assert answer.exit_code == 2
    assert answer.out == ""
    assert answer.err.endswith("\n")
    assert answer.err.count("\n") == 1, answer.err
    assert answer.err.startswith("preload: ")
    assert words in answer.err


REPLAY = Path(__file__).parents[2] / "replay_data"


@pytest.fixture(scope="module")
def table2(request: pytest.FixtureRequest) -> Path:
    return Path(request.getfixturevalue("published_data")) / "nguyen_table2.csv"


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a session: three measurements at known preloads."""
    rng = np.random.default_rng(1)
    windows = []
    for i, preload in enumerate((150.0, 250.0, 350.0)):
        windows += simulated_measurement(
            rng, f"m{i}", preload=preload, n_windows=10, started_at=START + timedelta(hours=i)
        )
    path = tmp_path_factory.mktemp("session") / "short.session.h5"
    write_session(path, Session("axis", tuple(windows)))
    return path


def test_calibrate_on_nguyens_table_unweighted(preload: Any, table2: Path) -> None:
    document = preload("calibrate", table2, "--weighting", "none", "--json").json()
    assert [document["coefficients"][name] * 1e8 for name in K_NAMES] == pytest.approx(UNWEIGHTED, abs=0.1)
    assert document["residual_rms_hz"] == pytest.approx(UNWEIGHTED_RMS, abs=0.0001)
    assert np.array(document["covariance"]).shape == (4, 4)
    assert document["condition_number"] > 1.0
    assert document["minimum_detectable_loss_n"] > 0.0


def test_calibrate_weights_by_the_stated_scatter(preload: Any, table2: Path) -> None:
    document = preload("calibrate", table2, "--json").json()
    assert [document["coefficients"][name] * 1e8 for name in K_NAMES] == pytest.approx(WEIGHTED, abs=0.1)


def test_estimate_gives_the_preloads_of_the_table_back(preload: Any, table2: Path, tmp_path: Path) -> None:
    calibration = tmp_path / "calibration.json"
    printed = preload("calibrate", table2, "--out", calibration)
    assert printed.exit_code == 0
    assert "residual" in printed.out
    estimates = preload("estimate", table2, "--calibration", calibration, "--json").json()["estimates"]
    rows = np.genfromtxt(table2, delimiter=",", names=True)
    assert len(estimates) == len(rows) == 18
    covered = sum(
        low <= truth <= high
        for truth, (low, high) in zip(rows["preload_n"], (e["interval_95_n"] for e in estimates), strict=True)
    )
    assert covered >= 16  # of 18 at 95 %
    assert [e["position_mm"] for e in estimates] == rows["position_mm"].tolist()
    assert all(e["extrapolated"] == bool(e["outside"]) for e in estimates)
    assert preload("estimate", table2, "--calibration", calibration).out.count(" N") >= 36


def test_frf_finds_the_mode_of_each_measurement(preload: Any, session_file: Path) -> None:
    measurements = preload("frf", session_file, "--band-hz", 140, 230, "--json").json()["measurements"]
    assert len(measurements) == 3
    for item, truth in zip(measurements, (150.0, 250.0, 350.0), strict=True):
        # ten windows of one second: some hundredths of a hertz
        assert item["frequency_hz"] == pytest.approx(axial_frequency(truth, 0.5), abs=0.2)
        assert {"position_mm", "damping_ratio", "coherence", "n_averages"} <= set(item)
        assert item["frequency_standard_uncertainty_hz"] < 0.2
    assert "500.0 mm" in preload("frf", session_file, "--band-hz", 140, 230).out


def test_estimate_says_what_frf_says_and_which_windows_were_refused(
    preload: Any, table2: Path, session_file: Path, tmp_path: Path
) -> None:
    calibration = tmp_path / "calibration.json"
    preload("calibrate", table2, "--out", calibration)
    whole = read_session(session_file)
    first, *others = whole.measurements
    spoiled = [replace(w, response=np.zeros(w.n_samples)) for w in whole.windows_of(first)[:2]]
    windows = (*spoiled, *whole.windows_of(first)[2:], *(w for name in others for w in whole.windows_of(name)))
    path = tmp_path / "spoiled.session.h5"
    write_session(path, replace(whole, windows=windows))
    found = preload("frf", path, "--band-hz", 140, 230, "--json").json()["measurements"]
    estimates = preload("estimate", path, "--calibration", calibration, "--json").json()["estimates"]
    table = " ".join(preload("estimate", path, "--calibration", calibration).out.split())
    assert estimates[0]["windows_refused"] == found[0]["windows_refused"] == {"dead-channel": 2}
    assert "dead-channel" in table
    for of_frf, estimate in zip(found, estimates, strict=True):
        assert set(of_frf["warnings"]) <= set(estimate["warnings"])
    for estimate in preload("estimate", table2, "--calibration", calibration, "--json").json()["estimates"]:
        assert estimate["interval_kind"] == "95 % coverage"
        assert sum(estimate["variance_shares"].values()) == pytest.approx(1.0)
        assert set(estimate["variance_shares"]) == {share.name for share in fields(VarianceShares)}


def test_check_tells_each_kind_of_file(preload: Any, table2: Path, session_file: Path, tmp_path: Path) -> None:
    calibration = tmp_path / "calibration.json"
    preload("calibrate", table2, "--out", calibration)
    for path, kind in ((table2, "modal"), (session_file, "session"), (calibration, "calibration")):
        report = preload("check", path, "--json").json()
        assert report["valid"] is True
        assert report["problems"] == []
        assert kind in report["format"]


def cut_short(path: Path, folder: Path) -> Path:
    cut = folder / path.name
    cut.write_bytes(path.read_bytes()[:-1000])
    return cut


def test_check_of_a_damaged_file(preload: Any, session_file: Path, tmp_path: Path) -> None:
    damaged = cut_short(session_file, tmp_path)
    answer = preload("check", damaged, "--json")
    assert answer.exit_code == 2
    report = json.loads(answer.out)
    assert report["valid"] is False
    assert len(report["problems"]) >= 1
    assert answer.err == ""


def test_estimate_joins_measurements_of_one_preload_and_none_that_contradict_each_other(
    preload: Any, table2: Path, session_file: Path, tmp_path: Path
) -> None:
    calibration, path = tmp_path / "calibration.json", tmp_path / "unset.session.h5"
    preload("calibrate", table2, "--out", calibration)
    stated = json.loads(calibration.read_text(encoding="utf-8"))  # a table does not say what excited it
    calibration.write_text(json.dumps(stated | {"excitation_source": "sensor"}), encoding="utf-8")
    whole = read_session(session_file)
    assert preload("estimate", session_file, "--calibration", calibration, "--json").json()["sessions"] == []  # set
    unset = [replace(w, conditions=replace(w.conditions, preload=None)) for w in whole.windows]
    write_session(path, replace(whole, windows=tuple(unset)))
    assert preload("estimate", path, "--calibration", calibration, "--json").json()["sessions"] == []  # 150 to 350 N
    first = [w for w in unset if w.measurement == whole.measurements[0]]
    halves = [replace(w, measurement=f"half {2 * i // len(first)}") for i, w in enumerate(first)]
    write_session(path, replace(whole, windows=tuple(halves)))
    told = preload("estimate", path, "--calibration", calibration, "--json").json()
    (session,) = told["sessions"]
    ends = [e["preload_n"] for e in told["estimates"]]
    assert session["measurements"] == ["half 0", "half 1"]
    assert min(ends) <= session["preload_n"] <= max(ends)
    assert "half 0 to half 1 (2)" in preload("estimate", path, "--calibration", calibration).out


@pytest.mark.parametrize("command", ["frf", "calibrate", "estimate", "replay"])
def test_bad_input_is_one_line(preload: Any, session_file: Path, table2: Path, tmp_path: Path, command: str) -> None:
    calibration = tmp_path / "calibration.json"
    preload("calibrate", table2, "--out", calibration)
    options = {"estimate": ("--calibration", calibration), "replay": ("--url", "http://127.0.0.1:9", "--axis", "a")}
    more = options.get(command, ())
    assert_refused(preload(command, tmp_path / "none.session.h5", *more), "none.session.h5")
    assert_refused(preload(command, cut_short(session_file, tmp_path), *more, "--json"), session_file.name)
    text = tmp_path / "text.session.h5"
    text.write_text("no HDF5\nat all\n")
    assert_refused(preload(command, text, *more), "text.session.h5")


def test_bad_tables_and_calibrations_are_one_line(
    preload: Any, table2: Path, session_file: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "table.csv"
    bad.write_text("position_mm,frequency_hz\n500,abc\n")
    assert_refused(preload("calibrate", bad), "abc")
    bad.write_text("position_mm,frequency_hz,preload_n\n500,176,100\n")
    assert_refused(preload("calibrate", bad), "position")
    assert_refused(preload("calibrate", session_file, "--band-hz", 140, 230), "preload_n")
    calibration = tmp_path / "calibration.json"
    calibration.write_text('{"format": "something else"}')
    assert_refused(preload("estimate", table2, "--calibration", calibration), "format")
    assert_refused(preload("estimate", table2, "--calibration", tmp_path / "none.json"), "none.json")
    assert_refused(preload("calibrate", tmp_path), tmp_path.name)


def test_usage_error_is_one_line(preload: Any, subtests: pytest.Subtests) -> None:
    for words, complaint in [
        (("unknown",), "unknown"),
        (("calibrate",), "DATA"),
        (("calibrate", "x.csv", "--weighting", "guess"), "guess"),
        (("calibrate", "x.csv", "--nonsense"), "--nonsense"),
        (("frf", "x.session.h5", "--band-hz", "230", "140"), "LOW before HIGH"),
        (("replay", "x.session.h5", "--axis", "a"), "--url"),
        (("replay", "x.session.h5", "--axis", "a", "--url", "http://x", "--speed", "0"), "speed"),
        (("serve", "--port", "many"), "many"),
        (("serve", "--port", "70000"), "port"),
    ]:
        with subtests.test(words=words, complaint=complaint):
            assert_refused(preload(*words), complaint)


def test_bad_setting_in_the_environment_is_one_line(preload: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PRELOAD_PORT", "many")
    assert_refused(preload("serve"), "port")


def test_help_and_version(preload: Any) -> None:
    for command in ("demo", "serve", "replay", "frf", "calibrate", "estimate", "check"):
        answer = preload(command, "--help")
        assert answer.exit_code == 0
        assert answer.err == ""
        assert "Usage: preload" in answer.out or f"{command} [OPTIONS]" in answer.out
    assert preload("--version").out.startswith("preload, version")
    assert preload().exit_code == 2


@pytest.mark.release
def test_replay_to_a_running_service_twice(preload: Any, session_file: Path, shared_api: Api) -> None:
    url = str(shared_api.http.base_url)
    shared_api.register("replayed", windows_per_measurement=10)
    shared_api.calibrate("replayed")
    words = ("replay", session_file, "--url", url.removeprefix("http://"), "--axis", "replayed", "--json")
    judged = {"measurements": 3, "measurements_refused": {}}
    assert preload(*words).json() == {
        "windows_posted": 30, "windows_refused": 0, "windows_already_there": 0, **judged
    }  # fmt: skip
    trend = shared_api.trend("replayed")
    for point, truth in zip(trend, (150.0, 250.0, 350.0), strict=True):
        assert point["interval_95_n"][0] < truth < point["interval_95_n"][1]
    assert preload(*words).json() == {
        "windows_posted": 0, "windows_refused": 0, "windows_already_there": 30, **judged
    }  # fmt: skip
    assert shared_api.trend("replayed") == trend


def test_replay_registers_a_new_axis_and_says_so(preload: Any, session_file: Path, shared_api: Api) -> None:
    answer = preload("replay", session_file, "--url", shared_api.http.base_url, "--axis", "brand-new")
    assert answer.exit_code == 0
    assert "was not registered" in answer.err
    assert "windows posted: 30" in answer.out
    assert "measurements: 3, refused: 0" in answer.out
    assert [point["state"] for point in shared_api.trend("brand-new")] == ["learning"] * 3


def test_replay_passes_a_refusal_on_in_one_line(preload: Any, session_file: Path, shared_api: Api) -> None:
    url = shared_api.http.base_url
    assert_refused(preload("replay", session_file, "--url", url, "--axis", "a b"), "422")
    assert_refused(preload("replay", session_file, "--url", f"{url}/nowhere", "--axis", "a"), "404")
    assert_refused(preload("replay", session_file, "--url", "nonsense", "--axis", "a"), "nonsense")
    assert_refused(preload("replay", session_file, "--url", "http://127.0.0.1:9", "--axis", "a"), "no answer")


@pytest.mark.release
@pytest.mark.parametrize(("is_terminal", "said"), [(True, "preload explain: starting\n"), (False, "")])
def test_a_command_that_starts_slowly_says_so_before_it_imports(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], is_terminal: bool, said: str
) -> None:
    """To a person at a terminal; what a program reads stays as it was."""
    before_import = []

    def importing(name: str) -> click.Command:
        before_import.append((name, capsys.readouterr().err))
        return click.Command(name)

    monkeypatch.setattr(command_line, "command_named", importing)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    command_line.preload.get_command(click.Context(command_line.preload), "explain")
    assert before_import == [("explain", said)]


def test_command_is_installed(table2: Path) -> None:
    """As users call it: a process of its own, nothing but JSON on standard output."""
    command = Path(sys.executable).with_name("preload")
    done = subprocess.run([command, "calibrate", table2, "--json"], capture_output=True, check=True, text=True)
    assert json.loads(done.stdout)["n_readings"] == 18
    assert done.stderr == ""


def test_what_is_not_finite_is_printed_as_null() -> None:
    document = {"a": [1.0, float("inf")], "b": {"c": float("nan"), "d": "inf"}, "e": (True, None)}
    assert finite_or_null(document) == {"a": [1.0, None], "b": {"c": None, "d": "inf"}, "e": [True, None]}


def test_a_temperature_that_is_not_stated_widens_and_stating_it_is_said_to_narrow(preload: Any, tmp_path: Path) -> None:
    calibration, session = tmp_path / "calibration.json", read_session(REPLAY / "hidden.session.h5")
    preload("calibrate", REPLAY / "calibration.session.h5", "--out", calibration)
    windows = session.windows_of(session.measurements[0])
    halves = {}
    for row, temperature in (("stated", 22.0), ("not stated", None)):
        path = tmp_path / f"{row}.session.h5"
        of_row = tuple(replace(w, conditions=replace(w.conditions, temperature=temperature)) for w in windows)
        write_session(path, replace(session, windows=of_row))
        (estimate,) = preload("estimate", path, "--calibration", calibration, "--json").json()["estimates"]
        lower, upper = estimate["interval_95_n"]
        halves[row] = (upper - lower) / 2.0
        said = " ".join(preload("estimate", path, "--calibration", calibration).out.split())
        assert ("with the temperature ±" in said) == (temperature is None)
    ((quantities, (lower, upper)),) = [better.values() for better in estimate["if_stated"]]
    assert quantities == ["temperature"]
    assert halves["stated"] < (upper - lower) / 2.0 < halves["not stated"]
