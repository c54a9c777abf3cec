"""The upload protocol of the fake server, as far as artifacts need it."""

from __future__ import annotations

import hashlib
import uuid

from kleinkram.contract.errors import UploadGone
from kleinkram.contract.problems import to_problem
from kleinkram.contract.runners import LOG_PATH, ArtifactUploadsCreate
from kleinkram.contract.uploads import (
    AlreadyPresent,
    ChecksumKind,
    Completed,
    NotCompleted,
    PartsSign,
    SignedPart,
    SignedParts,
    StoredPart,
    UploadDecision,
    UploadDecisions,
    UploadOutcome,
    UploadOutcomes,
    UploadRead,
    UploadRequired,
    UploadsComplete,
    UploadState,
    part_size_bytes,
)
from tests.integration.runner_loop.context import LATER
from tests.integration.runner_loop.fake_runs import FakeRun


class FakeUploads:
    """Uploads whose parts go to the store at `url`, which keeps what arrives in `objects`.

    So many files as `refuses` are not taken when all of them has arrived.
    """

    def __init__(self, url: str, objects: dict[str, bytes]) -> None:
        self._url = url
        self._objects = objects
        self._uploads: dict[uuid.UUID, tuple[FakeRun, str, int]] = {}
        self.refuses = 0

    def begin(self, run: FakeRun, begin: ArtifactUploadsCreate) -> UploadDecisions:
        """Open uploads of what a run left; what is there already is not asked for again."""
        decisions: list[UploadDecision] = []
        for file in begin.files:
            if file.path in run.artifacts:
                decisions.append(AlreadyPresent(file=None))
                continue
            upload_id = uuid.uuid4()
            self._uploads[upload_id] = (run, file.path, file.size_bytes)
            upload = UploadRead(
                id=upload_id,
                mission_id=run.claim.mission_id,
                path=file.path,
                size_bytes=file.size_bytes,
                part_size_bytes=part_size_bytes(file.size_bytes),
                checksum=ChecksumKind.sha256,
                state=UploadState.open,
                lease_ends_at=LATER,
                expires_at=LATER,
                parts=list[StoredPart](),
            )
            decisions.append(UploadRequired(upload=upload))
        return UploadDecisions(items=decisions)

    def sign(self, requested: PartsSign) -> SignedParts:
        """Say where parts are to be sent."""
        signed = [
            SignedPart(
                upload_id=part.upload_id,
                number=part.number,
                url=f"{self._url}/store/up/{part.upload_id}/{part.number}?sha256={part.checksum}",
                headers={},
                expires_at=LATER,
            )
            for part in requested.parts
        ]
        return SignedParts(items=signed)

    def complete(self, requested: UploadsComplete) -> UploadOutcomes:
        """Give runs what arrived whole."""
        outcomes: list[UploadOutcome] = []
        for entry in requested.uploads:
            if self.refuses > 0 and self._uploads[entry.upload_id][1] != LOG_PATH:
                self.refuses -= 1
                problem = to_problem(UploadGone(upload_id=str(entry.upload_id)), "a request")
                outcomes.append(NotCompleted(upload_id=entry.upload_id, problem=problem))
                continue
            run, path, size = self._uploads[entry.upload_id]
            parts = sorted(
                (int(key.rpartition("/")[2]), data)
                for key, data in self._objects.items()
                if key.startswith(f"up/{entry.upload_id}/")
            )
            whole = b"".join(data for _, data in parts)
            assert (len(whole), hashlib.sha256(whole).hexdigest()) == (size, entry.sha256)
            run.artifacts[path] = whole
            outcomes.append(Completed(upload_id=entry.upload_id, file=None))
        return UploadOutcomes(items=outcomes)
