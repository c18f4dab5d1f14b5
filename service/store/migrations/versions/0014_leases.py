"""Jobs and receivers are held by one service at a time, for as long as it lives."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

_TABLES = ("jobs", "receivers")


def upgrade() -> None:
    """Go to this version; nobody holds anything."""
    for table in _TABLES:
        op.add_column(table, sa.Column("owner", sa.String(100), nullable=True))
        op.add_column(table, sa.Column("lease_until", sa.DateTime(), nullable=True))


def downgrade() -> None:
    """Go back; who holds what is known to nobody after a stop anyway."""
    for table in _TABLES:
        for column in ("lease_until", "owner"):
            op.drop_column(table, column)  # never a copy of the table: others refer to the jobs
