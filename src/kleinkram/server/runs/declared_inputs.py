"""What actions declare to read beside files: metadata of the mission, and the `checks.yaml` of its project."""

import uuid
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pydantic import JsonValue
from sqlalchemy import Select, select

from kleinkram.checks.document import ChecksDocument, reference_of
from kleinkram.contract.actions import Inputs
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.runs import RunChecks
from kleinkram.server.db import Connection, among
from kleinkram.server.projects.checks_documents import documents_by_hash
from kleinkram.server.tables import mission, project, project_checks


class DeclaredInputs(NamedTuple):
    """The declared inputs of an action on a mission; all are None where nothing is declared.

    Attributes:
        metadata: what a run stores: the values of the declared fields that are set; all, if it reads the `checks.yaml`
            or the reference.
        checks_sha256: what a run stores: the hash of the `checks.yaml`, if it reads that or the reference; None where
            the project has none.
        decisive: what results depend on; of the `checks.yaml` and of metadata that are not declared by name, only the
            reference, if that is all that the action reads.
    """

    metadata: Metadata | None = None
    checks_sha256: bytes | None = None
    decisive: Sequence[JsonValue] | None = None


async def read_declared_inputs(
    db: Connection, inputs: Inputs, mission_ids: Sequence[uuid.UUID]
) -> Mapping[uuid.UUID, DeclaredInputs]:
    """Return the declared inputs of an action by mission."""
    if not (inputs.metadata or _reads_checks(inputs)):
        return dict.fromkeys(mission_ids, DeclaredInputs())
    rows = (await db.execute(_present(mission_ids))).all()
    hashes = {row.sha256 for row in rows if row.sha256 is not None} if inputs.reference else ()
    documents = await documents_by_hash(db, hashes)
    return {row.id: declared_inputs(inputs, row.metadata, row.sha256, documents.get(row.sha256)) for row in rows}


def _present(mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    present = (project_checks.c.project_id == project.c.id) & (project_checks.c.number == project.c.checks_number)
    stmt = select(mission.c.id, mission.c.metadata, project_checks.c.sha256)
    stmt = stmt.join_from(mission, project, project.c.id == mission.c.project_id).outerjoin(project_checks, present)
    return stmt.where(among(mission.c.id, mission_ids))


def declared_inputs(
    inputs: Inputs, metadata: Metadata, checks_sha256: bytes | None, document: ChecksDocument | None
) -> DeclaredInputs:
    """Return the declared inputs of an action that declares some. The document is only read for the reference."""
    named: Metadata = {name: metadata[name] for name in inputs.metadata if name in metadata}
    if not _reads_checks(inputs):
        return DeclaredInputs(named, None, [named, None])
    if inputs.checks:
        decisive: list[JsonValue] = [metadata, checks_sha256.hex() if checks_sha256 else None]
    else:
        decisive = [named, None, reference_of(document, metadata)]
    return DeclaredInputs(metadata, checks_sha256, decisive)


def _reads_checks(inputs: Inputs) -> bool:
    """Return whether an action reads the `checks.yaml` or a part of it, and all metadata, which choose profiles."""
    return inputs.checks or inputs.reference


def mission_at_launch(inputs: Inputs, declared: Metadata | None, present: MissionRead) -> MissionRead:
    """Return a mission as a run sees it: the metadata that its action declares are as they were at the launch."""
    if declared is None:
        return present
    others = present.metadata.keys() - inputs.metadata if not _reads_checks(inputs) else ()
    metadata = {name: present.metadata[name] for name in others} | declared
    text = present.metadata_yaml if metadata == present.metadata else None
    return present.model_copy(update={"metadata": metadata, "metadata_yaml": text})


async def checks_at_launch(
    db: Connection, inputs: Inputs, project_id: uuid.UUID, sha256: bytes | None
) -> RunChecks | None:
    """Return the `checks.yaml` with this hash, also if the mission moved to the project since the launch."""
    if sha256 is None or not inputs.checks:
        return None
    stmt = select(project_checks.c.number, project_checks.c.text).where(project_checks.c.sha256 == sha256)
    is_own = (project_checks.c.project_id == project_id).desc()
    row = (await db.execute(stmt.order_by(is_own, project_checks.c.number.desc()).limit(1))).one_or_none()
    return None if row is None else RunChecks(version=row.number, sha256=sha256.hex(), text=row.text)


async def reference_at_launch(
    db: Connection, inputs: Inputs, declared: Metadata | None, sha256: bytes | None
) -> str | None:
    """Return the reference that the metadata and the `checks.yaml` of a launch name."""
    return await _reference(db, declared, sha256) if declared is not None and inputs.reference else None


async def present_reference(db: Connection, mission_id: uuid.UUID) -> str | None:
    """Return the reference that the metadata of a mission and the `checks.yaml` of its project name now."""
    row = (await db.execute(_present([mission_id]))).one()
    return await _reference(db, row.metadata, row.sha256)


async def _reference(db: Connection, metadata: Metadata, sha256: bytes | None) -> str | None:
    documents = await documents_by_hash(db, [sha256] if sha256 is not None else [])
    return reference_of(next(iter(documents.values()), None), metadata)
