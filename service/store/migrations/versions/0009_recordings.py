"""Uploaded recordings are kept, with what was found in them."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version."""
    op.create_table(
        "recordings",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("axis_id", sa.String(64), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("problems", sa.JSON(), nullable=False),
        sa.Column("channel_map", sa.Text(), nullable=True),
        sa.Column("contents", sa.JSON(), nullable=False),
        sa.Column("folder", sa.String(32), nullable=False),
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_recordings_axis_id_axes")),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f("fk_recordings_job_id_jobs")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_recordings")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_recordings_axis_id"), "recordings", ["axis_id"])


def downgrade() -> None:
    """Go back; refused if a recording is kept: nothing would name its files any more."""
    refuse_to_lose("the list of uploaded recordings", "SELECT count(*) FROM recordings")
    op.drop_index(op.f("ix_recordings_axis_id"), table_name="recordings")
    op.drop_table("recordings")
