"""An alarm says which change of the axis explains it, or why that was not examined."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

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
    """Go back; refused if the cause of an alarm was examined."""
    refuse_to_lose(
        "what was found out about the causes of alarms",
        "SELECT count(*) FROM alarms WHERE CAST(explanation AS TEXT) LIKE '%\"examined\": true%'",
    )
    op.drop_column("alarms", "explanation")
