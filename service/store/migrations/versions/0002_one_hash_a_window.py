"""The hash of a window's content says whether it is whole; that of its file says nothing more."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Go to this version."""
    op.drop_column("windows", "file_sha256")


def downgrade() -> None:
    """Go back; refused if there are windows: the hashes of their files are not known any more."""
    refuse_to_lose("the waveforms, which then count as damaged", "SELECT count(*) FROM windows")
    op.add_column("windows", sa.Column("file_sha256", sa.String(length=64), nullable=False, server_default=""))
    with op.batch_alter_table("windows") as windows:
        windows.alter_column("file_sha256", server_default=None)
