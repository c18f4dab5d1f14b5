"""What a command is to write is checked before it works: a refusal comes at once, and nothing was computed."""

import itertools
from pathlib import Path
from typing import Any

import h5py
import pytest

import service.cli.calibrate
import service.cli.explain
import service.cli.identify
import service.cli.modes
import service.cli.simulate
from tests.service.test_cli import assert_refused

MODELS = Path(__file__).parents[2] / "replay_data" / "models"
MODEL = MODELS / "replay-axis.toml"

#: Each command up to the option that names what it writes, and the ending of that.
COMMANDS = {
    "calibrate": (("calibrate", "axis.session.h5", "--out"), ".json"),
    "calibrate-table": (("calibrate", "modes.csv", "--out"), ".json"),
    "identify": (("identify", "axis.session.h5", "--model", MODEL, "--out"), ".toml"),
    "identify-calibration": (
        (
            "identify", "axis.session.h5", "--model", MODEL, "--prediction", "mode_hz = [100, 200], preload_n = 300, "
            "preload_standard_uncertainty_n = 30, scatter_hz = 0.1", "--calibration",
        ),
        ".json",
    ),
    "explain": (("explain", "axis.session.h5", "--baseline", MODEL, "--out"), ".toml"),
    "simulate": (("simulate", MODEL, "--out"), ".h5"),
    "modes": (("modes", MODEL, "--position-mm", 500, "--show", "state-space", "--out"), ".mat"),
}  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in a folder with data that no command may open: whatever reads or computes them fails the test."""

    def work(*_: object, **__: object) -> None:
        raise AssertionError("worked before it had looked at what it is to write")

    for module, names in {
        service.cli.calibrate: ("opened_session", "read_modal_table", "calibrate_judged", "fit_calibration"),
        service.cli.identify: ("responses_of_data", "read_modal_table", "identify_joints"),
        service.cli.explain: ("responses_of_data", "read_modal_table", "explain_axis"),
        service.cli.simulate: ("described_model", "simulate_measurements"),
        service.cli.modes: ("built_model",),
    }.items():
        for name in names:
            monkeypatch.setattr(module, name, work)
    with h5py.File(tmp_path / "axis.session.h5", "w") as file:  # enough to be told as one
        file.attrs.update({"format": "preload-session", "version": 1, "axis_id": "axis"})
    (tmp_path / "modes.csv").write_bytes(b"position_mm,frequency_hz\n")
    (tmp_path / "a-file").write_bytes(b"")
    for ending in (".json", ".toml", ".h5", ".mat"):
        (tmp_path / f"a-folder{ending}").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_target_that_cannot_be_written_is_refused_before_any_work(
    preload: Any, folder: Path, subtests: pytest.Subtests
) -> None:
    for command, (target, complaint) in itertools.product(
        COMMANDS,
        [
            ("nowhere/out{}", "folder nowhere does not exist"),
            ("a-file/out{}", "folder a-file is no folder"),
            ("a-folder{}", "is a directory"),
            ("out.csv", "ends in {}"),
            ("n" * 300 + "{}", "name too long"),
        ],
    ):
        with subtests.test(command=command, target=target):
            words, ending = COMMANDS[command]
            there = sorted(folder.rglob("*"))
            answer = preload(*words, target.format(ending))
            assert_refused(answer, "")
            assert complaint.format(ending) in answer.err.lower() or complaint.format(ending) in answer.err
            assert sorted(folder.rglob("*")) == there


@pytest.mark.parametrize("command", COMMANDS)
def test_a_place_that_lets_nobody_write_is_refused_before_any_work(preload: Any, command: str) -> None:
    words, ending = COMMANDS[command]
    assert_refused(preload(*words, f"/proc/out{ending}"), f"cannot write out{ending}")  # not even root can


@pytest.mark.parametrize("target", ["a-file/report", "/proc/report", "a-file"])
def test_a_report_that_cannot_be_written_is_refused_before_any_work(preload: Any, folder: Path, target: str) -> None:
    there = sorted(folder.rglob("*"))
    assert_refused(preload("explain", "axis.session.h5", "--baseline", MODEL, "--report", target), target)
    assert sorted(folder.rglob("*")) == there


def test_what_is_read_is_not_replaced(preload: Any, folder: Path) -> None:
    for name, words in {
        "modes.json": ("calibrate", "modes.json", "--out", "modes.json"),
        "prior.json": ("calibrate", "modes.csv", "--prior", "prior.json", "--out", "./prior.json"),
        "axis.toml": ("explain", "axis.toml", "--baseline", MODEL, "--out", "axis.toml"),
    }.items():
        (folder / name).write_bytes(b"data")
        assert_refused(preload(*words), "would be lost")
        assert (folder / name).read_bytes() == b"data"


def test_a_target_that_is_there_keeps_its_bytes_when_the_work_fails(preload: Any, folder: Path) -> None:
    (folder / "found.json").write_bytes(b"of yesterday")
    with pytest.raises(AssertionError, match="worked before"):  # the check passed, and the work began
        preload("calibrate", "axis.session.h5", "--out", "found.json")
    assert (folder / "found.json").read_bytes() == b"of yesterday"


def test_identify_writes_no_two_things_into_one_file(preload: Any) -> None:
    words = (*COMMANDS["identify-calibration"][0], "found", "--out", "found")
    assert_refused(preload(*words), "write to one file")


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("calibrate", "axis.session.h5", "--excitation-source", "drive"), "--excitation-source goes with a modal"),
        (("calibrate", "modes.csv", "--band-hz", 100, 200), "--band-hz goes with a session; got modes.csv"),
        (("calibrate", "axis.session.h5", "--prior", "none.json"), "none.json: expected a file"),
        (("identify", "axis.session.h5", "--model", "none.toml"), "none.toml: expected a file"),
        (("explain", "axis.session.h5", "--baseline", "none.toml"), "none.toml: expected a file"),
        (("explain", "axis.session.h5", "--baseline", MODEL, "--effects", "none.py"), "none.py: expected a file"),
    ],
)
def test_options_are_checked_before_any_work(preload: Any, words: tuple[Any, ...], complaint: str) -> None:
    assert_refused(preload(*words), complaint)
