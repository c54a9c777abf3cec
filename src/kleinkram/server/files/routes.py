"""Routes of files."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse

from kleinkram.contract.base import Cursor, Page, PageSize
from kleinkram.contract.files import (
    DownloadLinks,
    DownloadRequest,
    FileRead,
    FileSort,
    FileUpdate,
    SliceQuery,
    TopicRead,
)
from kleinkram.contract.projects import Deleted
from kleinkram.contract.query import combined_filter
from kleinkram.contract.recording_previews import FileThumbnails, RecordingPreviewRead, ThumbnailsRequest
from kleinkram.contract.search import FileQuery, FilesLabelled, LabelChange
from kleinkram.server.files import recording_previews, service
from kleinkram.server.files.slices import SliceSelection, open_slice
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, Reading, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.http.middleware import mark_as_stream
from kleinkram.server.pagination import PageRequest

router = APIRouter(prefix="/api/v1", tags=["files"], responses=FAILURE_RESPONSES)


class FileListQuery(FileQuery):
    """Query parameters of a list of files."""

    sort: FileSort = FileSort.path
    limit: PageSize = 100
    cursor: Cursor | None = None
    count: bool = False


@router.get("/files", operation_id="list_files")
async def list_files(query: Annotated[FileListQuery, Query()], db: Reading, actor: CurrentActor) -> Page[FileRead]:
    """List the files that match."""
    page = PageRequest(query.limit, query.cursor, query.count)
    return await service.list_files(db, actor, matching=combined_filter(query), sort=query.sort, page=page)


@router.post("/files/download", operation_id="download_files")
async def download_files(request: DownloadRequest, context: CurrentContext, actor: CurrentActor) -> DownloadLinks:
    """Return URLs from which to read the content of files; the audit log records who requests them, and why."""
    links = await service.link_files(context, actor, file_ids=request.file_ids, purpose=request.purpose)
    return DownloadLinks(items=links)


@router.post("/files/thumbnails", operation_id="get_file_thumbnails")
async def get_file_thumbnails(requested: ThumbnailsRequest, db: Transaction, actor: CurrentActor) -> FileThumbnails:
    """Return a picture of a camera of each recording that has one, for lists; the audit log records who views them."""
    return await recording_previews.get_thumbnails(db, actor, file_ids=requested.file_ids)


@router.post("/files/labels", operation_id="label_files")
async def label_files(change: LabelChange, db: Transaction, actor: CurrentActor) -> FilesLabelled:
    """Add labels to many files and remove labels from them; the response has the outcome for each file."""
    return FilesLabelled(items=await service.label_files(db, actor, change=change))


@router.get("/files/{file_id}", operation_id="get_file")
async def get_file(file_id: uuid.UUID, db: Reading, actor: CurrentActor) -> FileRead:
    """Return one file."""
    return await service.get_file(db, actor, file_id)


@router.patch("/files/{file_id}", operation_id="update_file")
async def update_file(
    file_id: uuid.UUID, changes: FileUpdate, db: Transaction, actor: CurrentActor, if_match: IfMatch = None
) -> FileRead:
    """Rename, move or label a file; omitted fields do not change."""
    return await service.update_file(db, actor, file_id=file_id, changes=changes, if_match=if_match)


@router.delete("/files/{file_id}", operation_id="delete_file")
async def delete_file(file_id: uuid.UUID, db: Transaction, actor: CurrentActor, dry_run: bool = False) -> Deleted:
    """Move a file to the trash."""
    return await service.delete_file(db, actor, file_id=file_id, dry_run=dry_run)


@router.get("/files/{file_id}/topics", operation_id="list_file_topics")
async def list_file_topics(
    file_id: uuid.UUID,
    db: Reading,
    actor: CurrentActor,
    limit: PageSize = 100,
    cursor: Cursor | None = None,
) -> Page[TopicRead]:
    """List the topics of one file, by name."""
    return await service.list_topics(db, actor, file_id=file_id, page=PageRequest(limit, cursor))


@router.get(
    "/files/{file_id}/slice.mcap",
    operation_id="slice_file",
    response_class=StreamingResponse,
    responses={200: {"description": "An MCAP.", "content": {"application/octet-stream": {}}}},
)
async def slice_file(
    file_id: uuid.UUID,
    query: Annotated[SliceQuery, Query()],
    request: Request,
    context: CurrentContext,
    actor: CurrentActor,
) -> StreamingResponse:
    """Return some topics and a time range of a recording as a new MCAP, made while it is sent.

    It has the bytes that `klein cut` makes. If it cannot be finished, the connection breaks; what was received by then
    has no footer and is no whole MCAP.
    """
    mark_as_stream(request.scope)
    selection = SliceSelection(tuple(query.topics) or None, query.start, query.end)
    return await open_slice(context, request.app.state.slice_slots, actor, file_id=file_id, selection=selection)


@router.post("/files/{file_id}/verify", operation_id="verify_file", status_code=202)
async def verify_file(file_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> FileRead:
    """Verify the stored bytes again: the server reads all of them; `state` and `verified_at` change when it has."""
    return await service.verify_file(db, actor, file_id=file_id)


@router.get("/files/{file_id}/preview", operation_id="get_recording_preview")
async def get_recording_preview(
    file_id: uuid.UUID, context: CurrentContext, actor: CurrentActor
) -> RecordingPreviewRead:
    """Return the preview of a recording, with a URL from which to read it; the audit log records who requests it."""
    return await recording_previews.get_preview(context, actor, file_id=file_id)


@router.post("/files/{file_id}/preview", operation_id="make_recording_preview", status_code=202)
async def make_recording_preview(file_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> RecordingPreviewRead:
    """Make the preview of a recording again soon, also if it was deleted, or if the recording is small."""
    return await recording_previews.make_preview_again(db, actor, file_id=file_id)


@router.delete("/files/{file_id}/preview", operation_id="delete_recording_preview")
async def delete_recording_preview(file_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> RecordingPreviewRead:
    """Delete the preview of a recording, which all files with the same bytes share."""
    return await recording_previews.delete_preview(db, actor, file_id=file_id)
