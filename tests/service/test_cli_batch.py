"""``preload batch``: the same answers by one worker, two, and Dask's; what is there is not computed again."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster

from tests.conftest import PROJECT_ROOT
from tests.service.test_cli import assert_refused

REPLAY = PROJECT_ROOT / "replay_data"
PLAN = f"""# four axes
frf {REPLAY}/hidden-effect/mill.frf.h5
identify {REPLAY}/published/tian_modal_table.csv --model {REPLAY}/models/receptance.toml --seed 3
calibrate {REPLAY}/published/nguyen_table2.csv --weighting none   # an axis of the paper
modes {REPLAY}/models/replay-axis.toml --position-mm 500 --preload-n 300
"""


@pytest.fixture
def scheduler() -> Iterator[str]:
    with LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


def answers(folder: Path) -> list[str]:
    return [path.read_text(encoding="utf-8") for path in sorted(folder.iterdir())]


@pytest.mark.release
@pytest.mark.parametrize("lines", [PLAN.splitlines()[3:], PLAN.splitlines()], ids=["quick", "all"])
def test_the_number_of_workers_and_who_they_are_change_no_answer(
    preload: Any, tmp_path: Path, scheduler: str, lines: list[str]
) -> None:
    plan = tmp_path / "plan.txt"
    plan.write_text("\n".join(lines), encoding="utf-8")
    for folder, words in (("one", ()), ("two", ("--workers", "2")), ("dask", ("--dask", scheduler))):
        answer = preload("batch", plan, "--out", tmp_path / folder, *words)
        assert (answer.exit_code, answer.err) == (0, "")
    assert answers(tmp_path / "one") == answers(tmp_path / "two") == answers(tmp_path / "dask")
    first = json.loads(answers(tmp_path / "one")[0])
    assert (first["exit_code"], first["errors"]) == (0, "")
    assert first["command"].split()[0] == next(line for line in lines if not line.startswith("#")).split()[0]
    assert first["answer"]


@pytest.mark.release
def test_what_is_there_is_not_computed_again_unless_a_file_changed(preload: Any, tmp_path: Path) -> None:
    model = tmp_path / "axis.toml"
    model.write_bytes((REPLAY / "models" / "replay-axis.toml").read_bytes())
    (tmp_path / "plan.txt").write_text(
        "".join(f"modes {model} --position-mm {x} --preload-n 300\n" for x in (500, 400))
    )
    told = [preload("batch", tmp_path / "plan.txt", "--out", tmp_path / "out", "--json") for _ in range(2)]
    assert [json.loads(answer.out)["n_computed"] for answer in told] == [2, 0]
    (tmp_path / "out" / "0002.json").write_text("{ half", encoding="utf-8")
    assert (
        json.loads(preload("batch", tmp_path / "plan.txt", "--out", tmp_path / "out", "--json").out)["n_computed"] == 1
    )
    model.write_bytes(model.read_bytes() + b"\n# looked at\n")
    assert (
        json.loads(preload("batch", tmp_path / "plan.txt", "--out", tmp_path / "out", "--json").out)["n_computed"] == 2
    )


def test_a_command_that_fails_leaves_the_others_alone(preload: Any, tmp_path: Path) -> None:
    model = REPLAY / "models" / "replay-axis.toml"
    (tmp_path / "plan.txt").write_text(
        f"modes {tmp_path}/none.toml --position-mm 1\nmodes {model} --position-mm 500 --preload-n 300\n"
    )
    answer = preload("batch", tmp_path / "plan.txt", "--out", tmp_path / "out")
    assert answer.exit_code == 1
    assert "none.toml" in answer.out
    failed, done = (json.loads(text) for text in answers(tmp_path / "out"))
    assert (failed["exit_code"], failed["answer"], done["exit_code"]) == (2, None, 0)
    assert len(failed["errors"].splitlines()) == 1


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("serve", "line 2: expected one of calibrate, check, estimate, explain, frf, identify, modes; got serve"),
        ("modes axis.toml --position-mm", "line 2: Option '--position-mm' requires an argument"),
        ("frf --help", "line 2: expected a command that computes; got one that asks for help"),
        ("frf 'axis", "line 2: No closing quotation"),
    ],
)
def test_a_line_that_cannot_be_run_is_refused_before_any_is(
    preload: Any, tmp_path: Path, line: str, complaint: str
) -> None:
    (tmp_path / "plan.txt").write_text(f"frf {REPLAY}/hidden-effect/mill.frf.h5\n{line}\n")
    answer = preload("batch", tmp_path / "plan.txt", "--out", tmp_path / "out")
    assert_refused(answer, complaint)
    assert not (tmp_path / "out").exists()


def test_an_empty_plan_is_refused(preload: Any, tmp_path: Path) -> None:
    (tmp_path / "empty.txt").write_text("# nothing yet\n")
    assert_refused(preload("batch", tmp_path / "empty.txt", "--out", tmp_path / "out"), "expected a command a line")


@pytest.mark.release
def test_a_scheduler_that_is_not_there_is_refused(preload: Any, tmp_path: Path) -> None:
    plan = tmp_path / "plan.txt"
    plan.write_text(PLAN, encoding="utf-8")
    nowhere = preload("batch", plan, "--out", tmp_path / "out", "--dask", "127.0.0.1:1")
    assert_refused(nowhere, "no Dask scheduler answers at 127.0.0.1:1")
