"""Going back to an older schema: refused where it would lose something."""

from alembic import op
from sqlalchemy import text

from service.errors import DataFolderError


def refuse_to_lose(what: str, counted_by: str) -> None:
    """Refuse a downgrade if a query counts rows that it would lose.

    Raises DataFolderError; the transaction of the downgrade then changes nothing.
    """
    n_rows = op.get_bind().execute(text(counted_by)).scalar()
    if n_rows:
        raise DataFolderError(
            f"going back to an older schema would lose {what} (rows: {n_rows}); restore the backup from before the "
            "upgrade instead"
        )
