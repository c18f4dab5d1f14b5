"""Who changed an alarm."""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version."""
    with op.batch_alter_table("alarm_events") as table:
        table.add_column(sa.Column("who", sa.String(120), nullable=True))


def downgrade() -> None:
    """Go back: who it was stands in the log of changes, too."""
    with op.batch_alter_table("alarm_events") as table:
        table.drop_column("who")
