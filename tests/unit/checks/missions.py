"""Facts of missions for tests: a good one, and parts of it with changes."""

from dataclasses import replace
from typing import Any

from kleinkram.checks.document import ChecksDocument, read_checks
from kleinkram.checks.facts import FileFacts, MissionFacts, RecordingFacts, TopicFacts
from kleinkram.checks.results import CheckResults, evaluate_index
from kleinkram.contract.checks import Check
from kleinkram.recordings.model import Content

SECOND = 10**9
START_NS = 1_700_000_000 * SECOND
END_NS = START_NS + 60 * SECOND


def file_facts(path: str = "nuc/drive.mcap", **changes: Any) -> FileFacts:
    """Return a complete file of 50 MB."""
    return replace(FileFacts(path, 50_000_000, Content.indexed), **changes)


def recording_facts(name: str = "nuc/drive.mcap", **changes: Any) -> RecordingFacts:
    """Return a complete recording of one minute in one file."""
    return replace(RecordingFacts(name, (name,), Content.indexed, None, START_NS, END_NS), **changes)


def topic_facts(name: str = "/imu/data", **changes: Any) -> TopicFacts:
    """Return a topic of 200 Hz over the whole minute."""
    facts = TopicFacts(name, "sensor_msgs/msg/Imu", 12_001, START_NS, END_NS, 200.0, 6_000_000, ("nuc/drive.mcap",))
    return replace(facts, **changes)


def mission_facts(*topics: TopicFacts, **changes: Any) -> MissionFacts:
    """Return a mission of one recording; of one IMU if no topics are passed."""
    facts = MissionFacts((file_facts(),), (recording_facts(),), topics or (topic_facts(),), START_NS, END_NS, {})
    return replace(facts, **changes)


def rules(section: str, glob: str = "/imu/data", rule: str = "{}") -> ChecksDocument:
    """Return a document with one rule."""
    return read_checks(f"version: 1\nprofiles:\n- {section}:\n    '{glob}': {rule}\n")


def evaluated(document: ChecksDocument, facts: MissionFacts) -> CheckResults:
    """Return the results, after a test that they can be written as JSON."""
    results = evaluate_index(document, facts)
    assert results.to_plain()["verdict"] == results.verdict.value
    return results


def only(results: CheckResults, name: str) -> Check:
    """Return the one check of this name."""
    checks = [check for check in results.checks if check.name == name]
    assert len(checks) == 1, [(check.name, check.message) for check in results.checks]
    return checks[0]
