"""The checks of `klein upload --check`: made before anything is sent, and stored with the mission afterwards."""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import JsonValue

from kleinkram.checks.facts import MissionFacts
from kleinkram.checks.local import read_mission
from kleinkram.checks.results import CheckResults
from kleinkram.cli.check import LoadedChecks, check_mission, load_checks, metadata_of, project_checks, results_text
from kleinkram.cli.render import note
from kleinkram.client import Client
from kleinkram.client.errors import MissionNotGood, NothingToDo
from kleinkram.client.transfer import TransferReport, UploadPlan
from kleinkram.contract.checks import CheckDepth, Verdict
from kleinkram.contract.missions import MissionRead


@dataclass(frozen=True)
class UploadChecks:
    """The options: a file of rules, and whether only a good mission is uploaded."""

    path: Path | None
    require_good: bool

    def run(
        self,
        client: Client,
        plan: UploadPlan,
        beside: str,
        project: str | None,
        mission: MissionRead | None,
        metadata_yaml: str | None,
    ) -> "CheckedUpload":
        """Check the files of a plan, and say on stderr what came of it.

        Raises:
            MissionNotGood: with `require_good`, if the verdict is not good.
            NoChecks: there are no rules: the project has none, and there is no checks.yaml.
        """
        rules = self._rules(client, mission.project.id if mission is not None else project or "", beside)
        metadata: Mapping[str, JsonValue] = (
            metadata_of(metadata_yaml, "--metadata") if mission is None else mission.metadata
        )
        local = read_mission({file.path: file.source for file in plan.files}, metadata)
        results = check_mission(rules.document, local, plan.left_out, CheckDepth.content)
        for text in results_text(results, rules.source):
            note(text)
        if self.require_good and results.verdict is not Verdict.good:
            raise MissionNotGood(verdict=results.verdict.value)
        return CheckedUpload(rules, local.facts, results)

    def _rules(self, client: Client, project: str | uuid.UUID, beside: str) -> LoadedChecks:
        if self.path is not None:
            return load_checks(self.path, beside)
        try:
            return project_checks(client, project)
        except NothingToDo:  # the project has none
            return load_checks(None, beside)


@dataclass(frozen=True)
class CheckedUpload:
    """The checks of an upload, before it."""

    rules: LoadedChecks
    facts: MissionFacts
    results: CheckResults

    def to_plain(self) -> dict[str, object]:
        """Return them as a part of the JSON document of the upload."""
        return {"checks_file": self.rules.source, "check_results": self.results.to_plain()}

    def store(self, client: Client, mission_id: uuid.UUID, report: TransferReport) -> None:
        """Store the outcome with the mission, if all checked recordings were uploaded."""
        sha256s = {result.path: result.sha256 for result in report.results if result.error is None}
        paths = [path for recording in self.facts.recordings for path in recording.paths]
        files = {path: sha256 for path in paths if (sha256 := sha256s.get(path)) is not None}
        if not files or len(files) < len(paths) or not self.results.checks:
            note("The outcome of the checks was not stored, because not all checked recordings were uploaded.")
            return
        client.checks.report(mission_id, self.results.to_report(self.rules.text, files))
        note("Stored the outcome of the checks with the mission.")
