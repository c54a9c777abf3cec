"""The `checks.yaml` of projects, and the outcomes of checks of missions.

`if_match` is the ETag that the rules of a project must still have to be changed, else EditConflict.
"""

import hashlib
import uuid
from collections.abc import Mapping, Sequence

from kleinkram.client._resources import ApiResource, Listing, Ref, checked, pages
from kleinkram.client.missions import Missions, Projects
from kleinkram.contract.checks import (
    Check,
    CheckDepth,
    CheckReportCreate,
    CheckReportRead,
    ChecksVersionRead,
    ProjectChecksRead,
    ProjectChecksUpdate,
)


class Checks(ApiResource):
    """`client.checks`."""

    def get(self, project: Ref, *, number: int | None = None) -> ProjectChecksRead:
        """Return the `checks.yaml` of a project, or one of its versions; its text is empty if there is none."""
        path = f"/projects/{self._project_id(project)}/checks"
        return self._api.get(path if number is None else f"{path}/versions/{number}", ProjectChecksRead)

    def set(self, project: Ref, text: str, *, if_match: str | None = None) -> ProjectChecksRead:
        """Make a text the `checks.yaml` of a project, by which all its missions are checked; an empty one removes it.

        Raises:
            YamlInvalid: the text is wrong, with line and column.
            Forbidden: it requires WRITE on the project.
        """
        body = checked(ProjectChecksUpdate, "The text", text=text)
        return self._api.send(
            "PUT", f"/projects/{self._project_id(project)}/checks", ProjectChecksRead, body, etag=if_match
        )

    def history(self, project: Ref) -> Listing[ChecksVersionRead]:
        """Yield the versions of a project's `checks.yaml`, latest first."""
        return pages(self._api, f"/projects/{self._project_id(project)}/checks/versions", ChecksVersionRead, [])

    def report(
        self, mission: Ref, checks: Sequence[Check], *, depth: CheckDepth, rules: str, files: Mapping[str, str]
    ) -> CheckReportRead:
        """Store the outcome of checks that were made of local files, such as by `klein check`.

        It counts while these are the recorded files of the mission, and `rules` the text of its project's
        `checks.yaml` (any, while the project has none).

        Args:
            mission: the mission that the files were uploaded to.
            checks: at most `MAX_CHECKS`.
            depth: whether messages were read.
            rules: the text of the `checks.yaml`.
            files: the SHA-256 in hex of each file of a recording, by its path in the mission.
        """
        body = checked(
            CheckReportCreate,
            "The report",
            checks=list(checks),
            depth=depth,
            document_sha256=hashlib.sha256(rules.encode()).hexdigest(),
            files=dict(files),
        )
        mission_id = Missions(self._api).id_of(mission)
        return self._api.send("POST", f"/missions/{mission_id}/check-reports", CheckReportRead, body)

    def _project_id(self, project: Ref) -> uuid.UUID:
        return Projects(self._api).id_of(project)
