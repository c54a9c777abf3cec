"""Transfers that are interrupted, concurrent, refused or resumed."""

import os
import signal
from pathlib import Path

import pytest

from tests.acceptance.conftest import Instance, Terminal, end, wait_until

MIB = 1024 * 1024
PART, RANGE = 5 * MIB, 8 * MIB  # sizes of the parts of uploads and the ranges of downloads


def random_file(path: Path, size: int) -> Path:
    """Write a new file with an old time: recently written files are watched for a second."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(os.urandom(size))
    os.utime(path, (1_700_000_000, 1_700_000_000))
    return path


def test_an_upload_that_was_killed_sends_only_the_rest(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "big.bin", 6 * PART + 5)
    upload = ["upload", "-p", project, "-m", "m", "--create", file, "--connections", "2"]
    process = terminal.start(*upload, "--limit-rate", "10MiB")
    wait_until(lambda: terminal.parts_sent() >= 2, "two parts sent")
    process.send_signal(signal.SIGKILL)
    end(process)
    part_count = terminal.parts_sent()
    (journal,) = terminal.journals()
    with journal.open("a") as out:
        out.write('{"number": 5, "chec')  # a line cut off by the kill

    (resumed,) = terminal.run(*upload, "--json").json()["items"]
    assert resumed["outcome"] == "uploaded"
    assert resumed["moved_bytes"] == file.stat().st_size - part_count * PART
    assert terminal.journals() == []
    terminal.run("verify", "-p", project, "-m", "m", file)


@pytest.mark.slow
def test_bytes_that_changed_between_two_runs_are_sent_again(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "big.bin", 5 * PART)
    upload = ["upload", "-p", project, "-m", "m", "--create", file, "--connections", "1"]
    process = terminal.start(*upload, "--limit-rate", "10MiB")
    wait_until(lambda: terminal.parts_sent() >= 2, "two parts sent")
    process.send_signal(signal.SIGKILL)
    end(process)
    part_count = terminal.parts_sent()
    with file.open("r+b") as out:
        out.write(b"other")  # in the first part, which the store has

    (resumed,) = terminal.run(*upload, "--json").json()["items"]
    assert resumed["moved_bytes"] == file.stat().st_size - (part_count - 1) * PART
    terminal.run("verify", "-p", project, "-m", "m", file)


def test_ctrl_c_stops_at_once_and_explains_how_to_continue(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "big.bin", 4 * PART)
    process = terminal.start("upload", "-p", project, "-m", "m", "--create", file, "--limit-rate", "8MiB")
    wait_until(lambda: bool(terminal.journals()), "the upload has begun")
    process.send_signal(signal.SIGINT)
    stopped = end(process)
    assert stopped.code == 130
    assert "same command again" in stopped.err
    assert "Traceback" not in stopped.err


@pytest.mark.slow
@pytest.mark.parametrize("part", ["store", "api"])
def test_an_upload_survives_a_crash_of_the_server(
    terminal: Terminal, instance: Instance, project: str, tmp_path: Path, part: str
) -> None:
    file = random_file(tmp_path / "big.bin", 6 * PART)
    process = terminal.start("upload", "-p", project, "-m", "m", "--create", file, "--limit-rate", "10MiB")
    wait_until(lambda: terminal.parts_sent() >= 1, "a part sent")
    dead = instance.kill_process(part)
    ended = end(process)
    assert ended.code == 0, ended.err
    wait_until(lambda: instance.runtime_info()["services"].get(part) not in {None, dead}, "the part was started again")
    terminal.run("verify", "-p", project, "-m", "m", file)


def test_a_file_that_changes_while_it_is_read_is_refused(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "growing.bin", 4 * PART)
    calm = random_file(tmp_path / "calm.bin", 1000)
    process = terminal.start("upload", "-p", project, "-m", "m", "--create", file, calm, "--limit-rate", "10MiB")
    wait_until(lambda: terminal.parts_sent() >= 1, "a part sent")
    with file.open("ab") as out:
        out.write(b"more")
    ended = end(process)
    assert ended.code == 8
    assert "changed while it was being read" in ended.err
    there = terminal.run("file", "list", "-p", project, "-m", "m", "--json").json()["items"]
    assert [item["path"] for item in there] == ["calm.bin"]
    terminal.run("upload", "-p", project, "-m", "m", file)
    terminal.run("verify", "-p", project, "-m", "m", file, calm)


def test_one_of_two_uploads_of_the_same_name_succeeds(
    terminal: Terminal, other_terminal: Terminal, project: str, tmp_path: Path
) -> None:
    terminal.run("mission", "create", "m", "-p", project)
    one = random_file(tmp_path / "1" / "cam.bin", 3 * PART)
    two = random_file(tmp_path / "2" / "cam.bin", 3 * PART)
    first = terminal.start("upload", "-p", project, "-m", "m", one, "--limit-rate", "10MiB")
    second = other_terminal.start("upload", "-p", project, "-m", "m", two, "--limit-rate", "10MiB")
    ends = [end(first), end(second)]
    assert sorted(ended.code for ended in ends) == [0, 5], ends
    winner = one if ends[0].code == 0 else two
    terminal.run("verify", "-p", project, "-m", "m", winner)


def test_files_already_uploaded_are_not_sent_again(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "a.bin", PART + 1000)
    upload = ["upload", "-p", project, "-m", "m", "--create", file, "--json"]
    (first,) = terminal.run(*upload).json()["items"]
    (again,) = terminal.run(*upload).json()["items"]
    assert (again["outcome"], again["moved_bytes"], again["file_id"]) == ("already_present", 0, first["file_id"])

    terminal.run("verify", "--remote", first["file_id"])  # verified now, so that others may link to it
    (linked,) = terminal.run("upload", "-p", project, "-m", "other", "--create", file, "--json").json()["items"]
    assert (linked["outcome"], linked["moved_bytes"]) == ("deduplicated", 0)

    with file.open("r+b") as out:
        out.write(b"other")
    refused = terminal.run("upload", "-p", project, "-m", "m", file, code=5).err
    assert first["sha256"] in refused
    terminal.run("verify", "-p", project, "-m", "m", file, code=9)


def test_many_sizes_and_unusual_names_are_downloaded_unchanged(
    terminal: Terminal, project: str, tmp_path: Path
) -> None:
    folder = tmp_path / "odd"
    sizes = {"empty": 0, "one byte": 1, "sub/grüße 🤖.bin": 3000, "sub/deep/a'b$.bin": PART, "x.bin": PART + 1}
    for name, size in sizes.items():
        random_file(folder / name, size)
    os.mkfifo(folder / "pipe")
    random_file(folder / "run.mcap.active", 100)
    (folder / os.fsdecode(b"bad\xff.bin")).write_bytes(b"x")
    (folder / "new\nline.bin").write_bytes(b"x")
    ended = terminal.run("upload", "-p", project, "-m", "m", "--create", f"{folder}/", code=8)
    for named in ("pipe", "run.mcap.active", "bad\\xff.bin", "new\\nline.bin"):
        assert named in ended.err.replace("\\\\", "\\"), named
    terminal.run("download", "-p", project, "-m", "m", "--dest", tmp_path / "back")
    for name in sizes:
        assert (tmp_path / "back" / name).read_bytes() == (folder / name).read_bytes()
    assert not [*(tmp_path / "back").rglob("*.klein-*")]


def test_paths_of_uploaded_folders_depend_on_a_trailing_slash(terminal: Terminal, project: str, tmp_path: Path) -> None:
    random_file(tmp_path / "day1" / "sub" / "a.bin", 10)

    def planned(path: str) -> list[str]:
        report = terminal.run("upload", "-p", project, "-m", "m", "--create", "--dry-run", "--json", path).json()
        return [item["path"] for item in report["items"]]

    assert planned(f"{tmp_path}/day1") == ["day1/sub/a.bin"]
    assert planned(f"{tmp_path}/day1/") == ["sub/a.bin"]
    assert planned(f"{tmp_path}/day1/sub/a.bin") == ["a.bin"]
    random_file(tmp_path / "day2" / "sub" / "a.bin", 10)
    collision = terminal.run(
        "upload", "-p", project, "-m", "m", "--create", f"{tmp_path}/day1/", f"{tmp_path}/day2/", code=5
    ).err
    assert "day1/sub/a.bin" in collision
    assert "day2/sub/a.bin" in collision


def test_a_download_that_was_killed_fetches_only_the_rest(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "big.bin", 6 * RANGE)
    terminal.run("upload", "-p", project, "-m", "m", "--create", file)
    dest = tmp_path / "back"
    download = ["download", "-p", project, "-m", "m", "--dest", dest, "--connections", "1"]
    process = terminal.start(*download, "--limit-rate", "16MiB")
    journal = dest / "big.bin.klein-journal"

    def ranges() -> int:
        return len(journal.read_text().splitlines()) - 1 if journal.exists() else 0

    wait_until(lambda: ranges() >= 2, "two ranges fetched")
    process.send_signal(signal.SIGKILL)
    end(process)
    assert not (dest / "big.bin").exists()
    part_count = ranges()

    (resumed,) = terminal.run(*download, "--json").json()["items"]
    assert resumed["moved_bytes"] == file.stat().st_size - part_count * RANGE
    assert (dest / "big.bin").read_bytes() == file.read_bytes()
    assert [path.name for path in dest.iterdir()] == ["big.bin"]


@pytest.mark.slow
def test_a_download_does_not_replace_existing_files(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "a.bin", 1000)
    terminal.run("upload", "-p", project, "-m", "m", "--create", file)
    dest = tmp_path / "back"
    download = ["download", "-p", project, "-m", "m", "--dest", dest]
    terminal.run(*download)
    (present,) = terminal.run(*download, "--json").json()["items"]
    assert present["outcome"] == "already_present"

    (dest / "a.bin").write_bytes(b"mine")
    terminal.run(*download, code=11)
    assert (dest / "a.bin").read_bytes() == b"mine"
    terminal.run(*download, "--overwrite")
    assert (dest / "a.bin").read_bytes() == file.read_bytes()

    outside = tmp_path / "outside"
    outside.mkdir()
    (dest / project).symlink_to(outside)
    assert "leads out" in terminal.run(*download, "--nested", code=11).err
    assert [*outside.iterdir()] == []
    terminal.run("download", "-p", project, "nothing*", "--dest", dest, code=3)


def test_two_missions_with_equal_paths_need_nesting(terminal: Terminal, project: str, tmp_path: Path) -> None:
    for mission in ("m1", "m2"):
        terminal.run("upload", "-p", project, "-m", mission, "--create", random_file(tmp_path / mission / "a.bin", 10))
    dest = tmp_path / "back"
    refused = terminal.run("download", "-p", project, "--dest", dest, code=5).err
    assert "m1/a.bin" in refused
    assert "m2/a.bin" in refused
    assert not dest.exists()
    terminal.run("download", "-p", project, "--dest", dest, "--nested")
    for mission in ("m1", "m2"):
        assert (dest / project / mission / "a.bin").read_bytes() == (tmp_path / mission / "a.bin").read_bytes()


def test_deleting_a_project_ends_its_uploads(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "big.bin", 6 * PART)
    upload = ["upload", "-p", project, "-m", "m", "--create", file, "--connections", "1"]
    process = terminal.start(*upload, "--limit-rate", "8MiB")
    wait_until(lambda: terminal.parts_sent() >= 1, "a part sent")
    terminal.run("project", "delete", project, "--yes")
    ended = end(process)
    assert ended.code == 3, ended.err
    assert "Traceback" not in ended.err


@pytest.mark.slow
def test_expired_presigned_urls_are_requested_again(terminal: Terminal, project: str, tmp_path: Path) -> None:
    file = random_file(tmp_path / "big.bin", 4 * PART)
    slowly = ["--limit-rate", "6MiB", "--connections", "1"]  # longer than URLs are valid in these tests, 4 s
    terminal.run("upload", "-p", project, "-m", "m", "--create", file, *slowly)
    terminal.run("download", "-p", project, "-m", "m", "--dest", tmp_path / "back", *slowly)
    assert (tmp_path / "back" / "big.bin").read_bytes() == file.read_bytes()
