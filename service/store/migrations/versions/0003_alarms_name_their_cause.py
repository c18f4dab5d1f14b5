"""An alarm says which change of the axis explains it, or why that was not examined."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

#: Of alarms raised so far: no axis had a drive model.
NOT_EXAMINED = (
    '{"examined": false, "reason": "no-drive-model", "recent": null, '
    '"sentence": "cause not examined: the axis has no drive model"}'
)


def upgrade() -> None:
    """Go to this version."""
    column = sa.Column("explanation", sa.JSON(), nullable=False, server_default=NOT_EXAMINED)
    op.add_column("alarms", column)


def downgrade() -> None:
    """Go back; what was found out about the causes is lost."""
    op.drop_column("alarms", "explanation")
