"""Until when an alarm is shelved, and what an event of an alarm is besides a change of status."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version."""
    with op.batch_alter_table("alarms") as table:
        table.add_column(sa.Column("shelved_until", sa.DateTime(), nullable=True))
    with op.batch_alter_table("alarm_events") as table:
        table.add_column(sa.Column("kind", sa.String(16), nullable=True))


def downgrade() -> None:
    """Go back: that an alarm was shelved, and until when, stands in the reason of its event, too."""
    with op.batch_alter_table("alarm_events") as table:
        table.drop_column("kind")
    with op.batch_alter_table("alarms") as table:
        table.drop_column("shelved_until")
