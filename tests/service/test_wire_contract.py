"""The wire is a contract: API and command line are those that other programs were written against.

Anyone who changes it on purpose writes the new contract with ``python -m tests.service.test_wire_contract`` and says so
in the changelog.
"""

import json
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import pytest

from service.app import create_app
from service.cli.main import COMMANDS, EXAMPLES, GROUPS, MODULES, command_named, preload
from service.settings import Settings
from tests.conftest import PROJECT_ROOT

CONTRACT = Path(__file__).parent / "contract"


def api(folder: Path) -> dict[str, Any]:
    described: dict[str, Any] = create_app(Settings(data_dir=folder)).openapi()
    return described


def command_line() -> dict[str, Any]:
    """Return every argument and option of every command, without the words of the help."""
    described = {}
    for name in sorted(COMMANDS):
        command = command_named(name)
        described[name] = [
            {
                "name": parameter.name,
                "kind": parameter.param_type_name,
                "spelled": sorted([*parameter.opts, *parameter.secondary_opts]),
                "type": parameter.type.name,
                "choices": list(getattr(parameter.type, "choices", ())),
                "required": parameter.required,
                "multiple": parameter.multiple,
                "nargs": parameter.nargs,
            }
            for parameter in command.params
        ]
    return described


def written(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False, default=str) + "\n"


def test_the_api_is_the_one_that_programs_were_written_against(tmp_path: Path) -> None:
    assert written(api(tmp_path)) == (CONTRACT / "openapi.json").read_text(encoding="utf-8")


def test_the_command_line_is_the_one_that_scripts_were_written_against() -> None:
    assert written(command_line()) == (CONTRACT / "command_line.json").read_text(encoding="utf-8")


def test_the_list_of_commands_is_complete_and_says_what_each_does() -> None:
    folder = Path(import_module("service.cli").__file__ or "").parent
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__", "main", "options", "output", "targets"}
    assert {MODULES.get(name, name) for name in COMMANDS} == modules
    readme = (PROJECT_ROOT / "README.md").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"`preload {name}`" not in readme] == []
    for name, sentence in COMMANDS.items():
        command = command_named(name)
        first_word = command.get_short_help_str(200).split()[0]
        assert sentence.split()[0] in {first_word, "Tell"}, name


def test_every_command_stands_in_one_group_and_its_help_ends_with_an_example_that_it_takes() -> None:
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(COMMANDS)
    for name, example in EXAMPLES.items():
        command = preload.get_command(click.Context(preload), name)
        assert command is not None
        with command.make_context(name, example.split()[1:], resilient_parsing=True) as context:
            assert command.get_help(context).endswith(f"Example: preload {example}")
            if isinstance(command, click.Group):  # which leaves the rest to the command below it
                below, (word, *rest) = command, example.split()[1:]
                assert isinstance(below, click.Group)
                inner = below.get_command(context, word)
                assert inner is not None
                inner.make_context(word, rest).close()


def test_a_command_that_is_misspelt_is_answered_with_the_one_that_was_meant() -> None:
    with pytest.raises(click.UsageError, match=r"No such command 'expalin'\. Did you mean 'explain'\?"):
        preload.main(["expalin"], standalone_mode=False)


if __name__ == "__main__":
    CONTRACT.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as data:
        (CONTRACT / "openapi.json").write_text(written(api(Path(data))), encoding="utf-8")
    (CONTRACT / "command_line.json").write_text(written(command_line()), encoding="utf-8")
