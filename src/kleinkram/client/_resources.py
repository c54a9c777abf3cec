"""Base of the SDK's resources: validated requests, references (id, name, glob), and lists that load page by page."""

from __future__ import annotations

import copy
import datetime
import enum
import itertools
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from html import escape
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar, cast

from pydantic import BaseModel, ValidationError
from typing_extensions import Self

from kleinkram.client._http import Api, query_of
from kleinkram.client.errors import InvalidInput, ReadingMissing
from kleinkram.contract.base import MAX_PAGE_SIZE, Page
from kleinkram.contract.errors import AmbiguousName, NotFound
from kleinkram.contract.names import is_id, name_key
from kleinkram.contract.problems import first_message
from kleinkram.contract.projects import Deleted

if TYPE_CHECKING:
    import pandas as pd


T = TypeVar("T", bound=BaseModel)
Time = int | str | datetime.datetime
"""Nanoseconds since 1970, ISO 8601 text, or a datetime; UTC where it has no zone."""

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)


def checked(kind: type[T], what: str, /, **fields: object) -> T:
    """Return a request model of these fields; raise InvalidInput for the first that it does not take."""
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        where = " ".join(str(part) for part in error.errors(include_url=False)[0]["loc"])
        raise InvalidInput(what=f"{what} ({where})" if where else what, reason=first_message(error)) from None


