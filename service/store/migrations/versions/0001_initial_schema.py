"""Initial schema."""

import sqlalchemy as sa
from alembic import op

from service.store.migrations.losses import refuse_to_lose

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

identity = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Go to this version."""
    op.create_table(
        "axes",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("configuration", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("active_calibration_id", identity, nullable=True),
        sa.Column("detector_design", sa.JSON(), nullable=False),
        sa.Column("monitor_state", sa.JSON(), nullable=True),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_axes")),
    )
    op.create_table(
        "calibrations",
        sa.Column("id", identity, nullable=False),
        sa.Column("axis_id", sa.String(length=64), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.Column("comment", sa.String(length=1000), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_calibrations_axis_id_axes")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_calibrations")),
    )
    op.create_index("ix_calibrations_axis_id", "calibrations", ["axis_id"])

    op.create_table(
        "jobs",
        sa.Column("id", sa.String(length=36), nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("axis_id", sa.String(length=64), nullable=False),
        sa.Column("arguments", sa.JSON(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("done", sa.Integer(), nullable=False),
        sa.Column("total", sa.Integer(), nullable=True),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("error", sa.String(length=1000), nullable=True),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("updated_at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_jobs_axis_id_axes")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_jobs")),
    )
    op.create_index("ix_jobs_axis_id", "jobs", ["axis_id"])

    op.create_table(
        "calibration_activations",
        sa.Column("id", identity, nullable=False),
        sa.Column("axis_id", sa.String(length=64), nullable=False),
        sa.Column("calibration_id", identity, nullable=False),
        sa.Column("activated_at", sa.DateTime(), nullable=False),
        sa.Column("reason", sa.String(length=1000), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_calibration_activations_axis_id_axes")),
        sa.ForeignKeyConstraint(
            ["calibration_id"], ["calibrations.id"], name=op.f("fk_calibration_activations_calibration_id_calibrations")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_calibration_activations")),
    )
    op.create_index("ix_calibration_activations_axis_id", "calibration_activations", ["axis_id"])

    op.create_table(
        "measurements",
        sa.Column("id", identity, nullable=False),
        sa.Column("axis_id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("started_at", sa.DateTime(), nullable=False),
        sa.Column("position_mm", sa.Float(), nullable=False),
        sa.Column("set_preload_n", sa.Float(), nullable=True),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("n_accepted", sa.Integer(), nullable=False),
        sa.Column("judged_at", sa.DateTime(), nullable=True),
        sa.Column("calibration_id", identity, nullable=True),
        sa.Column("frequency_hz", sa.Float(), nullable=True),
        sa.Column("preload_n", sa.Float(), nullable=True),
        sa.Column("interval_lower_n", sa.Float(), nullable=True),
        sa.Column("interval_upper_n", sa.Float(), nullable=True),
        sa.Column("monitor_state", sa.String(length=16), nullable=True),
        sa.Column("refusal_reason", sa.String(length=40), nullable=True),
        sa.Column("outcome", sa.JSON(), nullable=True),
        sa.Column("response", sa.JSON(), nullable=True),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_measurements_axis_id_axes")),
        sa.ForeignKeyConstraint(
            ["calibration_id"], ["calibrations.id"], name=op.f("fk_measurements_calibration_id_calibrations")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_measurements")),
        sa.UniqueConstraint("axis_id", "name", name=op.f("uq_measurements_axis_id_name")),
    )
    op.create_index("ix_measurements_axis_started", "measurements", ["axis_id", "started_at", "id"])

    op.create_table(
        "alarms",
        sa.Column("id", identity, nullable=False),
        sa.Column("axis_id", sa.String(length=64), nullable=False),
        sa.Column("measurement_id", identity, nullable=False),
        sa.Column("kind", sa.String(length=40), nullable=False),
        sa.Column("raised_at", sa.DateTime(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("evidence", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_alarms_axis_id_axes")),
        sa.ForeignKeyConstraint(
            ["measurement_id"], ["measurements.id"], name=op.f("fk_alarms_measurement_id_measurements")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_alarms")),
    )
    op.create_index("ix_alarms_axis_id", "alarms", ["axis_id"])

    op.create_table(
        "windows",
        sa.Column("id", identity, nullable=False),
        sa.Column("axis_id", sa.String(length=64), nullable=False),
        sa.Column("measurement_id", identity, nullable=False),
        sa.Column("started_at", sa.DateTime(), nullable=False),
        sa.Column("received_at", sa.DateTime(), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("file_path", sa.String(length=400), nullable=False),
        sa.Column("file_sha256", sa.String(length=64), nullable=False),
        sa.Column("index_in_file", sa.Integer(), nullable=False),
        sa.Column("refusal_reason", sa.String(length=40), nullable=True),
        sa.Column("refusal_detail", sa.String(length=500), nullable=True),
        sa.ForeignKeyConstraint(["axis_id"], ["axes.id"], name=op.f("fk_windows_axis_id_axes")),
        sa.ForeignKeyConstraint(
            ["measurement_id"], ["measurements.id"], name=op.f("fk_windows_measurement_id_measurements")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_windows")),
        sa.UniqueConstraint("axis_id", "started_at", name=op.f("uq_windows_axis_id_started_at")),
    )
    op.create_index("ix_windows_measurement_id", "windows", ["measurement_id"])

    op.create_table(
        "alarm_events",
        sa.Column("id", identity, nullable=False),
        sa.Column("alarm_id", identity, nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("old_status", sa.String(length=16), nullable=True),
        sa.Column("new_status", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.String(length=1000), nullable=False),
        sa.ForeignKeyConstraint(["alarm_id"], ["alarms.id"], name=op.f("fk_alarm_events_alarm_id_alarms")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_alarm_events")),
    )
    op.create_index("ix_alarm_events_alarm_id", "alarm_events", ["alarm_id"])


def downgrade() -> None:
    """Go back to the empty database; refused if there is an axis."""
    refuse_to_lose("every axis with all that was measured of it", "SELECT count(*) FROM axes")
    for table in (
        "alarm_events",
        "windows",
        "alarms",
        "measurements",
        "calibration_activations",
        "jobs",
        "calibrations",
        "axes",
    ):
        op.drop_table(table)
