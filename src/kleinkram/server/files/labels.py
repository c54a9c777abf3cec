"""Labels on many files at once: each by its own right, each with its own row in the record."""

import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.access import Right
from kleinkram.contract.errors import FieldProblem, Forbidden, InvalidRequest, KleinkramError, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.problems import to_problem
from kleinkram.contract.search import FileLabelled, LabelChange
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.db import Connection
from kleinkram.server.files import queries
from kleinkram.server.files.service import rows_by_id
from kleinkram.server.missions import service as missions

# As many as one file may carry.
MAX_LABELS = 50
_Files = dict[uuid.UUID, Row[Any]]


async def label_files(db: Connection, actor: Actor, *, change: LabelChange) -> list[FileLabelled]:
    """Put labels on files and take labels off them; return how it went with each, in the order asked.

    A file that is not there, or may not be changed by this actor, keeps no other from being labelled.
    """
    found = await _held(db, actor, change.file_ids)
    writable = {row.id for row in await db.execute(queries.ids_among(actor, found, Right.write))}
    outcomes = {file_id: _outcome(found.get(file_id), file_id, writable, change) for file_id in change.file_ids}
    new = {file_id: labels for file_id, labels in outcomes.items() if isinstance(labels, list)}
    changed = {file_id: labels for file_id, labels in new.items() if labels != found[file_id].labels}
    if changed:
        rows = [{"ref": file_id, "new_labels": labels} for file_id, labels in changed.items()]
        await db.execute(queries.set_labels(), rows)
    await record_all(db, actor, [_event(found[file_id], labels) for file_id, labels in changed.items()])
    return [_told(file_id, outcomes[file_id], actor) for file_id in change.file_ids]


async def _held(db: Connection, actor: Actor, file_ids: Sequence[uuid.UUID]) -> _Files:
    """Return those of the files that are there for this actor, as they stay until the transaction ends."""
    held: set[uuid.UUID] = set()
    while True:
        found = {row.id: row for row in await rows_by_id(db, actor, file_ids)}
        unheld = {row.mission_id for row in found.values()} - held
        if not unheld:
            return found
        await missions.lock_missions(db, unheld)
        held |= unheld


def _outcome(
    row: Row[Any] | None, file_id: uuid.UUID, writable: Collection[uuid.UUID], change: LabelChange
) -> list[str] | KleinkramError:
    if row is None:
        return NotFound(noun="file", ref=str(file_id))
    if file_id not in writable:
        return Forbidden(noun="mission", operation="label files", needs=Right.write.value)
    taken = set(change.remove) - set(change.add)
    labels = [label for label in dict.fromkeys([*row.labels, *change.add]) if label not in taken]
    if len(labels) > MAX_LABELS:
        message = f"{row.path} would have {len(labels)} labels; {MAX_LABELS} are allowed"
        return InvalidRequest(problems=[FieldProblem(field="add", message=message)])
    return labels


def _told(file_id: uuid.UUID, outcome: list[str] | KleinkramError, actor: Actor) -> FileLabelled:
    if isinstance(outcome, KleinkramError):
        return FileLabelled(file_id=file_id, labels=None, problem=to_problem(outcome, actor.request_id))
    return FileLabelled(file_id=file_id, labels=outcome, problem=None)


def _event(row: Row[Any], labels: list[str]) -> Event:
    before: Metadata = {"labels": row.labels}
    return Event("file.update", "file", row.id, row.path, row.project_id, before, {"labels": [*labels]}, row.mission_id)
