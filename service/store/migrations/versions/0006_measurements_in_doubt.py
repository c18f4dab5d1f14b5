"""A point of the trend says what speaks against its preload."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version; of measurements so far nobody asked."""
    op.add_column("trend_points", sa.Column("doubt", sa.String(40), nullable=True))


def downgrade() -> None:
    """Go back; refused if a measurement is in doubt, which would then look like any other."""
    refuse_to_lose("measurements in doubt", "SELECT count(*) FROM trend_points WHERE doubt IS NOT NULL")
    op.drop_column("trend_points", "doubt")
