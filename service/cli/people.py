"""``preload user`` and ``preload key``: who may do what in a service."""

import getpass
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import click

from service.cli.options import data_dir_option, json_option
from service.cli.output import print_json, print_line
from service.clock import text_of
from service.operations.access.people import People
from service.operations.access.scopes import ROLES, Scope
from service.settings import Settings
from service.store.database import Database
from service.store.safekeeping.private import private_folder

SCOPES = [str(scope) for scope in Scope]

_password_stdin = click.option("--password-stdin", is_flag=True, help="Read the password from standard input.")


@contextmanager
def _people(data_dir: Path | None) -> Iterator[People]:
    """Open users and keys of a service, which may be running: it takes note within two seconds."""
    settings = Settings() if data_dir is None else Settings(data_dir=data_dir)
    private_folder(settings.data_dir)
    database = Database(settings.resolved_database_url())
    try:
        database.migrate()
        yield People(database, f"command line ({getpass.getuser()})")
    finally:
        database.close()


def _password(from_stdin: bool) -> str:
    if from_stdin:
        return sys.stdin.readline().rstrip("\n")
    return str(click.prompt("Password", hide_input=True, confirmation_prompt=True))


@click.group()
def user() -> None:
    """Make and change the people who may log in."""


@user.command("add")
@click.argument("name")
@click.option("--role", type=click.Choice(list(ROLES)), required=True, help="What the user may do.")
@_password_stdin
@data_dir_option()
def add_user(name: str, role: str, password_stdin: bool, data_dir: Path | None) -> None:
    """Make a user. With the first administrator nobody else may do anything without a name or a key any more."""
    with _people(data_dir) as people:
        people.add_user(name, role, _password(password_stdin))
    print_line(f"{name} is {role} now")


@user.command("role")
@click.argument("name")
@click.argument("role", type=click.Choice(list(ROLES)))
@data_dir_option()
def set_role(name: str, role: str, data_dir: Path | None) -> None:
    """Give a user another role."""
    with _people(data_dir) as people:
        people.set_role(name, role)
    print_line(f"{name} is {role} now")


@user.command("password")
@click.argument("name")
@_password_stdin
@data_dir_option()
def set_password(name: str, password_stdin: bool, data_dir: Path | None) -> None:
    """Give a user another password; whoever is logged in with the old one no longer is."""
    with _people(data_dir) as people:
        people.set_password(name, _password(password_stdin))
    print_line(f"{name} has another password now")


@user.command("disable")
@click.argument("name")
@data_dir_option()
def disable_user(name: str, data_dir: Path | None) -> None:
    """Let a user log in no more."""
    with _people(data_dir) as people:
        people.disable_user(name)
    print_line(f"{name} cannot log in any more")


@user.command("unlock")
@click.argument("name")
@data_dir_option()
def unlock_user(name: str, data_dir: Path | None) -> None:
    """Let a user log in at once from where too many wrong passwords came."""
    with _people(data_dir) as people:
        people.unlock_user(name)
    print_line(f"{name} may log in again")


@user.command("list")
@data_dir_option()
@json_option
def list_users(data_dir: Path | None, as_json: bool) -> None:
    """List all users."""
    with _people(data_dir) as people:
        users = people.users()
    if as_json:
        documents = [{"name": row.name, "role": row.role, "disabled": row.disabled_at is not None} for row in users]
        print_json({"users": documents})
        return
    for row in users:
        print_line(f"{row.name}: {row.role}" + ("" if row.disabled_at is None else ", disabled"))


@click.group()
def key() -> None:
    """Make and revoke the keys of programs."""


@key.command("add")
@click.argument("name")
@click.option("--scope", "scopes", type=click.Choice(SCOPES), multiple=True, required=True, help="May be repeated.")
@click.option("--axis", "axes", multiple=True, help="For these axes only; may be repeated.")
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="Until it expires.")
@click.option("--never-expires", is_flag=True, help="It holds until it is revoked.")
@data_dir_option()
def add_key(
    name: str, scopes: tuple[str, ...], axes: tuple[str, ...], days: int, never_expires: bool, data_dir: Path | None
) -> None:
    """Make a key and print it, once: only its hash is kept. Programs send it as `Authorization: Bearer KEY`."""
    lasts = None if never_expires else timedelta(days=days)
    with _people(data_dir) as people:
        number, secret = people.add_key(name, frozenset(map(Scope, scopes)), axes or None, lasts)
    print_line(f"key {number} ({name}); it is shown only now:", err=True)
    print_line(secret)


@key.command("revoke")
@click.argument("number", type=int)
@data_dir_option()
def revoke_key(number: int, data_dir: Path | None) -> None:
    """Let a key do nothing any more."""
    with _people(data_dir) as people:
        people.revoke_key(number)
    print_line(f"key {number} is revoked")


@key.command("list")
@data_dir_option()
@json_option
def list_keys(data_dir: Path | None, as_json: bool) -> None:
    """List all keys, with when they were last used."""
    with _people(data_dir) as people:
        rows = people.keys()
    documents = [
        {
            "number": row.id,
            "name": row.name,
            "scopes": row.scopes,
            "axes": row.axes,
            "expires_at": row.expires_at and text_of(row.expires_at),
            "revoked": row.revoked_at is not None,
            "last_used_at": row.last_used_at and text_of(row.last_used_at),
        }
        for row in rows
    ]
    if as_json:
        print_json({"keys": documents})
        return
    for row in rows:
        axes = "all axes" if row.axes is None else ", ".join(row.axes)
        until = "never expires" if row.expires_at is None else f"until {text_of(row.expires_at)}"
        used = "never used" if row.last_used_at is None else f"last used {text_of(row.last_used_at)}"
        state = "revoked" if row.revoked_at is not None else until
        print_line(f"{row.id} {row.name}: {', '.join(row.scopes)}; {axes}; {state}; {used}")
