"""The upload protocol, request by request; `kleinkram.client.transfer` uses it.

`begin`, `sign` and `complete` are idempotent, so they are retried while the server is unavailable.
"""

import datetime
import uuid
from collections.abc import Callable, Sequence

from kleinkram.client._nouns import Listing, Ref, RetryingResource, pages
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


class Uploads(RetryingResource):
    """`client.uploads`."""

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
