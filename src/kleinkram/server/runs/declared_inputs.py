"""What actions declare to read beside files: metadata of the mission, and the `checks.yaml` of its project."""

import uuid
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sqlalchemy import select

from kleinkram.contract.actions import Inputs
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.runs import RunChecks
from kleinkram.server.db import Connection, among
from kleinkram.server.tables import mission, project, project_checks


class DeclaredInputs(NamedTuple):
    """The declared inputs of an action on a mission; both are None where nothing is declared.

    `metadata`: the values of the declared fields that are set; all, if the `checks.yaml` is declared. `checks_sha256`:
    the hash of its text; None where the project has none.
    """

    metadata: Metadata | None = None
    checks_sha256: bytes | None = None


async def read_declared_inputs(
    db: Connection, inputs: Inputs, mission_ids: Sequence[uuid.UUID]
) -> Mapping[uuid.UUID, DeclaredInputs]:
    """Return the declared inputs of an action by mission."""
    if not inputs.metadata and not inputs.checks:
        return dict.fromkeys(mission_ids, DeclaredInputs())
    present = (project_checks.c.project_id == project.c.id) & (project_checks.c.number == project.c.checks_number)
    stmt = select(mission.c.id, mission.c.metadata, project_checks.c.sha256)
    stmt = stmt.join_from(mission, project, project.c.id == mission.c.project_id).outerjoin(project_checks, present)
    rows = await db.execute(stmt.where(among(mission.c.id, mission_ids)))
    return {row.id: _declared(inputs, row.metadata, row.sha256) for row in rows}


def _declared(inputs: Inputs, metadata: Metadata, checks_sha256: bytes | None) -> DeclaredInputs:
    if inputs.checks:
        return DeclaredInputs(metadata, checks_sha256)
    return DeclaredInputs({name: metadata[name] for name in inputs.metadata if name in metadata})


def mission_at_launch(inputs: Inputs, declared: Metadata | None, present: MissionRead) -> MissionRead:
    """Return a mission as a run sees it: the metadata that its action declares are as they were at the launch."""
    if declared is None:
        return present
    others = (
        {} if inputs.checks else {name: present.metadata[name] for name in present.metadata.keys() - inputs.metadata}
    )
    metadata = others | declared
    text = present.metadata_yaml if metadata == present.metadata else None
    return present.model_copy(update={"metadata": metadata, "metadata_yaml": text})


async def checks_at_launch(db: Connection, project_id: uuid.UUID, sha256: bytes | None) -> RunChecks | None:
    """Return the `checks.yaml` with this hash, also if the mission moved to the project since the launch."""
    if sha256 is None:
        return None
    stmt = select(project_checks.c.number, project_checks.c.text).where(project_checks.c.sha256 == sha256)
    is_own = (project_checks.c.project_id == project_id).desc()
    row = (await db.execute(stmt.order_by(is_own, project_checks.c.number.desc()).limit(1))).one_or_none()
    return None if row is None else RunChecks(version=row.number, sha256=sha256.hex(), text=row.text)
