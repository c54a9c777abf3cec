"""Previews of recordings, by file: read, made again, deleted.

Whoever may read the file may read its preview. All files with the same bytes share it, so a change requires the right
on the missions of all of them: a link to somebody else's bytes takes no more than READ.
"""

import base64
import datetime
import uuid
from collections import Counter
from collections.abc import Sequence

from kleinkram.contract.errors import FieldProblem, InvalidRequest
from kleinkram.contract.recording_previews import (
    FileThumbnail,
    FileThumbnails,
    RecordingPreviewRead,
    RecordingPreviewState,
)
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission, require_missions_of_blob
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs import recording_previews as previews
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.files.queries import FileWithBlob, thumbnails_of
from kleinkram.server.files.service import file_event, stored_file


async def get_preview(context: AppContext, actor: Actor, *, file_id: uuid.UUID) -> RecordingPreviewRead:
    """Return the state of a file's preview; if it is ready, with its URL, which is recorded as a look at the file.

    Raises:
        NotFound: the file does not exist, or is not visible.
    """
    async with context.database.begin() as db:
        stored = await stored_file(db, actor, file_id)
        row = await previews.find_preview(db, stored.blob_id)
        if row is None or row.state != RecordingPreviewState.ready.value or row.key is None:
            return _read(file_id, row)
        await audit(db, actor, file_event("file.preview", stored.read, after={"recording_preview": True}))
    expires_s = context.settings.download_url_s
    return _read(file_id, row).model_copy(
        update={
            "url": context.storage.sign_get(row.key, path=f"{stored.read.path}.preview", expires_s=expires_s),
            "expires_at": datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s),
        }
    )


async def get_thumbnails(db: Connection, actor: Actor, *, file_ids: Sequence[uuid.UUID]) -> FileThumbnails:
    """Return the thumbnails of visible files that have one, and record for each mission that they were viewed.

    Two statements for any number of files.
    """
    rows = (await db.execute(thumbnails_of(actor, file_ids))).all()
    missions = dict.fromkeys((row.mission_id, row.mission_name, row.project_id) for row in rows)
    counts = Counter(row.mission_id for row in rows)
    events = [
        Event(
            "mission.preview", "mission", *of_mission, after={"files": counts[of_mission[0]]}, mission_id=of_mission[0]
        )
        for of_mission in missions
    ]
    await audit(db, actor, *events)
    items = [FileThumbnail(file_id=row.id, jpeg=base64.b64encode(row.thumbnail).decode()) for row in rows]
    return FileThumbnails(items=items)


async def make_preview_again(db: Connection, actor: Actor, *, file_id: uuid.UUID) -> RecordingPreviewRead:
    """Have the preview of a file made soon, and return its state.

    Raises:
        NotFound: the file does not exist, or is not visible.
        Forbidden: the actor may not, in this mission or in another one with the same file.
        InvalidRequest: the file is no recording that can be read.
    """
    stored = await _require(db, actor, "make_recording_preview", file_id)
    if stored.read.content not in previews.READABLE:
        message = f"{stored.read.path} is no recording of which a preview can be made"
        raise InvalidRequest(problems=[FieldProblem(field="file_id", message=message)])
    await previews.make_again(db, stored.blob_id)
    await audit(db, actor, file_event("file.make_preview", stored.read))
    return _read(file_id, await previews.find_preview(db, stored.blob_id))


async def delete_preview(db: Connection, actor: Actor, *, file_id: uuid.UUID) -> RecordingPreviewRead:
    """Delete the preview of a file; it is made again only on request. Raises NotFound or Forbidden."""
    stored = await _require(db, actor, "delete_recording_preview", file_id)
    await previews.mark_deleted(db, stored.blob_id)
    await audit(db, actor, file_event("file.delete_preview", stored.read))
    return _read(file_id, await previews.find_preview(db, stored.blob_id))


async def _require(db: Connection, actor: Actor, operation: str, file_id: uuid.UUID) -> FileWithBlob:
    stored = await stored_file(db, actor, file_id)
    await require_mission(db, actor, operation, stored.read.mission.id)
    await require_missions_of_blob(db, actor, operation, stored.blob_id)
    return stored


def _read(file_id: uuid.UUID, row: previews.RecordingPreviewRow | None) -> RecordingPreviewRead:
    if row is None:
        return RecordingPreviewRead(file_id=file_id, state=RecordingPreviewState.none)
    return RecordingPreviewRead(
        file_id=file_id,
        state=RecordingPreviewState(row.state),
        reason=row.reason,
        version=row.version,
        size_bytes=row.size_bytes,
        made_at=row.made_at,
    )
