"""``preload batch PLAN --out FOLDER``: many computing commands, by several workers of this machine or of Dask.

A plan has one command a line, as one would type it, without ``preload``; ``#`` begins a remark. Each runs in a process
of its own, so that one that fails or ends leaves the others alone, and each seed is in its command, so that the number
of workers changes no answer. What a command prints, JSON, is stored with its command as ``NNNN.json``.
"""

import hashlib
import json
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click

from service.cli.main import command_named
from service.cli.options import json_option
from service.cli.output import print_json, print_line, print_table, progress_bar
from service.cli.targets import require_target_folder
from service.json_types import JsonObject

#: Commands that read files and compute; the others serve, ask or change something, or have no JSON to keep.
COMPUTING = ("calibrate", "check", "estimate", "explain", "frf", "identify", "modes")
_BLOCK = 2**20


@dataclass(frozen=True, slots=True)
class Task:
    """A command of a plan."""

    number: int  # counted from 1
    words: tuple[str, ...]
    inputs: str  # checksum of the command and of the files it names: another one is another task

    @property
    def line(self) -> str:
        """The command as one types it."""
        return shlex.join(self.words)


@dataclass(frozen=True, slots=True)
class Done:
    """What became of a command: its exit code, and what it printed."""

    exit_code: int
    printed: str
    errors: str


@click.command()
@click.argument("plan", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option(
    "--out", "folder", type=click.Path(path_type=Path, file_okay=False), required=True, metavar="FOLDER",
    help="Where the answers go. Those that are there, of the same command and files, are not computed again.",
)  # fmt: skip
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Commands at one time.")
@click.option(
    "--dask", "scheduler", metavar="ADDRESS",
    help="Address of a Dask scheduler, such as tcp://10.0.0.5:8786: its workers run the commands. They need this "
    "program, and the same files under the same names.",
)  # fmt: skip
@json_option
def batch(plan: Path, folder: Path, workers: int, scheduler: str | None, as_json: bool) -> int:
    """Run the commands of a plan, such as the explanation of many axes; exit 1 if one of them failed."""
    tasks = read_plan(plan)
    require_target_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    left = [task for task in tasks if not _is_done(folder, task)]
    with executor_of(workers, scheduler) as executor, progress_bar() as bar:
        shown = bar.add_task(plan.name, total=len(tasks), completed=len(tasks) - len(left))
        running: dict[Future[Done], Task] = {executor.submit(run, task.words, str(Path.cwd())): task for task in left}
        try:
            for future in as_completed(running):
                _store(folder, running[future], future.result())
                bar.update(shown, advance=1)
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise
    answers = [_stored(folder, task) for task in tasks]
    failed = sum(answer["exit_code"] != 0 for answer in answers)
    if as_json:
        print_json({"n_commands": len(tasks), "n_computed": len(left), "n_failed": failed, "answers": answers})
    else:
        print_table(
            f"{len(tasks)} commands of {plan.name}, {len(tasks) - len(left)} of them answered before",
            ("answer", "command", "ended"),
            [(_name(task), task.line, _ended(answer)) for task, answer in zip(tasks, answers, strict=True)],
        )
        print_line(f"Written: {folder}")
    return 1 if failed else 0


def read_plan(path: Path) -> list[Task]:
    """Return the commands of a plan, each looked at before any is run.

    ``click.UsageError`` names the line that is no computing command, or whose options are not those of its command.
    """
    tasks: list[Task] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            words = shlex.split(line, comments=True)
        except ValueError as error:
            raise click.UsageError(f"{path.name}, line {number}: {error}") from error
        if not words:
            continue
        _require_command(words, f"{path.name}, line {number}")
        words = [*words, *([] if "--json" in words else ["--json"])]
        tasks.append(Task(len(tasks) + 1, tuple(words), _checksum(words)))
    if not tasks:
        raise click.UsageError(f"{path.name}: expected a command a line; got none")
    return tasks


def _require_command(words: Sequence[str], where: str) -> None:
    name, *arguments = words
    if name not in COMPUTING:
        raise click.UsageError(f"{where}: expected one of {', '.join(COMPUTING)}; got {name}")
    if not {"-h", "--help"}.isdisjoint(arguments):
        raise click.UsageError(f"{where}: expected a command that computes; got one that asks for help")
    try:
        command_named(name).make_context(name, list(arguments))
    except click.ClickException as error:
        raise click.UsageError(f"{where}: {error.format_message()}") from error


def _checksum(words: Sequence[str]) -> str:
    total = hashlib.sha256(json.dumps(words).encode())
    for word in words:
        if (path := Path(word)).is_file():
            with path.open("rb") as file:
                while block := file.read(_BLOCK):
                    total.update(block)
    return total.hexdigest()


@contextmanager
def executor_of(workers: int, scheduler: str | None) -> Iterator[Executor]:
    """Yield what runs the commands: so many at one time here, or the workers of a Dask scheduler.

    ``click.UsageError`` if Dask is not installed, or no scheduler answers.
    """
    if scheduler is None:
        with ThreadPoolExecutor(workers) as executor:  # a thread only waits for the process of its command
            yield executor
        return
    try:
        from distributed import Client  # noqa: PLC0415  # an extra
    except ModuleNotFoundError as error:
        raise click.UsageError("--dask needs distributed; pip install distributed") from error
    try:
        client = Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise click.UsageError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client, client.get_executor(pure=False) as executor:
        yield executor


def run(words: Sequence[str], folder: str) -> Done:
    """Run a command in a process of its own, in this folder."""
    command = [sys.executable, "-m", "service.cli.main", *words]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603  # our own
    return Done(ended.returncode, ended.stdout, ended.stderr)


def _name(task: Task) -> str:
    return f"{task.number:04d}.json"


def _is_done(folder: Path, task: Task) -> bool:
    """Tell whether the answer of a task is there; one that failed is tried again."""
    try:
        stored = _stored(folder, task)
    except (OSError, ValueError):
        return False
    return stored.get("inputs") == task.inputs and stored.get("exit_code") == 0


def _stored(folder: Path, task: Task) -> JsonObject:
    stored: JsonObject = json.loads((folder / _name(task)).read_text(encoding="utf-8"))
    return stored


def _store(folder: Path, task: Task, done: Done) -> None:
    """Write an answer beside its place, then move it there: half a file is never an answer."""
    try:
        printed = json.loads(done.printed) if done.printed else None
    except ValueError:
        printed = done.printed
    document = {
        "command": task.line, "inputs": task.inputs, "exit_code": done.exit_code, "answer": printed,
        "errors": done.errors,
    }  # fmt: skip
    unfinished = folder / f".{_name(task)}"
    unfinished.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    unfinished.replace(folder / _name(task))


def _ended(answer: JsonObject) -> str:
    if answer["exit_code"] == 0:
        return "well"
    lines = str(answer["errors"]).strip().splitlines()
    return lines[-1] if lines else f"by itself, exit code {answer['exit_code']}"
