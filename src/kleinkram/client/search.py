"""Search over missions, files and topics, and statistics. The query language is described in docs/searching.md."""

import uuid
from collections.abc import Mapping, Sequence
from typing import cast

from typing_extensions import TypedDict, Unpack

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, Ref, Time, as_datetime, checked, known_id, refs_of
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.files import FileFilter, FileSort
from kleinkram.contract.missions import MissionFilter
from kleinkram.contract.query import combined_filter, parse
from kleinkram.contract.search import FacetsRead, FileQuery, Overview, SearchRead, StatsRead
from kleinkram.contract.units import read_size

# What lists of files take: a filter, the text of a query, or None for everything.
Condition = FileFilter | str | None


class MissionFields(TypedDict, total=False):
    """The keywords that select missions: those of `MissionFilter`, with one value or several."""

    text: str
    project: Ref | Sequence[Ref]
    name: str | Sequence[str]
    where: str | Sequence[str]
    topic: str | Sequence[str]
    message_type: str | Sequence[str]
    recorded_after: Time
    recorded_before: Time
    completed: bool
    satisfied: bool
    event: str | Sequence[str]
    verdict: str | Sequence[str]
    check: str | Sequence[str]
    finding: str | Sequence[str]
    metric: str | Sequence[str]


class FileFields(TypedDict, total=False):
    """The keywords that select files: those of `FileFilter`, with one value or several.

    `project` and `mission` are a name, a glob, an id, an object, or several. Sizes are bytes, or text like "1GB".
    """

    text: str
    project: Ref | Sequence[Ref]
    mission: Ref | Sequence[Ref]
    recording_id: uuid.UUID
    path: str | Sequence[str]
    where: str | Sequence[str]
    topic: str | Sequence[str]
    message_type: str | Sequence[str]
    format: str | Sequence[str]
    label: str | Sequence[str]
    state: str | Sequence[str]
    content: str | Sequence[str]
    problem: str | Sequence[str]
    month: str | Sequence[str]
    without: str | Sequence[str]
    recorded_after: Time
    recorded_before: Time
    event: str | Sequence[str]
    verdict: str | Sequence[str]
    check: str | Sequence[str]
    finding: str | Sequence[str]
    metric: str | Sequence[str]
    min_size_bytes: int | str
    max_size_bytes: int | str
    min_duration_ns: int
    max_duration_ns: int


_NO_FIELDS: FileFields = {}
_SINGLE_VALUED = frozenset({"text", "recording_id", "completed", "satisfied", "min_duration_ns", "max_duration_ns"})


def as_filter(condition: Condition, fields: FileFields = _NO_FIELDS) -> FileFilter | None:
    """Return the filter of a query's text, of keywords, of both, or a filter unchanged.

    Raises:
        InvalidQuery: the query is invalid.
        InvalidInput: a keyword is unknown, or its value is invalid.
    """
    if not (condition is None or isinstance(condition, str | FileFilter)):
        raise InvalidInput(what=f"The filter {condition!r}", reason="use query text, keywords, or a FileFilter")
    if not fields:
        return parse(condition) if isinstance(condition, str) else condition
    values = _read_fields(fields)
    if isinstance(condition, FileFilter):
        values = {**condition.model_dump(exclude_defaults=True), **values}
    query = {"query": condition} if isinstance(condition, str) else {}
    return combined_filter(checked(FileQuery, "The filter", **values, **query))


def as_mission_filter(condition: MissionFilter | None, fields: MissionFields) -> MissionFilter | None:
    """Return the filter of missions of keywords and a filter together."""
    if not (condition is None or isinstance(condition, MissionFilter)):
        raise InvalidInput(what=f"The filter {condition!r}", reason="give keywords, or a MissionFilter")
    if not fields:
        return condition
    values = _read_fields(fields)
    if isinstance(names := values.get("name"), list):
        values = {**{key: value for key, value in values.items() if key != "name"}, "missions": names}
    earlier = condition.model_dump(exclude_defaults=True) if condition else {}
    return checked(MissionFilter, "The filter", **earlier, **values)


def _read_fields(fields: Mapping[str, object]) -> dict[str, object]:
    values: dict[str, object] = {}
    for name, value in fields.items():
        if value is None:
            continue
        if name == "mission":
            values |= _missions(value, has_project=fields.get("project") is not None)
        elif name == "project":
            values |= _location(name, refs_of(name, value))
        elif name in {"recorded_after", "recorded_before"}:
            values[name] = as_datetime(name, value)
        elif name.endswith("_size_bytes") and isinstance(value, str):
            try:
                values[name] = int(read_size(value))
            except ValueError as error:
                raise InvalidInput(what=f"The filter ({name})", reason=str(error)) from None
        elif name in _SINGLE_VALUED or name.endswith("_bytes") or name == "name":
            values[name] = value
        else:
            values[name] = refs_of(name, value)
    return values


def _missions(value: object, *, has_project: bool) -> dict[str, object]:
    """Return the filter fields for missions; one may be `"PROJECT/MISSION"`."""
    refs = refs_of("mission", value)
    qualified = [ref for ref in refs if isinstance(ref, str) and "/" in ref]
    if not qualified:
        return _location("mission", refs)
    if has_project or len(refs) > 1:
        reason = f"specify the project of {qualified[0]!r} with project="
        raise InvalidInput(what="The filter (mission)", reason=reason)
    project, _, name = qualified[0].partition("/")
    return {**_location("project", [project]), **_location("mission", [name])}


def _location(resource_type: str, several: Sequence[object]) -> dict[str, object]:
    refs = [known_id(cast(Ref, ref), resource_type) or str(ref) for ref in several]
    if len(refs) == 1:
        return {f"{resource_type}_id" if isinstance(refs[0], uuid.UUID) else resource_type: refs[0]}
    return {f"{resource_type}s": [str(ref) for ref in refs]}


class Search(ApiResource):
    """`client.search`."""

    def find(self, query: str = "", *, sort: FileSort | str | None = None, limit: int | None = None) -> SearchRead:
        """Return the first missions, files (latest first) and topics that match a query, and their counts.

        `client.files.list(query)` and `client.missions.list(query=query)` yield all of them. InvalidQuery names the
        word that cannot be read, its column, and what is possible.
        """
        return self._api.get("/search", SearchRead, query_of(None, query=query, sort=sort, limit=limit))

    def facets(self, query: str = "") -> FacetsRead:
        """Return the counts of the matching files by facet, and the query that selects each value."""
        return self._api.get("/search/facets", FacetsRead, query_of(None, query=query))


class Stats(ApiResource):
    """`client.stats`."""

    def get(
        self,
        by: str = "project",
        matching: Condition = None,
        *,
        derived: bool = False,
        **fields: Unpack[FileFields],
    ) -> StatsRead:
        """Return hours, bytes, files and messages of the matching files; with `derived`, also of those that runs made.

        `by` is `project`, `mission`, `topic`, `type`, `month`, `format` or `metadata.FIELD`.
        """
        return self._api.get("/stats", StatsRead, query_of(as_filter(matching, fields), by=by, derived=derived))

    def overview(self, by: str = "month", *, project: Ref | None = None, max_buckets: int = 20) -> Overview:
        """Return the totals of a project, or of all that one may see, in at most `max_buckets` buckets.

        `by` is `month`, of recording, or the name of a metadata field.
        """
        from kleinkram.client.missions import Projects  # imports this module

        path = "/overview" if project is None else f"/projects/{Projects(self._api).id_of(project)}/stats"
        return self._api.get(path, Overview, query_of(None, by=by, max_buckets=max_buckets))
