# /// script
# requires-python = ">=3.10"
# dependencies = ["open-kleinkram[reading]"]
#
# [tool.kleinkram]
# name = "verify"
# description = "Checks a mission by the checks.yaml of its project, also by samples of its messages."
# inputs = {checks = true}
# network = "api"
# right = "CREATE"
# resources = {cores = 1, memory = "2GB", disk = "1GB", time = "2h"}
# ///
"""The checks of a mission by the `checks.yaml` of its project, from the indexes and from samples of the messages.

A run on a server also sends them as a report, so that they count as the checks of the mission. They are those of the
files and rules that the run was launched with; the server compares both with the present ones.
"""

import csv
import os
import sys
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

import kleinkram
from kleinkram.action import context, out, progress, report
from kleinkram.action.run_files import in_dir
from kleinkram.checks.content.families import need_content
from kleinkram.checks.document import ChecksDocument, read_checks
from kleinkram.checks.facts import MissionFacts
from kleinkram.checks.local import read_mission
from kleinkram.checks.results import CheckResults, choose_profiles, evaluate
from kleinkram.contract.checks import MAX_REPORT_FILES, Check, CheckDepth, Verdict
from kleinkram.contract.errors import KleinkramError, YamlInvalid
from kleinkram.contract.runs import RunChecks
from kleinkram.recordings.decoding import ReadingExtraMissing

COLUMNS = ("status", "name", "topic", "file", "value", "limit", "unit", "time_ns", "message")
LIBRARIES = {"numpy": "numpy", "PIL": "pillow"}
INDEX_SHARE = 0.3


def main() -> None:
    """Check the mission, report each check, and send the report; exit with 1 and a sentence if that is impossible."""
    rules = context().checks
    if rules is None:
        say_nothing_judged("the project has no checks.yaml; `klein checks set` sets it")
        return
    document = read_rules(rules)
    chosen = choose_profiles(document, context().mission.metadata)
    if not chosen.applied:
        reasons = "; ".join(f"{profile.name}: {profile.reason}" for profile in chosen.left_out)
        say_nothing_judged(f"no profile of the checks.yaml applies to the mission ({reasons})")
        return
    if need_content(chosen.applied):
        require_libraries()
    results, facts = check(document)
    report_results(results)
    send(results, facts, rules)


def say_nothing_judged(reason: str) -> None:
    """Report why the mission is not judged."""
    report.finding("info", "checks.none", f"Nothing was checked: {reason}."[:2000])
    print(f"Nothing was checked: {reason}.")


def read_rules(rules: RunChecks) -> ChecksDocument:
    """Return the rules. Exits where this version of Kleinkram cannot read them."""
    try:
        return read_checks(rules.text)
    except YamlInvalid as error:
        sys.exit(f"The checks.yaml of the project (version {rules.version}) cannot be read here. {error.sentence()}")


def require_libraries() -> None:
    """Exit where a library for reading messages is not installed."""
    for module, library in LIBRARIES.items():
        if find_spec(module) is None:
            sys.exit(f"The messages cannot be read: {ReadingExtraMissing(library)}.")


def check(document: ChecksDocument) -> tuple[CheckResults, MissionFacts]:
    """Check the inputs as a mission. Exits where a file is missing."""
    files = {file.path: in_dir / file.path for file in context().files}
    for path, local in files.items():
        if not local.is_file():  # it was moved after the launch
            sys.exit(f"{path} is not among the inputs: the mission changed since the launch. Run it again.")
    mission = read_mission(files, context().mission.metadata, show=shown(0.0, INDEX_SHARE))
    results = evaluate(document, mission, CheckDepth.content, show=shown(INDEX_SHARE, 0.9 - INDEX_SHARE))
    return results, mission.facts


def shown(begin: float, share: float) -> Callable[[float, str], None]:
    """Return a function that reports the progress of a part of the work."""
    return lambda fraction, name: progress(begin + share * fraction, name[-200:])


def report_results(results: CheckResults) -> None:
    """Report each check and the verdict, and write all of them as a table."""
    progress(0.9, "Reporting")
    for one in results.checks:
        report.check(
            one.name,
            one.status.value,
            one.message,
            value=one.value,
            limit=one.limit,
            unit=one.unit,
            topic=one.topic,
            file=one.file,
            time_ns=one.time_ns,
        )
    if results.checks:
        write_table(out / "checks.csv", results.checks)
        report.preview(out / "checks.csv", "Checks")
    if results.verdict in (Verdict.good, Verdict.warnings, Verdict.bad):
        report.verdict(results.verdict.value)
    counts = ", ".join(f"{count} {status.value}" for status, count in results.counts.items() if count)
    print(f"The verdict is {results.verdict.value} ({counts or 'no checks'}).")


def write_table(path: Path, checks: tuple[Check, ...]) -> None:
    """Write one line for each check."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        for one in checks:
            row = one.model_dump(mode="json")
            table.writerow([row[name] for name in COLUMNS])


def send(results: CheckResults, facts: MissionFacts, rules: RunChecks) -> None:
    """Send the checks as a report of the mission; exits where the server does not take it."""
    if context().run_id is None or not os.environ.get("KLEINKRAM_TOKEN"):
        print("Nothing was sent: this run has no access to the server. Its checks do not count there.")
        return
    files = checked_files(facts)
    if not results.checks or len(files) > MAX_REPORT_FILES:
        reason = f"it has {len(files)} files, of at most {MAX_REPORT_FILES}" if results.checks else "no check was made"
        report.finding("warning", "checks.not_sent", f"No report of the checks was sent: {reason}.")
        return
    try:
        with kleinkram.connect() as client:
            stored = client.checks.report(context().mission.id, results.to_report(rules.text, files))
    except KleinkramError as error:
        sys.exit(f"The report of the checks could not be sent. {error}")
    if not stored.is_current:
        report.finding("info", "checks.outdated", "Files, metadata or rules changed since the launch: run it again.")


def checked_files(facts: MissionFacts) -> Mapping[str, str]:
    """Return the SHA-256 of the files that belong to recordings, by path; of all files if there are no recordings."""
    recorded = {path for recording in facts.recordings for path in recording.paths}
    sha256s = {file.path: file.sha256 for file in context().files if file.sha256 is not None}
    return {path: sha256 for path, sha256 in sha256s.items() if not recorded or path in recorded}


if __name__ == "__main__":
    main()
