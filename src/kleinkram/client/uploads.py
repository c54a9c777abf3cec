"""The upload protocol, request by request. `kleinkram.client.transfer` makes uploads of it.

`begin`, `sign` and `complete` may be repeated, so they outlast a server that is away for a while.
"""

import datetime
import uuid
from collections.abc import Callable, Sequence

from kleinkram.client._http import PATIENCE_S, Api
from kleinkram.client._nouns import Listing, Ref, pages
from kleinkram.client.missions import Missions
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


class Uploads:
    """`client.uploads`. `patience_s` is how long a server may be away; `wait` is what waits meanwhile."""

    def __init__(
        self, api: Api, *, patience_s: float = PATIENCE_S, wait: Callable[[float], object] | None = None
    ) -> None:
        self._api = api
        self._patience_s = patience_s
        self._wait = wait

    def with_patience(self, patience_s: float, wait: Callable[[float], object]) -> "Uploads":
        """Return the same with other patience."""
        return Uploads(self._api, patience_s=patience_s, wait=wait)

    def now(self) -> datetime.datetime:
        """Return what time it is at the server, by which addresses end."""
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
        return self._api.repeat(path, UploadDecisions, body, patience_s=self._patience_s, wait=self._wait)

    def sign(self, parts: Sequence[PartToSign]) -> SignedParts:
        """Return where to PUT up to 200 parts, in the order given; renews the leases of their uploads.

        Raises:
            UploadGone: one of the uploads has ended.
        """
        body = PartsSign(parts=[*parts])
        return self._api.repeat("/uploads/parts", SignedParts, body, patience_s=self._patience_s, wait=self._wait)

    def complete(self, uploads: Sequence[UploadFinish]) -> UploadOutcomes:
        """Finish up to 200 uploads whose parts are all sent; the store verifies each. In the order given."""
        body = UploadsComplete(uploads=[*uploads])
        return self._api.repeat("/uploads/complete", UploadOutcomes, body, patience_s=self._patience_s, wait=self._wait)

    def abort(self, upload_id: uuid.UUID) -> None:
        """End an upload and free its name; its parts are removed."""
        self._api.delete(f"/uploads/{upload_id}")
