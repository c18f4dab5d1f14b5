"""Make the tables of an empty database, and bring those of an older program to the version of this one."""

from collections.abc import Callable

from sqlalchemy import Connection, insert, inspect, select, update

from service.errors import DataFolderError
from service.store.tables import Base, VersionRow
from service.store.trend import epochs, rollups, sessions  # noqa: F401 - their tables belong to the schema

#: Oldest version that this program opens.
BASELINE = "0017"
#: What follows the baseline: the version that each step leads to, and what it changes, on SQLite and on PostgreSQL.
STEPS: tuple[tuple[str, Callable[[Connection], None]], ...] = (
    ("0018", lambda _: None),  # new documents of measurements are packed, which an older program would not read
)
#: The version that this program writes.
VERSION = STEPS[-1][0]
#: What brings every older schema to the baseline. (The service of that commit would also fold charts again, without the
#: calibration of those of commit 5c78000.)
OPENS_OLDER = "run `preload user list` of commit 7bd100f"


def bring_up_to_date(connection: Connection) -> None:
    """Give a database the schema of this program, in the transaction that is open.

    Raises DataFolderError if the database is of a newer program, or of one older than the baseline.
    """
    if not inspect(connection).has_table(VersionRow.__tablename__):
        _state_conditions(connection.dialect.name)
        Base.metadata.create_all(connection, checkfirst=False)
        connection.execute(insert(VersionRow).values(version_num=VERSION))
        return
    stored = connection.scalar(select(VersionRow.version_num)) or "none"
    _require_reachable(stored)
    for version, change in STEPS:
        if version > stored:
            change(connection)
    if stored != VERSION:
        connection.execute(update(VersionRow).values(version_num=VERSION))


def _state_conditions(dialect: str) -> None:
    """Give partial indexes their condition in this dialect, too: tables that named it would load it at every start."""
    for index in (index for table in Base.metadata.tables.values() for index in table.indexes):
        index.dialect_options[dialect]["where"] = index.dialect_options["sqlite"]["where"]


def _require_reachable(stored: str) -> None:
    if stored in {BASELINE, *(version for version, _ in STEPS)}:
        return
    if stored < BASELINE:
        raise DataFolderError(
            f"the schema of the database is of version {stored}, and this program opens those from {BASELINE}: "
            f"{OPENS_OLDER} on it once, which brings it to {BASELINE}, then start this program"
        )
    raise DataFolderError(
        f"the schema of the database is of version {stored}, and this program knows those to {VERSION}: "
        "start the newer program that it was used with, or restore the backup from before the upgrade"
    )