def as_datetime(what: str, time: object) -> datetime.datetime | None:
    """Return a time given as nanoseconds since 1970, a datetime (UTC without a zone), or ISO text; None for None."""
    if time is None:
        return None
    if isinstance(time, datetime.datetime):
        return time if time.tzinfo else time.replace(tzinfo=datetime.timezone.utc)
    from kleinkram.recordings.messages import to_ns  # slow to import

    try:
        moment: datetime.datetime = _EPOCH + datetime.timedelta(microseconds=to_ns(cast(Time, time)) // 1000)
        return moment
    except OverflowError:
        raise InvalidInput(what=f"The time {time!r} ({what})", reason="it is too far from 1970") from None
    except (TypeError, ValueError) as error:
        raise InvalidInput(what=f"The time {time!r} ({what})", reason=str(error)) from None


RowT = TypeVar("RowT")

_SHOWN_CANDIDATES = 20
_SHOWN = 20


class HasId(Protocol):
    """A resource as a list or `get` returns it."""

    @property
    def id(self) -> uuid.UUID:
        """Its id."""


ResourceT = TypeVar("ResourceT", bound=HasId)
Ref = str | uuid.UUID | HasId
"""A reference to a resource: its name, its id (a UUID or text), or the resource itself."""


def known_id(ref: Ref, resource_type: str) -> uuid.UUID | None:
    """Return the id that a reference is or has; None for a name."""
    if isinstance(ref, str):
        return uuid.UUID(ref) if is_id(ref) else None
    resource_id = ref if isinstance(ref, uuid.UUID) else getattr(ref, "id", None)
    if not isinstance(resource_id, uuid.UUID):
        raise InvalidInput(what=f"The {resource_type} {ref!r}", reason="give its name, its id, or what a list returned")
    return resource_id


def refs_of(resource_type: str, value: object) -> list[object]:
    """Return one reference or several as a list; raise InvalidInput for none, which would mean all."""
    several = [*value] if isinstance(value, list | tuple | set | frozenset) else [value]
    if not several:
        raise InvalidInput(what=f"The filter ({resource_type})", reason="it names none; leave it out to select all")
    return several


def is_glob(ref: str) -> bool:
    """Return whether a reference may match several."""
    return "*" in ref or "?" in ref


def resolve_one(
    resource_type: str, ref: str, rows: Iterable[RowT], *, name: Callable[[RowT], str], label: Callable[[RowT], str]
) -> RowT:
    """Return the row that `ref` names, regardless of letter case and Unicode form; a glob may match only one.

    Raises:
        NotFound: no row matches.
        AmbiguousName: several match; lists them by `label`.
    """
    candidates = [*rows]
    matches = [row for row in candidates if name_key(name(row)) == name_key(ref)]
    if not matches and is_glob(ref):
        matches = candidates
    if not matches:
        raise NotFound(resource_type=resource_type, ref=ref)
    if len(matches) > 1:
        raise AmbiguousName(
            resource_type=resource_type, ref=ref, candidates=[label(row) for row in matches[:_SHOWN_CANDIDATES]]
        )
    return matches[0]


class ApiResource:
    """Resources of one type, such as `client.files`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def with_retry(self, timeout_s: float, wait: Callable[[float], object]) -> Self:
        """Return these resources with another retry timeout; `wait` waits between tries (seconds)."""
        other = copy.copy(self)
        other._api = self._api.with_retry(timeout_s, wait)
        return other

    def _to_trash(self, path: str, *, dry_run: bool) -> Deleted:
        answer = self._api.delete(path, query_of(None, dry_run=dry_run or None))
        return self._api.parse_response(Deleted, f"DELETE {path}", answer)


class NamedResource(ApiResource, ABC, Generic[ResourceT]):
    """Resources with names. Methods accept the name, the id, or the resource itself."""

    _resource_type: str

    @abstractmethod
    def get(self, ref: Ref) -> ResourceT:
        """Return the one with this id or name."""

    def id_of(self, ref: Ref) -> uuid.UUID:
        """Return the id of a resource; asks the server only for a name."""
        return known_id(ref, self._resource_type) or self.get(ref).id


class Listing(Iterator[T], Generic[T]):
    """The rows of a list, fetched page by page while they are read. Each `for` requests them again."""

    def __init__(self, rows: Callable[[], Iterator[T]]) -> None:
        self._rows = rows
        self._reading: Iterator[T] | None = None

    def __iter__(self) -> Iterator[T]:
        return self._rows()

    def __next__(self) -> T:
        self._reading = self._reading or self._rows()
        return next(self._reading)

    def to_pandas(self) -> pd.DataFrame:
        """Return all rows as a pandas frame with a column per field; nested fields have dotted names (`mission.name`).

        Ids are text; fields in `_at` are times (UTC); log times and other integers that may be missing are `Int64`.
        """
        try:
            import pandas
        except ImportError:
            raise ReadingMissing(what="pandas") from None
        rows = [flat(row) for row in self]
        frame = pandas.DataFrame(rows, columns=[*dict.fromkeys(itertools.chain.from_iterable(rows))])
        for name in frame.columns:
            if name.endswith("_at"):
                frame[name] = pandas.to_datetime(frame[name], utc=True)
            elif name.endswith(("_ns", "_bytes", "_count")):
                frame[name] = frame[name].astype("Int64")
        return frame

    def _repr_html_(self) -> str:
        """Return the first rows as a table, for notebooks."""
        rows = [flat(row) for row in itertools.islice(self, _SHOWN + 1)]
        return html_table(rows[:_SHOWN], more=len(rows) > _SHOWN)


def flat(row: BaseModel) -> dict[str, object]:
    """Return the fields of a row as plain values; nested ones have dotted names."""
    plain: dict[str, object] = {}
    for name in type(row).model_fields:
        plain |= _flat(name, getattr(row, name))
    return plain


def _flat(name: str, value: object) -> dict[str, object]:
    if isinstance(value, BaseModel):
        return {f"{name}.{inner}": one for inner, one in flat(value).items()}
    if isinstance(value, dict):
        return {key: one for inner, part in value.items() for key, one in _flat(f"{name}.{inner}", part).items()}
    if isinstance(value, list):
        return {name: [one.model_dump(mode="json") if isinstance(one, BaseModel) else one for one in value]}
    return {
        name: value.value if isinstance(value, enum.Enum) else str(value) if isinstance(value, uuid.UUID) else value
    }


def html_table(rows: list[dict[str, object]], *, more: bool = False) -> str:
    """Return rows as an HTML table without ids; all text is escaped."""
    names = [
        name
        for name in dict.fromkeys(itertools.chain.from_iterable(rows))
        if not (name.rpartition(".")[2] in {"id", "etag"} or name.endswith(("_id", "_ids")))
    ]
    heading = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(f"<tr>{''.join(f'<td>{_cell(row.get(name))}</td>' for name in names)}</tr>" for row in rows)
    rest = "<p>and more</p>" if more else "" if rows else "<p>Nothing found.</p>"
    return f"<table><tr>{heading}</tr>{body}</table>{rest}"


def _cell(value: object) -> str:
    if isinstance(value, datetime.datetime):
        return escape(f"{value:%Y-%m-%d %H:%M:%SZ}")
    return "" if value is None else escape(str(value))


def pages(api: Api, path: str, kind: type[T], query: list[tuple[str, str]], *, limit: int | None = None) -> Listing[T]:
    """Return the rows of a list in its order, at most `limit` of them."""
    return Listing(lambda: _rows(api, path, kind, query, limit))


def _rows(api: Api, path: str, kind: type[T], query: list[tuple[str, str]], limit: int | None) -> Iterator[T]:
    left, cursor = limit, None
    while left is None or left > 0:
        size = MAX_PAGE_SIZE if left is None else min(left, MAX_PAGE_SIZE)
        page = api.get(path, Page[kind], [*query, *query_of(None, limit=size, cursor=cursor)])  # type: ignore[valid-type]  # a generic model is made at run time
        yield from page.items
        left = None if left is None else left - len(page.items)
        cursor = page.next
        if cursor is None:
            return


def count(api: Api, path: str, kind: type[T], query: list[tuple[str, str]]) -> int:
    """Return how many rows a list has."""
    page = api.get(path, Page[kind], [*query, ("limit", "1"), ("count", "true")])  # type: ignore[valid-type]  # as above
    return page.total or 0
