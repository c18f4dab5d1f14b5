"""Epochs of the charts are kept one by one, with what was done to an axis; a history may be judged anew."""

from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

_NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
_BEGIN = datetime(1970, 1, 1, tzinfo=UTC)
_AXES = sa.table(
    "axes",
    sa.column("number", sa.Integer()), sa.column("epoch", sa.Integer()), sa.column("epoch_after", sa.DateTime()),
    sa.column("epoch_from", sa.DateTime()), sa.column("epoch_state", sa.JSON(none_as_null=True)),
    sa.column("active_calibration_id", sa.BigInteger()),
)  # fmt: skip
_EPOCHS = sa.table(
    "chart_epochs",
    sa.column("axis_number", sa.Integer()), sa.column("begins_at", sa.BigInteger()),
    sa.column("begun_by", sa.String()), sa.column("epoch", sa.Integer()),
    sa.column("calibration_id", sa.BigInteger()), sa.column("state", sa.JSON(none_as_null=True)),
)  # fmt: skip


def upgrade() -> None:
    """Go to this version; of each axis the epoch is known that its charts are in."""
    op.create_table(
        "chart_epochs",
        sa.Column("axis_number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("begins_at", sa.BigInteger(), nullable=False),
        sa.Column("begun_by", sa.String(16), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=True),
        sa.Column("calibration_id", sa.BigInteger(), nullable=True),
        sa.Column("state", sa.JSON(), nullable=True),
        sa.PrimaryKeyConstraint("axis_number", "begins_at", "begun_by", name=op.f("pk_chart_epochs")),
        sqlite_with_rowid=False,
    )
    connection = op.get_bind()
    for axis in connection.execute(sa.select(_AXES).where(_AXES.c.epoch > 0)).all():
        connection.execute(
            sa.insert(_EPOCHS),
            {
                "axis_number": axis.number, "begins_at": _begin_of(axis), "begun_by": "unknown", "epoch": axis.epoch,
                "calibration_id": axis.active_calibration_id, "state": axis.epoch_state,
            },
        )  # fmt: skip
    op.drop_column("axes", "epoch_state")
    op.add_column("axes", sa.Column("epoch_begins_at", sa.DateTime(), nullable=True))
    op.add_column("axes", sa.Column("archived_at", sa.DateTime(), nullable=True))
    op.create_table(
        "maintenance",
        sa.Column("id", _NUMBER, nullable=False),
        sa.Column("axis_id", sa.String(64), nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("entered_at", sa.DateTime(), nullable=False),
        sa.Column("who", sa.String(120), nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("note", sa.String(1000), nullable=False),
        sa.Column("set_preload_n", sa.Float(), nullable=True),
        sa.Column("corrects", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_maintenance")),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_maintenance_axis_id_axes")),
        sa.ForeignKeyConstraint(["corrects"], ["maintenance.id"], name=op.f("fk_maintenance_corrects_maintenance")),
    )
    op.create_index("ix_maintenance_axis_at", "maintenance", ["axis_id", "at", "id"])
    op.create_table(
        "rejudged_measurements",
        sa.Column("job_id", sa.String(36), nullable=False),
        sa.Column("measurement_id", _NUMBER, autoincrement=False, nullable=False),
        sa.Column("seen_revision", sa.Integer(), nullable=False),
        *(
            sa.Column(name, sa.JSON(), nullable=True)
            for name in ("measurement", "point", "outcome", "response", "refusals")
        ),
        sa.PrimaryKeyConstraint("job_id", "measurement_id", name=op.f("pk_rejudged_measurements")),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f("fk_rejudged_measurements_job_id_jobs")),
    )
    unfinished = sa.text("status IN ('queued', 'running')")
    op.create_index(
        "ix_jobs_unfinished", "jobs", ["kind", "axis_id"], sqlite_where=unfinished, postgresql_where=unfinished
    )


def downgrade() -> None:
    """Go back; refused if something was done to an axis, or one is archived: nobody would know of it any more."""
    refuse_to_lose("entries of the maintenance log", "SELECT count(*) FROM maintenance")
    refuse_to_lose("that axes are archived", "SELECT count(*) FROM axes WHERE archived_at IS NOT NULL")
    op.drop_index("ix_jobs_unfinished", table_name="jobs")
    op.drop_table("rejudged_measurements")
    op.drop_index("ix_maintenance_axis_at", table_name="maintenance")
    op.drop_table("maintenance")
    op.drop_column("axes", "archived_at")
    op.drop_column("axes", "epoch_begins_at")
    op.add_column("axes", sa.Column("epoch_state", sa.JSON(), nullable=True))
    connection = op.get_bind()
    for number, epoch, state in connection.execute(
        sa.select(_EPOCHS.c.axis_number, _EPOCHS.c.epoch, _EPOCHS.c.state)
    ).all():
        own = (_AXES.c.number == number, _AXES.c.epoch == epoch)
        connection.execute(sa.update(_AXES).where(*own).values(epoch_state=state))
    op.drop_table("chart_epochs")


def _begin_of(axis: sa.Row[tuple[object, ...]]) -> int:
    """Return when the epoch of an axis begins, in microseconds: what is older is not charted in it."""
    if axis.epoch_from is None and axis.epoch_after is None:
        return 0
    begin = axis.epoch_from if axis.epoch_from is not None else axis.epoch_after + timedelta(microseconds=1)
    return int((begin.replace(tzinfo=UTC) - _BEGIN) / timedelta(microseconds=1))
