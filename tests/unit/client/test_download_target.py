"""Nothing is written outside the destination, whatever names the server sends."""

from pathlib import Path

import pytest

from kleinkram.client.errors import DestinationRefused, PathsCollide
from kleinkram.client.transfer import plan_download
from kleinkram.client.transfer.download_target import make_folders, partial_path
from tests.api_objects import file_read


@pytest.mark.parametrize(
    "path", ["../out", "/etc/passwd", "a/../../out", "a//b", "a/./b", "", "a/", "new\nline", "nul\0", "back\\slash"]
)
def test_a_hostile_name_is_refused(tmp_path: Path, path: str) -> None:
    plan = plan_download([file_read(path)], tmp_path)
    assert plan.targets == []
    assert [type(error) for error in plan.left_out] == [DestinationRefused]


@pytest.mark.parametrize("mission", ["..", "a/../..", ""])
def test_a_hostile_mission_is_refused_when_nested(tmp_path: Path, mission: str) -> None:
    assert len(plan_download([file_read("x", mission=mission)], tmp_path, nested=True).left_out) == 1


def test_nested_puts_project_and_mission_before_the_path(tmp_path: Path) -> None:
    (flat,) = plan_download([file_read("sub/a.bag")], tmp_path).targets
    (nested,) = plan_download([file_read("sub/a.bag")], tmp_path, nested=True).targets
    assert flat.local == tmp_path / "sub/a.bag"
    assert nested.local == tmp_path / "alps/day/sub/a.bag"


@pytest.mark.parametrize("other", ["a", "a/b"])
def test_two_files_with_one_destination_are_both_named(tmp_path: Path, other: str) -> None:
    files = [file_read("a"), file_read(other, mission="night")]
    with pytest.raises(PathsCollide, match=r"(alps/day/a.*alps/night/|alps/night/.*alps/day/a).* --nested "):
        plan_download(files, tmp_path)
    assert len(plan_download(files, tmp_path, nested=True).targets) == 2


def test_conflicts_within_one_mission_do_not_suggest_separate_folders(tmp_path: Path) -> None:
    files = [file_read("a"), file_read("a/b")]
    with pytest.raises(PathsCollide) as caught:
        plan_download([files[0], files[1].model_copy(update={"mission": files[0].mission})], tmp_path)
    assert "--nested" not in str(caught.value)


def test_links_inside_may_be_followed_and_links_out_may_not(tmp_path: Path) -> None:
    dest, outside = tmp_path / "dest", tmp_path / "outside"
    (dest / "real").mkdir(parents=True)
    outside.mkdir()
    (dest / "inside").symlink_to(dest / "real")
    (dest / "out").symlink_to(outside)
    (dest / "file").write_bytes(b"")
    assert make_folders(dest, "inside/deep/a.bag").parent.is_dir()
    assert (dest / "real" / "deep").is_dir()
    for path in ("out/a.bag", "out/deep/a.bag", "file/a.bag"):
        with pytest.raises(DestinationRefused):
            make_folders(dest, path)
    assert [*outside.iterdir()] == []


def test_a_destination_that_is_a_symbolic_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "dest").symlink_to(tmp_path / "disk")
    make_folders(tmp_path / "dest", "sub/a.bag")
    assert (tmp_path / "disk" / "sub").is_dir()


def test_the_temporary_name_is_not_too_long() -> None:
    assert partial_path(Path("d/a.bag"), ".klein-part") == Path("d/a.bag.klein-part")
    assert len(partial_path(Path("d/" + "ü" * 127), ".klein-part").name.encode()) <= 255
