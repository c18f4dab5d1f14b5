"""Waveforms are let go by rule: which purge did it, what is pinned, which files are on their way. Jobs of all axes."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

_NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Go to this version."""
    op.create_table(
        "purges",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("begun_at", sa.DateTime(), nullable=False),
        sa.Column("ended_at", sa.DateTime(), nullable=True),
        sa.Column("keep_raw_days", sa.Integer(), nullable=False),
        sa.Column("lets_go_before", sa.DateTime(), nullable=False),
        sa.Column("n_windows", sa.Integer(), nullable=False),
        sa.Column("freed_bytes", sa.BigInteger(), nullable=False),
        sa.Column("audit_id", _NUMBER, nullable=False),
        sa.ForeignKeyConstraint(["audit_id"], ["audit_log.id"], name=op.f("fk_purges_audit_id_audit_log")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_purges")),
    )
    op.create_table(
        "pins",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("axis_id", sa.String(64), nullable=False),
        sa.Column("measurement_id", _NUMBER, nullable=True),
        sa.Column("start_at", sa.DateTime(), nullable=True),
        sa.Column("end_at", sa.DateTime(), nullable=True),
        sa.Column("reason", sa.String(1000), nullable=False),
        sa.Column("who", sa.String(120), nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_pins_axis_id_axes")),
        sa.ForeignKeyConstraint(
            ["measurement_id"], ["measurements.id"], name=op.f("fk_pins_measurement_id_measurements")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_pins")),
        sa.UniqueConstraint("measurement_id", name=op.f("uq_pins_measurement_id")),
    )
    op.create_index(op.f("ix_pins_axis"), "pins", ["axis_id", "id"])
    op.create_table(
        "unsettled_files",
        sa.Column("path", sa.String(400), nullable=False),
        sa.PrimaryKeyConstraint("path", name=op.f("pk_unsettled_files")),
    )
    # in SQL: Alembic would copy the whole table on SQLite, which does not need it for a new column
    number = "INTEGER" if op.get_bind().dialect.name == "sqlite" else "BIGINT"
    reference = "CONSTRAINT fk_windows_let_go_by_purges REFERENCES purges (id)"
    op.execute(f"ALTER TABLE windows ADD COLUMN let_go_by {number} {reference}")
    where = sa.text("file_path <> ''")
    op.create_index("ix_windows_file_path", "windows", ["file_path"], sqlite_where=where, postgresql_where=where)
    _set_axis_of_jobs(nullable=True)


def downgrade() -> None:
    """Go back; refused if something was let go, is pinned, or was done for all axes: unknown to the older program."""
    refuse_to_lose("which waveforms were let go", "SELECT count(*) FROM windows WHERE let_go_by IS NOT NULL")
    refuse_to_lose("pins", "SELECT count(*) FROM pins")
    refuse_to_lose("waveform files on their way", "SELECT count(*) FROM unsettled_files")
    refuse_to_lose("jobs of all axes", "SELECT count(*) FROM jobs WHERE axis_id IS NULL")
    _set_axis_of_jobs(nullable=False)
    op.drop_index("ix_windows_file_path", table_name="windows")
    with op.batch_alter_table("windows") as windows:
        windows.drop_column("let_go_by")
    op.drop_table("unsettled_files")
    op.drop_index(op.f("ix_pins_axis"), table_name="pins")
    op.drop_table("pins")
    op.drop_table("purges")


def _set_axis_of_jobs(*, nullable: bool) -> None:
    if op.get_bind().dialect.name != "sqlite":
        op.alter_column("jobs", "axis_id", existing_type=sa.String(64), nullable=nullable)
        return
    # SQLite changes no column. Recordings refer to jobs, so that the table cannot be renamed away either: its rows are
    # put aside, and are back under their numbers before the transaction ends, until when their absence is tolerated.
    op.execute("PRAGMA defer_foreign_keys = ON")
    op.execute("CREATE TABLE jobs_aside AS SELECT * FROM jobs")
    op.drop_index("ix_jobs_axis_id", table_name="jobs")
    op.drop_table("jobs")
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(36), nullable=False),
        sa.Column("kind", sa.String(20), nullable=False),
        sa.Column("axis_id", sa.String(64), nullable=nullable),
        sa.Column("arguments", sa.JSON(), nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("done", sa.Integer(), nullable=False),
        sa.Column("total", sa.Integer(), nullable=True),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("error", sa.String(1000), nullable=True),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("updated_at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_jobs_axis_id_axes")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_jobs")),
    )
    columns = "id, kind, axis_id, arguments, status, done, total, result, error, created_at, updated_at"
    op.execute(f"INSERT INTO jobs ({columns}) SELECT {columns} FROM jobs_aside")  # noqa: S608
    op.drop_table("jobs_aside")
    op.create_index("ix_jobs_axis_id", "jobs", ["axis_id"])
