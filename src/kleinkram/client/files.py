"""Files and the topics inside them, for programs."""

import uuid
from collections.abc import Iterable, Iterator, Sequence

from typing_extensions import Unpack

from kleinkram.client._http import Api, query_of
from kleinkram.client._nouns import Listing, Ref, checked, count, known_id, pages, resolve_one
from kleinkram.client.missions import Missions
from kleinkram.client.search import Condition, FileFields, as_filter
from kleinkram.contract.files import (
    DownloadLinks,
    DownloadRequest,
    FileRead,
    FileSort,
    FileUpdate,
    TopicRead,
)
from kleinkram.contract.projects import Deleted
from kleinkram.contract.runs import LineageRead
from kleinkram.contract.search import MAX_LABELLED, FileLabelled, FilesLabelled, LabelChange, TopicFound


class Files:
    """`client.files`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(
        self,
        matching: Condition = None,
        *,
        sort: FileSort | str | None = None,
        limit: int | None = None,
        **fields: Unpack[FileFields],
    ) -> Listing[FileRead]:
        """Yield the files that match, by project, mission and path unless `sort` says otherwise.

        Here and below, say which by keywords, as in `list(project="alpine", topic="*imu*")` (those of `FileFields`), by
        the text of a query such as `"topic:/imu -label:night"`, or by a filter; a query and keywords are one text.

        Raises:
            InvalidQuery: the query cannot be read, or a comparison cannot be made.
        """
        query = query_of(as_filter(matching, fields), sort=sort)
        return pages(self._api, "/files", FileRead, query, limit=limit)

    def count(self, matching: Condition = None, **fields: Unpack[FileFields]) -> int:
        """Return how many files match."""
        return count(self._api, "/files", FileRead, query_of(as_filter(matching, fields)))

    def get(
        self,
        ref: Ref,
        *,
        mission: Ref | None = None,
        project: Ref | None = None,
    ) -> FileRead:
        """Return the file with this id, or with this path (in that mission, where one is given).

        Wherever a file is meant, either will do, or the file itself.

        Raises:
            NotFound: there is none, or no such mission or project.
            AmbiguousName: several missions have one of that path.
        """
        if (file_id := known_id(ref, "file")) is not None:
            return self._api.get(f"/files/{file_id}", FileRead)
        path = str(ref)
        place: FileFields = {"path": path}
        if mission is not None:
            place["mission"] = Missions(self._api).id_of(mission, project=project)
        elif project is not None:
            place["project"] = project
        scope = as_filter(None, place)
        return resolve_one("file", path, self.list(scope), name=lambda row: row.path, label=file_label)

    def id_of(self, ref: Ref) -> uuid.UUID:
        """Return the id of a file that is named by its path; one that is known is not asked for.

        Raises:
            NotFound, AmbiguousName: as in `get`.
        """
        return known_id(ref, "file") or self.get(ref).id

    def topics(self, file_id: Ref) -> Listing[TopicRead]:
        """Yield the topics of one file, by name."""
        return pages(self._api, f"/files/{self.id_of(file_id)}/topics", TopicRead, [])

    def lineage(self, file_id: Ref) -> LineageRead:
        """Return which run made a file, of what, and which runs have read it, and what they made: a step each way."""
        return self._api.get(f"/files/{self.id_of(file_id)}/lineage", LineageRead)

    def find_topics(
        self, matching: Condition = None, *, limit: int | None = None, **fields: Unpack[FileFields]
    ) -> Listing[TopicRead]:
        """Yield the topics of all files that match; the filter's topic and type globs narrow the topics too."""
        return pages(self._api, "/topics", TopicRead, query_of(as_filter(matching, fields)), limit=limit)

    def topics_found(self, matching: Condition = None, **fields: Unpack[FileFields]) -> Sequence[TopicFound]:
        """Return each topic of the files that match once, by name and type, over all files."""
        files: dict[tuple[str, str | None], int] = {}
        messages: dict[tuple[str, str | None], int | None] = {}
        for row in self.find_topics(matching, **fields):
            key = (row.name, row.message_type)
            files[key] = files.get(key, 0) + 1
            messages[key] = row.count if messages.get(key) is None else (messages[key] or 0) + (row.count or 0)
        return [
            TopicFound(name=name, message_type=kind, file_count=count, message_count=messages[name, kind])
            for (name, kind), count in sorted(files.items(), key=lambda item: (item[0][0], item[0][1] or ""))
        ]

    def update(
        self, file_id: Ref, *, if_match: str | None = None, **changes: str | uuid.UUID | Sequence[str]
    ) -> FileRead:
        """Change what is given (the fields of `FileUpdate`): a path renames, a `mission_id` moves; no byte is touched.

        With `if_match`, the `etag` of what was looked at, a change is refused where somebody else came first.

        Raises:
            FileExists, PathConflict: the new place is taken.
            InvalidInput: the path or a label is not usable.
            EditConflict: it is of another ETag by now.
        """
        body = checked(FileUpdate, "The file", **changes)
        return self._api.patch(f"/files/{self.id_of(file_id)}", FileRead, body, etag=if_match)

    def label(
        self, file_ids: Iterable[Ref], *, add: Sequence[str] = (), remove: Sequence[str] = ()
    ) -> Iterator[FileLabelled]:
        """Put labels on files and take labels off; yield how it went with each, in order, however many they are.

        A file that one may not change has a `problem`, and keeps no other from being labelled.

        Raises:
            InvalidInput: a label is not usable.
        """
        ids = [self.id_of(file_id) for file_id in file_ids]
        for start in range(0, len(ids), MAX_LABELLED):
            some = ids[start : start + MAX_LABELLED]
            body = checked(LabelChange, "The labels", file_ids=some, add=[*add], remove=[*remove])
            yield from self._api.repeat("/files/labels", FilesLabelled, body).items

    def delete(self, file_id: Ref, *, dry_run: bool = False) -> Deleted:
        """Move a file to the trash; with `dry_run`, only say what would go."""
        answer = self._api.delete(f"/files/{self.id_of(file_id)}", query_of(None, dry_run=dry_run or None))
        return self._api.understood(Deleted, "DELETE file", answer)

    def verify(self, file_id: Ref) -> FileRead:
        """Have the server verify the stored bytes again; `state` and `verified_at` change when it has read them all.

        Compares no local file: `kleinkram.client.transfer.verify_local` does.
        """
        return self._api.understood(FileRead, "verify", self._api.post_empty(f"/files/{self.id_of(file_id)}/verify"))

    def links(self, file_ids: Sequence[Ref]) -> DownloadLinks:
        """Return where to read the bytes of up to 500 files, in the order asked.

        Raises:
            FileUnavailable: the store's copy of one is lost or corrupt.
        """
        body = checked(DownloadRequest, "The files", file_ids=[self.id_of(file_id) for file_id in file_ids])
        return self._api.repeat("/files/download", DownloadLinks, body)


def file_label(file: FileRead) -> str:
    """Return how a file is listed among candidates."""
    return f"{file.mission.project.name}/{file.mission.name}/{file.path} ({file.id})"
