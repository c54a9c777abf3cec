"""Names of compared files of one mission or of several."""

from kleinkram.cli.transfer import _named
from kleinkram.client.transfer import Comparison, FileComparison
from tests.api_objects import file_read


def _verified(mission: str) -> FileComparison:
    return FileComparison("a", Comparison.same, 1, None, file_read("a", mission=mission))


def test_paths_include_the_mission_if_there_are_several() -> None:
    missing = FileComparison("b", Comparison.missing, 1, None, None)
    assert [path for _, path in _named([_verified("day"), missing])] == ["a", "b"]
    assert [path for _, path in _named([_verified("day"), _verified("night")])] == ["alps/day/a", "alps/night/a"]
