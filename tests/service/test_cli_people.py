"""``preload user`` and ``preload key``: people and keys of a service, from the command line."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from service.cli.main import command_named
from service.errors import ConflictError, InvalidRequestError, UnknownResourceError

PASSWORD = "correct horse battery\n"  # noqa: S105 - of nobody


def run(folder: Path, command: str, *words: str, given: str = "") -> Result:
    return CliRunner().invoke(
        command_named(command), [*words, "--data-dir", str(folder)], input=given, catch_exceptions=False
    )


def test_people_are_made_changed_and_listed(tmp_path: Path) -> None:
    for name, role in {"anna": "administrator", "berta": "viewer"}.items():
        made = run(tmp_path, "user", "add", name, "--role", role, "--password-stdin", given=PASSWORD)
        assert made.output == f"{name} is {role} now\n"
    run(tmp_path, "user", "role", "berta", "operator")
    run(tmp_path, "user", "password", "berta", "--password-stdin", given=PASSWORD)
    run(tmp_path, "user", "disable", "berta")
    assert json.loads(run(tmp_path, "user", "list", "--json").output) == {
        "users": [
            {"name": "anna", "role": "administrator", "disabled": False},
            {"name": "berta", "role": "operator", "disabled": True},
        ]
    }
    assert run(tmp_path, "user", "list").output == "anna: administrator\nberta: operator, disabled\n"


def test_what_cannot_be_is_said_in_a_sentence(tmp_path: Path) -> None:
    run(tmp_path, "user", "add", "anna", "--role", "administrator", "--password-stdin", given=PASSWORD)
    with pytest.raises(ConflictError, match="there is a user 'anna' already"):
        run(tmp_path, "user", "add", "anna", "--role", "viewer", "--password-stdin", given=PASSWORD)
    with pytest.raises(InvalidRequestError, match="10 to 200 characters; got 5"):
        run(tmp_path, "user", "add", "berta", "--role", "viewer", "--password-stdin", given="short\n")
    with pytest.raises(UnknownResourceError, match="there is no user 'carl'"):
        run(tmp_path, "user", "disable", "carl")
    with pytest.raises(UnknownResourceError, match="there is no user 'carl'"):
        run(tmp_path, "user", "unlock", "carl")
    with pytest.raises(UnknownResourceError, match="there is no key 7"):
        run(tmp_path, "key", "revoke", "7")
    with pytest.raises(UnknownResourceError):
        run(tmp_path, "key", "add", "daq", "--scope", "windows:write", "--axis", "nowhere")


def test_a_key_is_shown_once_and_listed_without_its_secret(tmp_path: Path) -> None:
    made = run(tmp_path, "key", "add", "daq", "--scope", "windows:write", "--scope", "trends:read", "--days", "10")
    secret = made.stdout.strip()
    assert secret.startswith("preload_")
    run(tmp_path, "key", "add", "old", "--scope", "admin", "--never-expires")
    run(tmp_path, "key", "revoke", "2")
    listed = run(tmp_path, "key", "list", "--json").output
    assert secret not in listed
    first, second = json.loads(listed)["keys"]
    assert (first["name"], first["scopes"], first["axes"]) == ("daq", ["trends:read", "windows:write"], None)
    assert (first["revoked"], first["last_used_at"]) == (False, None)
    assert (second["revoked"], second["expires_at"]) == (True, None)
    assert "2 old: admin; all axes; revoked; never used" in run(tmp_path, "key", "list").output
