"""Files, the topics inside them, and the upload protocol. `if_match` is the ETag that a file must still have."""

import datetime
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence

from typing_extensions import Unpack

from kleinkram.client._http import query_of
from kleinkram.client._nouns import (
    Listing,
    NamedResource,
    Ref,
    RetryingResource,
    checked,
    count,
    known_id,
    pages,
    resolve_one,
)
from kleinkram.client.missions import Missions
from kleinkram.client.search import Condition, FileFields, as_filter
from kleinkram.contract.files import DownloadLinks, DownloadRequest, FileRead, FileSort, FileUpdate, TopicRead
from kleinkram.contract.projects import Deleted
from kleinkram.contract.runs import LineageRead
from kleinkram.contract.search import MAX_LABELLED, FileLabelled, FilesLabelled, LabelChange, TopicFound
from kleinkram.contract.uploads import (
    PartsSign,
    PartToSign,
    SignedParts,
    UploadBegin,
    UploadDecisions,
    UploadFile,
    UploadFinish,
    UploadOutcomes,
    UploadRead,
    UploadsComplete,
)


class Files(NamedResource[FileRead]):
    """`client.files`."""

    _noun = "file"

    def list(
        self,
        matching: Condition = None,
        *,
        sort: FileSort | str | None = None,
        limit: int | None = None,
        **fields: Unpack[FileFields],
    ) -> Listing[FileRead]:
        """Yield the files that match, by project, mission and path unless `sort` says otherwise.

        Here and below, select by keywords, as in `list(project="alpine", topic="*imu*")` (those of `FileFields`), by
        the text of a query such as `"topic:/imu -label:night"`, by both, or by a filter.
        """
        query = query_of(as_filter(matching, fields), sort=sort)
        return pages(self._api, "/files", FileRead, query, limit=limit)

    def count(self, matching: Condition = None, **fields: Unpack[FileFields]) -> int:
        """Return how many files match."""
        return count(self._api, "/files", FileRead, query_of(as_filter(matching, fields)))

    def get(self, ref: Ref, *, mission: Ref | None = None, project: Ref | None = None) -> FileRead:
        """Return the file with this id, or this path (in that mission).

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

    def topics(self, file_id: Ref) -> Listing[TopicRead]:
        """Yield the topics of one file, by name."""
        return pages(self._api, f"/files/{self.id_of(file_id)}/topics", TopicRead, [])

    def lineage(self, file_id: Ref) -> LineageRead:
        """Return which run created a file and from what, and which runs read it and what they created."""
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
        """Change some fields of `FileUpdate`: a path renames, a `mission_id` moves; no bytes are copied.

        Raises:
            FileExists, PathConflict: the new place is taken.
        """
        body = checked(FileUpdate, "The file", **changes)
        return self._api.patch(f"/files/{self.id_of(file_id)}", FileRead, body, etag=if_match)

    def label(
        self, file_ids: Iterable[Ref], *, add: Sequence[str] = (), remove: Sequence[str] = ()
    ) -> Iterator[FileLabelled]:
        """Add and remove labels of files; yield the outcome for each, in order. A refused one has a `problem`."""
        ids = [self.id_of(file_id) for file_id in file_ids]
        for start in range(0, len(ids), MAX_LABELLED):
            some = ids[start : start + MAX_LABELLED]
            body = checked(LabelChange, "The labels", file_ids=some, add=[*add], remove=[*remove])
            yield from self._api.repeat("/files/labels", FilesLabelled, body).items

    def delete(self, file_id: Ref, *, dry_run: bool = False) -> Deleted:
        """Move a file to the trash; with `dry_run`, only return what would go."""
        return self._to_trash(f"/files/{self.id_of(file_id)}", dry_run=dry_run)

    def verify(self, file_id: Ref) -> FileRead:
        """Have the server verify the stored bytes again; `state` and `verified_at` change when it has read them all.

        `kleinkram.client.transfer.verify_local` compares local files.
        """
        return self._api.understood(FileRead, "verify", self._api.post(f"/files/{self.id_of(file_id)}/verify"))

    def links(self, file_ids: Sequence[Ref]) -> DownloadLinks:
        """Return where to read the bytes of up to 500 files, in the order asked; FileUnavailable for a damaged one."""
        body = checked(DownloadRequest, "The files", file_ids=[self.id_of(file_id) for file_id in file_ids])
        return self._api.repeat("/files/download", DownloadLinks, body)


def file_label(file: FileRead) -> str:
    """Return a file as it is listed among candidates."""
    return f"{file.mission.project.name}/{file.mission.name}/{file.path} ({file.id})"


class Uploads(RetryingResource):
    """`client.uploads`: the upload protocol, request by request; `kleinkram.client.transfer` uses it."""

    def with_patience(self, patience_s: float, wait: Callable[[float], object]) -> "Uploads":
        """Return a client with another retry timeout."""
        return Uploads(self._api, patience_s=patience_s, wait=wait)

    def now(self) -> datetime.datetime:
        """Return the time at the server, by which signed URLs expire."""
        return self._api.now()

    def list(self, mission_id: Ref) -> Listing[UploadRead]:
        """Yield the uploads into a mission that are under way."""
        return pages(self._api, f"/missions/{Missions(self._api).id_of(mission_id)}/uploads", UploadRead, [])

    def get(self, upload_id: uuid.UUID) -> UploadRead:
        """Return an upload with the parts that the store holds."""
        return self._api.get(f"/uploads/{upload_id}", UploadRead)

    def begin(self, mission_id: uuid.UUID, files: Sequence[UploadFile]) -> UploadDecisions:
        """Announce up to 200 files and return what to do with each, in the order given."""
        body = UploadBegin(files=[*files])
        path = f"/missions/{mission_id}/uploads"
        return self._repeat(path, UploadDecisions, body)

    def sign(self, parts: Sequence[PartToSign]) -> SignedParts:
        """Return where to PUT up to 200 parts, in the order given, and renew their leases; UploadGone if one ended."""
        body = PartsSign(parts=[*parts])
        return self._repeat("/uploads/parts", SignedParts, body)

    def complete(self, uploads: Sequence[UploadFinish]) -> UploadOutcomes:
        """Finish up to 200 uploads whose parts are all sent; the store verifies each. In the order given."""
        body = UploadsComplete(uploads=[*uploads])
        return self._repeat("/uploads/complete", UploadOutcomes, body)

    def abort(self, upload_id: uuid.UUID) -> None:
        """End an upload and free its name; its parts are removed."""
        self._api.delete(f"/uploads/{upload_id}")
