"""What is told to receivers outside, and how far each has been told."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

_NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Go to this version."""
    op.create_table(
        "notices",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("kind", sa.String(60), nullable=False),
        sa.Column("subject", sa.String(100), nullable=False),
        sa.Column("content", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_notices")),
    )
    op.create_table(
        "receivers",
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("told_until", sa.BigInteger(), nullable=False),
        sa.Column("n_tries", sa.Integer(), nullable=False),
        sa.Column("failing_since", sa.DateTime(), nullable=True),
        sa.Column("next_try_at", sa.DateTime(), nullable=False),
        sa.Column("last_error", sa.String(500), nullable=True),
        sa.Column("last_told_at", sa.DateTime(), nullable=True),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_receivers")),
    )
    op.create_table(
        "dead_letters",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("receiver", sa.String(64), nullable=False),
        sa.Column("notice_id", _NUMBER, nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("error", sa.String(500), nullable=False),
        sa.ForeignKeyConstraint(["receiver"], ["receivers.name"], name=op.f("fk_dead_letters_receiver_receivers")),
        sa.ForeignKeyConstraint(["notice_id"], ["notices.id"], name=op.f("fk_dead_letters_notice_id_notices")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_dead_letters")),
    )
    op.create_index(op.f("ix_dead_letters_receiver"), "dead_letters", ["receiver"])


def downgrade() -> None:
    """Go back; refused while a receiver waits for something, or never got it."""
    waiting = "SELECT count(*) FROM notices WHERE id > (SELECT min(told_until) FROM receivers)"
    refuse_to_lose("notices that were not told yet", waiting)
    refuse_to_lose("notices that a receiver never got", "SELECT count(*) FROM dead_letters")
    op.drop_index(op.f("ix_dead_letters_receiver"), table_name="dead_letters")
    op.drop_table("dead_letters")
    op.drop_table("receivers")
    op.drop_table("notices")
