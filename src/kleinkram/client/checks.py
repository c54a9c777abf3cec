"""Checks: the `checks.yaml` of projects, and the checks and verdicts of missions."""

import difflib
import uuid
from collections.abc import Sequence

from kleinkram.client._http import query_of
from kleinkram.client._resources import ApiResource, Listing, Ref, checked, pages
from kleinkram.client.missions import Missions, Projects
from kleinkram.contract.base import MAX_PAGE_SIZE
from kleinkram.contract.checks import (
    CheckAcceptanceCreate,
    CheckAcceptanceRead,
    CheckMatrix,
    CheckMatrixRow,
    CheckNoteCreate,
    CheckNoteRead,
    CheckReportCreate,
    CheckReportRead,
    CheckStatus,
    ChecksVersionRead,
    CheckTrend,
    MissionCheckFilter,
    MissionChecksRead,
    ProjectChecksRead,
    ProjectChecksUpdate,
    TrendStep,
)


class Checks(ApiResource):
    """`client.checks`."""

    def get(self, project: Ref) -> ProjectChecksRead:
        """Return the `checks.yaml` of a project; its `text` is empty if there is none."""
        return self._api.get(self._of_project(project), ProjectChecksRead)

    def set(self, project: Ref, text: str, *, if_match: str | None = None) -> ProjectChecksRead:
        """Make a text the `checks.yaml` of a project; all its missions are judged by it. An empty text removes it.

        Raises:
            YamlInvalid: with the line and column of its first problem; nothing changed.
            Forbidden: this requires WRITE on the project.
            EditConflict: the ETag of the present file is not `if_match`.
        """
        body = checked(ProjectChecksUpdate, "The file of checks", text=text)
        return self._api.send("PUT", self._of_project(project), ProjectChecksRead, body, etag=if_match)

    def history(self, project: Ref, *, limit: int | None = None) -> Listing[ChecksVersionRead]:
        """Yield the versions of a project's `checks.yaml`, latest first."""
        return pages(self._api, f"{self._of_project(project)}/versions", ChecksVersionRead, [], limit=limit)

    def version(self, project: Ref, number: int) -> ProjectChecksRead:
        """Return one version of a project's `checks.yaml`. Raises NotFound."""
        return self._api.get(f"{self._of_project(project)}/versions/{number}", ProjectChecksRead)

    def diff(self, project: Ref, text: str, *, number: int | None = None) -> str:
        """Return how a text differs from a project's `checks.yaml`, or from a version of it; empty if it does not."""
        old = self.get(project) if number is None else self.version(project, number)
        lines = difflib.unified_diff(
            old.text.splitlines(), text.splitlines(), f"checks.yaml (version {old.number})", "checks.yaml", lineterm=""
        )
        return "\n".join(lines)

    def mission(
        self,
        mission: Ref,
        *,
        history: bool = False,
        name: str | None = None,
        status: Sequence[CheckStatus | str] = (),
    ) -> MissionChecksRead:
        """Return the checks of a mission, worst first, and its verdict; with `history`, also what no longer counts.

        `name` (a glob) and `status` (any of them) select checks; a mission has up to 10,000.
        """
        matching = checked(MissionCheckFilter, "The filter", name=name, status=[*status])
        path = f"{self._of_mission(mission)}/checks"
        query = query_of(matching, all=history or None, limit=MAX_PAGE_SIZE)
        first = page = self._api.get(path, MissionChecksRead, query)
        checks = [*first.checks]
        while page.next is not None:
            page = self._api.get(path, MissionChecksRead, [*query, ("cursor", page.next)])
            checks += page.checks
        return first.model_copy(update={"checks": checks, "next": None})

    def report(self, mission: Ref, report: CheckReportCreate) -> CheckReportRead:
        """Store checks that were made of the files of a mission before or after they were uploaded."""
        return self._api.send("POST", f"{self._of_mission(mission)}/check-reports", CheckReportRead, report)

    def accept(self, mission: Ref, check: str, *, because: str, topic: str | None = None) -> CheckAcceptanceRead:
        """Let what fails of a check, on one topic or all, no longer count until the files of the mission change.

        Another topic, outcome, limit, action or version that fails later is a new failure, which counts.

        Raises:
            InvalidRequest: no such check fails, or it is accepted already.
            Forbidden: this requires WRITE on the mission.
        """
        body = checked(CheckAcceptanceCreate, "The acceptance", check=check, topic=topic, because=because)
        return self._api.send("POST", f"{self._of_mission(mission)}/check-acceptances", CheckAcceptanceRead, body)

    def withdraw(self, mission: Ref, acceptance_id: uuid.UUID) -> CheckAcceptanceRead:
        """Withdraw an acceptance: the check counts again."""
        path = f"{self._of_mission(mission)}/check-acceptances/{acceptance_id}"
        return self._api.parse_response(CheckAcceptanceRead, f"DELETE {path}", self._api.delete(path))

    def add_note(self, mission: Ref, check: str, text: str, *, topic: str | None = None) -> CheckNoteRead:
        """Add a note to a check of a mission."""
        body = checked(CheckNoteCreate, "The note", check=check, topic=topic, text=text)
        return self._api.send("POST", f"{self._of_mission(mission)}/check-notes", CheckNoteRead, body)

    def delete_note(self, mission: Ref, note_id: uuid.UUID) -> None:
        """Delete a note."""
        self._api.delete(f"{self._of_mission(mission)}/check-notes/{note_id}")

    def matrix(self, project: Ref, *, limit: int = 100) -> CheckMatrix:
        """Return at most `limit` missions of a project, latest first, with the worst status of each check."""
        path, cursor = f"{self._of_project(project)}/matrix", None
        rows: list[CheckMatrixRow] = []
        names: dict[str, None] = {}
        while True:
            query = query_of(None, limit=min(limit - len(rows), _PAGE), cursor=cursor)
            page = self._api.get(path, CheckMatrix, query)
            rows += page.items
            names |= dict.fromkeys(page.checks)
            cursor = page.next
            if cursor is None or len(rows) >= limit:
                return CheckMatrix(checks=[*names], items=rows, next=cursor)

    def trend(self, project: Ref, *, by: TrendStep | str = TrendStep.week) -> CheckTrend:
        """Return the number of missions by verdict, by the day or week in which they were recorded."""
        query = query_of(None, by=TrendStep(by))
        return self._api.get(f"{self._of_project(project)}/trend", CheckTrend, query)

    def _of_project(self, project: Ref) -> str:
        return f"/projects/{Projects(self._api).id_of(project)}/checks"

    def _of_mission(self, mission: Ref) -> str:
        return f"/missions/{Missions(self._api).id_of(mission)}"


_PAGE = 100
