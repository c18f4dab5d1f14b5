"""A file of waveforms takes one request after another: a window lies in a frame that begins at some byte of it."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version; a file written so far holds one frame, at its beginning."""
    with op.batch_alter_table("windows") as windows:
        windows.add_column(sa.Column("offset_in_file", sa.BigInteger(), nullable=False, server_default="0"))
        windows.alter_column("index_in_file", new_column_name="index_in_frame")


def downgrade() -> None:
    """Go back; refused if a window lies in a later frame of its file, where the older program does not look."""
    refuse_to_lose("windows, which then count as damaged", "SELECT count(*) FROM windows WHERE offset_in_file > 0")
    with op.batch_alter_table("windows") as windows:
        windows.alter_column("index_in_frame", new_column_name="index_in_file")
        windows.drop_column("offset_in_file")
