"""Tables of checks: the versions of each project's `checks.yaml`, and what checks found out about missions.

`mission_checks` is derived from the rest: files, topics and metadata of the mission, reports, acceptances, runs.
"""

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import ARRAY, JSONB

from kleinkram.contract.checks import AcceptanceEnd, CheckDepth, Verdict
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

project_checks = sa.Table(
    "project_checks",
    metadata,
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    # Empty where the file was removed.
    sa.Column("text", sa.Text, nullable=False),
    sa.Column("sha256", sa.LargeBinary, nullable=False),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.CheckConstraint("number > 0", name="number"),
    sa.CheckConstraint("octet_length(sha256) = 32", name="sha256"),
)

mission_checks = sa.Table(
    "mission_checks",
    metadata,
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("verdict", sa.Text, nullable=False),
    # What it was derived from; where this differs from the mission and its project, the verdict is outdated.
    sa.Column("files_revision", sa.BigInteger, nullable=False),
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE"), nullable=False),
    sa.Column("checks_number", sa.Integer, nullable=False),
    # Set by other changes that it depends on, such as those of metadata.
    sa.Column("is_outdated", sa.Boolean, nullable=False, server_default=sa.text("false")),
    # CheckCounts of the contract; a list of CheckRead, worst first; of each check, the worst status.
    sa.Column("counts", JSONB, nullable=False),
    sa.Column("checks", JSONB, nullable=False),
    sa.Column("statuses", JSONB, nullable=False),
    sa.Column("profiles_applied", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("profiles_left_out", JSONB, nullable=False, server_default="[]"),
    # Names of the checks with warnings or errors that nobody accepted.
    sa.Column("failed", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("evaluated_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    # When the verdict became bad; kept while checks run again.
    sa.Column("bad_since", sa.DateTime(timezone=True)),
    one_of("verdict", Verdict),
    sa.CheckConstraint("verdict <> 'bad' OR bad_since IS NOT NULL", name="bad_since"),
    sa.Index("ix_mission_checks_project_id", "project_id"),
    sa.Index("ix_mission_checks_verdict", "verdict"),
    sa.Index("ix_mission_checks_failed", "failed", postgresql_using="gin"),
    # For the home page.
    sa.Index("ix_mission_checks_bad_since", "bad_since", postgresql_where=sa.text("verdict = 'bad'")),
)

check_report = sa.Table(
    "check_report",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    sa.Column("document_sha256", sa.LargeBinary, nullable=False),
    sa.Column("depth", sa.Text, nullable=False),
    sa.Column("verdict", sa.Text, nullable=False),
    # SHA-256 in hex by path.
    sa.Column("files", JSONB, nullable=False),
    sa.Column("checks", JSONB, nullable=False),
    # Sorted names.
    sa.Column("profiles", ARRAY(sa.Text), nullable=False, server_default="{}"),
    # The run that made it, for the person; null for an uploader.
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL"), index=True),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    one_of("depth", CheckDepth),
    one_of("verdict", Verdict),
    sa.CheckConstraint("octet_length(document_sha256) = 32", name="document_sha256"),
    sa.Index("ix_check_report_mission_id", "mission_id", "created_at"),
)

check_acceptance = sa.Table(
    "check_acceptance",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    sorted_text("check_name"),
    sa.Column("topic", sa.Text(collation="C")),
    sa.Column("because", sa.Text, nullable=False),
    # Hash of the paths and bytes of the files that it is about.
    sa.Column("inputs_sha256", sa.LargeBinary, nullable=False),
    # Each a list of the values of `Failure` in server/checks/combine.py.
    sa.Column("failures", JSONB, nullable=False, server_default="[]"),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.Column("ended", sa.Text),
    sa.Column("ended_at", sa.DateTime(timezone=True)),
    sa.Column("ended_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    one_of("ended", AcceptanceEnd),
    sa.CheckConstraint("(ended IS NULL) = (ended_at IS NULL)", name="ended_at"),
    sa.CheckConstraint("octet_length(inputs_sha256) = 32", name="inputs_sha256"),
    sa.Index("ix_check_acceptance_mission_id", "mission_id", "created_at"),
    sa.Index(
        "uq_check_acceptance_current",
        "mission_id",
        "check_name",
        "topic",
        unique=True,
        postgresql_where=sa.text("ended IS NULL"),
        postgresql_nulls_not_distinct=True,
    ),
)

check_note = sa.Table(
    "check_note",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    sorted_text("check_name"),
    sa.Column("topic", sa.Text(collation="C")),
    sa.Column("text", sa.Text, nullable=False),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.Index("ix_check_note_mission_id", "mission_id", "created_at"),
)
