"""What the server says of the real recordings is what is read here; they are uploaded once for all these tests."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from kleinkram.recordings import Depth, FileSource, Lost
from kleinkram.recordings.inspect import Inspection, InspectionKind, inspect_paths
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.integration.corpus import Corpus
from tests.integration.recordings.test_agreement import found_on_server

pytestmark = pytest.mark.slow
# What is odd about the whole; what is odd inside one file, the server tells with the file.
_OF_THE_WHOLE = ("metadata-", "member-", "topic-types-differ")
_NOT_HEALTHY = {
    "broken/metadata_only_data_missing": {"member-missing"},
    "broken/wrong_rmw_db3": {"metadata-encoding"},
    "derived/metadata_wrong_counts": {"metadata-count", "metadata-topic-count"},
    "derived/split_missing_file": {"member-missing"},
}


def test_the_server_agrees_with_all_readers_on_every_real_recording(corpus: Corpus) -> None:
    assert found_on_server(corpus.api, corpus.mission_id, corpus.folder) == {}


def test_every_real_recording_has_the_same_summary_on_the_server(corpus: Corpus) -> None:
    api = corpus.api
    listed = {item["path"]: item for item in api.all("/files", {"mission_id": corpus.mission_id})}
    topics: dict[str, set[tuple[str, str, int]]] = {}
    for topic in api.all("/topics", {"mission_id": corpus.mission_id, "limit": "500"}):
        topics.setdefault(topic["file_id"], set()).add((topic["name"], topic["message_type"], topic["count"]))
    assert listed.keys() == corpus.files.keys()
    for name, read in listed.items():
        with FileSource(corpus.folder / name) as source:
            here = scan(SourceReader(source))
        assert read["state"] == "verified", name
        assert (read["content"], read["message_count"]) == (here.content.value, here.message_count), name
        assert (read["start_ns"], read["end_ns"]) == (here.start_ns, here.end_ns), name
        assert (read["lost"] and Lost(**read["lost"])) == here.lost, name
        assert topics.get(read["id"], set()) == {(t.name, t.message_type, t.count) for t in here.topics}, name


def _problems(problems: Any) -> list[tuple[str, str, str]]:
    named = [(item["code"], item["where"], item["message"]) for item in problems]
    return [item for item in named if item[0].startswith(_OF_THE_WHOLE)]


def test_every_real_recording_of_several_files_has_equal_summaries(corpus: Corpus) -> None:
    named = {item["name"]: item for item in corpus.api.all(f"/missions/{corpus.mission_id}/recordings")}
    here = {item.path: item for item in inspect_paths([corpus.folder], depth=Depth.scan)}
    several = {
        path.removeprefix(f"{corpus.folder}/"): item
        for path, item in here.items()
        if item.kind is InspectionKind.recording
    }
    assert {name for name, item in named.items() if item["kind"] != "single"} == several.keys()
    assert several.keys() >= {*_NOT_HEALTHY, "ros2-db3/file_zstd_split"}
    for name, inspection in several.items():
        _same(named[name], inspection, corpus.folder)
        codes = {code for code, _, _ in _problems(named[name]["problems"])}
        assert codes == _NOT_HEALTHY.get(name, set()), name


def _same(named: Mapping[str, Any], here: Inspection, folder: Path) -> None:
    summary = here.summary
    members = [path for path in named["paths"] if not path.endswith("metadata.yaml")]
    assert sorted(members) == sorted(path.removeprefix(f"{folder}/") for path in here.members)
    assert (named["content"], named["content_reason"]) == (summary.content.value, summary.reason), here.path
    assert (named["message_count"], named["start_ns"], named["end_ns"]) == (
        summary.message_count,
        summary.start_ns,
        summary.end_ns,
    ), here.path
    assert (named["lost"] and named["lost"]["messages"]) == (summary.lost and summary.lost.messages), here.path
    assert _problems(named["problems"]) == _problems(vars(item) for item in summary.problems), here.path
