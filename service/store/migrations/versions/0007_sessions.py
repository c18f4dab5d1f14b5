"""Sessions are kept, an epoch remembers how its charts began, and a point what its axis had shown before."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

POINT_COLUMNS = ("feature_scatter_s2", "learnt_scatter_s2")


def upgrade() -> None:
    """Go to this version; the charts themselves are folded again by the service when it starts."""
    op.add_column("axes", sa.Column("epoch_state", sa.JSON(), nullable=True))
    for name in POINT_COLUMNS:
        op.add_column("trend_points", sa.Column(name, sa.Float(), nullable=True))
    op.create_table(
        "sessions",
        sa.Column("axis_number", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("calibration_id", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("started_at", sa.BigInteger(), primary_key=True, autoincrement=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("last_at", sa.BigInteger(), nullable=False),
        sa.Column("n_measurements", sa.Integer(), nullable=False),
        sa.Column("feature_s2", sa.Float(), nullable=False),
        *(sa.Column(name, sa.Float()) for name in ("temperature_c", "drag_torque_nm", "residual", "reference")),
        sa.Column("alarmed", sa.Boolean(), nullable=False),
        sqlite_with_rowid=False,
    )


def downgrade() -> None:
    """Go back; refused if a session is kept, or if charts stand as an older program cannot read them."""
    refuse_to_lose("the charts of every axis", "SELECT count(*) FROM axes WHERE monitor_state IS NOT NULL")
    op.drop_table("sessions")
    for name in POINT_COLUMNS:
        op.drop_column("trend_points", name)
    op.drop_column("axes", "epoch_state")
