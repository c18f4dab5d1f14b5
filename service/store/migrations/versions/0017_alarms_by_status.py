"""Open alarms are found without passing all that were ever raised: shelves are looked at every other second."""

from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version."""
    op.create_index("ix_alarms_status", "alarms", ["status", "axis_id"])


def downgrade() -> None:
    """Go back."""
    op.drop_index("ix_alarms_status", "alarms")
