"""One search over everything: what a query finds, and how it could be narrowed."""

import uuid
from typing import Annotated

from pydantic import AfterValidator, Field

from kleinkram.contract.base import Page, Request, Response
from kleinkram.contract.files import FileFilter, FileRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.names import Label, check_text
from kleinkram.contract.problems import ProblemDocument

MAX_QUERY_CHARACTERS = 8192
MAX_LABELLED = 500
QueryText = Annotated[str, AfterValidator(check_text), Field(max_length=MAX_QUERY_CHARACTERS)]
Labels = Annotated[list[Label], Field(max_length=50)]


class FileQuery(FileFilter):
    """A filter of files with the text of a query beside it: both hold, as if all had been said in one text."""

    query: QueryText | None = None


class TopicFound(Response):
    """A topic of one name and type, over all files that match. `message_count` is null where none is counted."""

    name: str
    message_type: str | None
    file_count: int
    message_count: int | None


class SearchRead(Response):
    """What a query finds: the first of the missions, files and topics, with how many there are.

    `query` is the text in its own order and spelling; `filter` is what it means. Missions are those that match by what
    they say themselves, and those of files that match. Their lists go on at `/missions` and `/files` with the same
    `query` and `sort=-start`. Not `is_whole` where very many files match: then every number of missions, files and
    topics is an estimate, in two digits, and the topics are those of files drawn by lot.
    """

    query: str
    filter: FileFilter
    missions: Page[MissionRead]
    files: Page[FileRead]
    topics: Page[TopicFound]
    is_whole: bool = True


class FacetValue(Response):
    """One value of a facet. `query` is the whole text with this value chosen, or taken back where it is chosen.

    `file_count` is how many files the query finds that have it, whatever else is chosen of the same facet.
    """

    value: str
    file_count: int
    is_chosen: bool
    query: str


class Facet(Response):
    """How the files divide by `name`: `project`, `format`, `content`, `topic`, `type`, `label`, `month`, `meta.FIELD`.

    The most frequent values first, months the latest; `value_count` is how many there are in all.
    """

    name: str
    values: list[FacetValue]
    value_count: int


class FacetsRead(Response):
    """The facets of a query. Not `is_whole` where only the first `file_count` files were looked at, to save time."""

    query: str
    file_count: int
    is_whole: bool
    facets: list[Facet]


class LabelChange(Request):
    """Labels to put on files and to take off; what is in both is put on."""

    file_ids: Annotated[list[uuid.UUID], Field(min_length=1, max_length=MAX_LABELLED)]
    add: Labels = []
    remove: Labels = []


class FileLabelled(Response):
    """How it went with one file: its labels now, or what kept them as they were."""

    file_id: uuid.UUID
    labels: list[str] | None
    problem: ProblemDocument | None


class FilesLabelled(Response):
    """How it went, file by file, in the order asked."""

    items: list[FileLabelled]
