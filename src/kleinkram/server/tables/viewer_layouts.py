"""The table of the viewer's layouts."""

import sqlalchemy as sa

from kleinkram.server.tables.base import created_at_column, id_column, metadata, sorted_text

viewer_layout = sa.Table(
    "viewer_layout",
    metadata,
    id_column(),
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    sorted_text("name_key"),
    sa.Column("panels", sa.ARRAY(sa.Text), nullable=False),
    sa.Column("is_shared", sa.Boolean, nullable=False),
    sa.Column("is_default", sa.Boolean, nullable=False, server_default=sa.false()),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    sa.CheckConstraint("cardinality(panels) BETWEEN 1 AND 16", name="panel_count"),
    sa.CheckConstraint("is_shared OR NOT is_default", name="default_is_shared"),
    sa.Index(
        "uq_viewer_layout_shared_name",
        *("project_id", "name_key"),
        unique=True,
        postgresql_where=sa.text("is_shared"),
    ),
    sa.Index(
        "uq_viewer_layout_personal_name",
        *("created_by_id", "project_id", "name_key"),
        unique=True,
        postgresql_where=sa.text("NOT is_shared"),
    ),
    sa.Index("uq_viewer_layout_default", "project_id", unique=True, postgresql_where=sa.text("is_default")),
    # Of a project that is listed or deleted, and of a person whose data is exported.
    sa.Index("ix_viewer_layout_project_id", "project_id", "name_key", "id"),
    sa.Index("ix_viewer_layout_created_by_id", "created_by_id"),
)
