"""Routes of event streams."""

from typing import Annotated

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from kleinkram.server.events.service import EventStream, stream_events
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, Reauthenticate
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import EVENT_STREAM, UNBUFFERED
from kleinkram.server.http.middleware import mark_as_stream

router = APIRouter(prefix="/api/v1/events", tags=["events"], responses=FAILURE_RESPONSES)
_MAX_DURATION_S = 3600.0
EventId = Annotated[str, Field(max_length=64, pattern=r"^[ -~]*$")]


class EventsQuery(BaseModel):
    """Query parameters of a stream."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    after: EventId | None = Field(None, description="The id of the last event received, as in Last-Event-ID.")
    for_s: Annotated[float, Field(ge=0, le=_MAX_DURATION_S, description="Duration of the stream in seconds.")] = (
        _MAX_DURATION_S
    )


@router.get(
    "",
    operation_id="watch_events",
    response_class=StreamingResponse,
    responses={200: {"description": "Server-sent events.", "content": {EVENT_STREAM: {}}}},
)
async def watch_events(
    query: Annotated[EventsQuery, Query()],
    request: Request,
    database: CurrentDatabase,
    actor: CurrentActor,
    authenticate: Reauthenticate,
    last_event_id: Annotated[EventId | None, Header()] = None,
) -> StreamingResponse:
    """Stream the changes of everything you can see; a `refetch` event means that some may have been missed.

    `change` names an object and where it is, never its content. A comment is sent every 15 s. When the stream ends,
    reconnect with the id of the last event to continue. It ends within seconds of your session, token or account.
    """
    hub = request.app.state.hub
    hub.require_free_stream(actor.person_id)
    mark_as_stream(request.scope)
    stream = EventStream(hub, database, authenticate, last_event_id or query.after, query.for_s)
    return StreamingResponse(stream_events(stream, actor), media_type=EVENT_STREAM, headers=UNBUFFERED)
