"""A point of the trend says how the places of its session contradict each other."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version; measurements so far state nothing to be compared by."""
    op.add_column("trend_points", sa.Column("place_uncertainty", sa.Float(), nullable=True))
    op.add_column("trend_points", sa.Column("places_disagree", sa.String(), nullable=True))


def downgrade() -> None:
    """Go back; refused if the places of a session contradict each other, which would then look like any other."""
    refuse_to_lose(
        "sessions whose places contradict each other",
        "SELECT count(*) FROM trend_points WHERE places_disagree IS NOT NULL",
    )
    op.drop_column("trend_points", "places_disagree")
    op.drop_column("trend_points", "place_uncertainty")
