"""Mission events: moments and spans of missions that are marked by name."""

import uuid
from collections.abc import Sequence

from typing_extensions import TypedDict, Unpack

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, Listing, Ref, Time, as_datetime, checked, count, known_id, pages
from kleinkram.client.errors import InvalidInput
from kleinkram.client.missions import Missions
from kleinkram.client.runs import with_ids
from kleinkram.contract.mission_events import (
    MissionEventCreate,
    MissionEventFilter,
    MissionEventRead,
    MissionEventSort,
    MissionEventUpdate,
)
from kleinkram.contract.runs import FindingRead


class MissionEventFields(TypedDict, total=False):
    """The keywords that select events: those of `MissionEventFilter`, with one value or several.

    Projects and missions are a name, an id or an object. `name` may be a glob.
    """

    project: Ref | Sequence[Ref]
    mission: Ref | Sequence[Ref]
    name: str | Sequence[str]
    label: str | Sequence[str]
    run_id: uuid.UUID
    after: Time
    before: Time


class MissionEventDetails(TypedDict, total=False):
    """What an event may have beside its name and time. The colour is written as `#ff8800`."""

    labels: Sequence[str]
    colour: str | None
    note: str
    file_id: uuid.UUID | None
    recording_id: uuid.UUID | None
    topic: str | None


class MissionEvents(ApiResource):
    """`client.mission_events`."""

    def list(
        self,
        matching: MissionEventFilter | None = None,
        *,
        sort: MissionEventSort | str | None = None,
        limit: int | None = None,
        **fields: Unpack[MissionEventFields],
    ) -> Listing[MissionEventRead]:
        """Yield the events that match, by start: `list(project="alpine", name="stumble*", after="2026-05-01")`."""
        query = query_of(self._filter(matching, fields), sort=sort)
        return pages(self._api, "/mission-events", MissionEventRead, query, limit=limit)

    def count(self, matching: MissionEventFilter | None = None, **fields: Unpack[MissionEventFields]) -> int:
        """Return how many events match."""
        return count(self._api, "/mission-events", MissionEventRead, query_of(self._filter(matching, fields)))

    def get(self, event: Ref) -> MissionEventRead:
        """Return one event. Raises NotFound."""
        return self._api.get(_path(event), MissionEventRead)

    def add(
        self,
        mission: Ref,
        name: str,
        start: Time,
        end: Time | None = None,
        **details: Unpack[MissionEventDetails],
    ) -> MissionEventRead:
        """Add an event to a mission: a moment, or with an end a span. Requests that are sent again add it once.

        Args:
            mission: the mission.
            name: the name, by which searches find it, as in `event:stumble`.
            start: log time: nanoseconds, an aware datetime, ISO text, or a text such as `10:00` (UTC) or `+20s` after
                the start of the mission.
            end: the last log time of a span.
            **details: those of `MissionEventDetails`.

        Raises:
            InvalidInput: a text is no time, or the name or a detail is not allowed.
            InvalidRequest: it ends before it starts, or refers to what the mission does not have.
            Forbidden: this requires CREATE on the mission.
        """
        mission_id = Missions(self._api).id_of(mission)
        times = self._times(mission_id, start=start, end=end)
        body = checked(MissionEventCreate, "The event", id=uuid.uuid4(), name=name, **times, **details)
        return self._api.repeat(f"/missions/{mission_id}/events", MissionEventRead, body)

    def add_finding(self, finding: FindingRead, *, name: str | None = None) -> MissionEventRead:
        """Add the finding of a run as an event of its mission, once; its name is the code, its note the message.

        Raises:
            InvalidInput: the finding has no time.
        """
        reported = finding.finding
        if reported.time_ns is None:
            raise InvalidInput(what=f"The finding {reported.code}", reason="it has no time")
        details = {"note": reported.message, "topic": reported.topic, "finding_id": finding.id}
        times = {"start_ns": reported.time_ns}
        body = checked(MissionEventCreate, "The event", name=name or reported.code, **times, **details)
        return self._api.repeat(f"/missions/{finding.mission.id}/events", MissionEventRead, body)

    def update(
        self,
        event: Ref,
        *,
        if_match: str | None = None,
        **changes: str | int | Sequence[str] | uuid.UUID | None,
    ) -> MissionEventRead:
        """Change some fields of `MissionEventUpdate` and return the event; None removes an end, a colour, a reference.

        Raises:
            InvalidInput: a field is unknown, or its value is not allowed.
            InvalidRequest: it would end before it starts, or refers to what the mission does not have.
            EditConflict: the ETag of the event is not `if_match`.
            Forbidden: this requires WRITE on the mission; CREATE for one's own.
        """
        body = checked(MissionEventUpdate, "The event", **changes)
        return self._api.patch(_path(event), MissionEventRead, body, etag=if_match)

    def delete(self, event: Ref) -> None:
        """Delete an event, which cannot be undone. Requires DELETE on the mission; CREATE for one's own."""
        self._api.delete(_path(event))

    def _filter(self, matching: MissionEventFilter | None, fields: MissionEventFields) -> MissionEventFilter:
        values = with_ids(self._api, fields)
        for name in ("name", "label"):
            if isinstance(one := values.get(name), str):
                values[name] = [one]
        for name in ("after", "before"):
            if name in values:
                values[name] = as_datetime(name, values[name])
        earlier = matching.model_dump(exclude_defaults=True) if matching else {}
        return checked(MissionEventFilter, "The filter", **{**earlier, **values})

    def _times(self, mission_id: uuid.UUID, *, start: Time, end: Time | None) -> dict[str, int | None]:
        """Return times as nanoseconds; only a text asks the server when the mission was recorded."""
        from kleinkram.recordings.time_range import resolve_time  # slow to import

        first_ns = last_ns = None
        if isinstance(start, str) or isinstance(end, str):
            mission = Missions(self._api).get(mission_id)
            first_ns, last_ns = mission.start_ns, mission.end_ns
        try:
            at_ns = resolve_time(start, first_ns, last_ns)
            return {"start_ns": at_ns, "end_ns": None if end is None else resolve_time(end, first_ns, last_ns)}
        except (TypeError, ValueError) as error:
            raise InvalidInput(what="The time of the event", reason=str(error)) from None


def _path(event: Ref) -> str:
    event_id = known_id(event, "event")
    if event_id is None:
        raise InvalidInput(what=f"The event {event!r}", reason="give its id; `klein event list --json` shows them")
    return f"/mission-events/{event_id}"
