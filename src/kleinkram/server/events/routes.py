"""Events over HTTP."""

from typing import Annotated

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from kleinkram.server.dependencies import CurrentActor, CurrentDatabase, FindAgain
from kleinkram.server.events.service import Watch, watch
from kleinkram.server.http import mark_as_stream

router = APIRouter(prefix="/api/v1/events", tags=["events"])
_EVENT_STREAM = "text/event-stream"
_LONGEST_S = 3600.0
EventId = Annotated[str, Field(max_length=64, pattern=r"^[ -~]*$")]


class EventsQuery(BaseModel):
    """Which events."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    after: EventId | None = Field(None, description="The id of the last event that is known, as in Last-Event-ID.")
    for_s: Annotated[float, Field(ge=0, le=_LONGEST_S, description="After how many seconds it ends.")] = _LONGEST_S


@router.get(
    "",
    operation_id="watch_events",
    response_class=StreamingResponse,
    responses={200: {"description": "Server-sent events, as the text of a stream.", "content": {_EVENT_STREAM: {}}}},
)
async def watch_events(
    query: Annotated[EventsQuery, Query()],
    request: Request,
    database: CurrentDatabase,
    actor: CurrentActor,
    find: FindAgain,
    last_event_id: Annotated[EventId | None, Header()] = None,
) -> StreamingResponse:
    """Tell what changes, as it changes, of whatever you may see; and `refetch` where that may not be all.

    `change` says noun, id and place, never contents. A comment comes every 15 s. When the stream ends, come back with
    the id of the last event: what happened meanwhile follows. It ends within seconds of your session, token or account.
    """
    hub = request.app.state.hub
    hub.see_that_one_more_may(actor.person_id)
    mark_as_stream(request.scope)
    asked = Watch(hub, database, find, last_event_id or query.after, query.for_s)
    headers = {"X-Accel-Buffering": "no"}  # to proxies of nginx's kind: pass it on as it comes
    return StreamingResponse(watch(asked, actor), media_type=_EVENT_STREAM, headers=headers)
