"""The hash of a window's content says whether it is whole; that of its file says nothing more."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version."""
    op.drop_column("windows", "file_sha256")


def downgrade() -> None:
    """Go back; the hashes of files are not known any more, so that waveforms stored by then count as damaged."""
    op.add_column("windows", sa.Column("file_sha256", sa.String(length=64), nullable=False, server_default=""))
    with op.batch_alter_table("windows") as windows:
        windows.alter_column("file_sha256", server_default=None)
