"""A store that loses or alters objects: scrub and verification report it, and uploading the same files repairs them."""

import os
import time
from pathlib import Path
from typing import Any

import pytest

from kleinkram.client import connect
from kleinkram.server.context import AppContext
from tests.system import backend
from tests.system.cluster import Cluster

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

_DAMAGE = {
    "gone.bin": ("lost", "no longer"),
    "cut.bin": ("corrupt", "1000 bytes"),
    "altered.bin": ("corrupt", "CRC-64"),
}


def _damage_objects(cluster: Cluster, bodies: dict[str, bytes]) -> None:
    """Delete, truncate or alter each object in the store, as the name of its file says."""
    keys = dict(backend.sql(cluster, "SELECT f.path, b.key FROM file f JOIN blob b ON b.id = f.blob_id"))
    altered = bodies["altered.bin"]

    async def do(context: AppContext) -> None:
        await context.storage.delete(keys["gone.bin"])
        await context.storage.put_object(keys["cut.bin"], bodies["cut.bin"][:1000])
        await context.storage.put_object(keys["altered.bin"], altered[:-1] + bytes([altered[-1] ^ 1]))

    backend.run_in_context(cluster, do)


def _states(terminal: Any) -> dict[str, tuple[str, str | None]]:
    runtime_info = terminal.run("mission", "info", "-p", "p", "-m", "m", "--json").json()
    return {file["path"]: (file["state"], file["state_reason"]) for file in runtime_info["files"]}


def test_lost_truncated_and_altered_objects_are_reported_and_repaired_by_uploading_again(
    cluster: Cluster, tmp_path: Path
) -> None:
    cluster.start()
    terminal, folder = cluster.terminal, tmp_path / "day"
    folder.mkdir()
    bodies = {name: os.urandom(5000) for name in (*_DAMAGE, "good.bin", "better.bin")}
    for name, body in bodies.items():
        (folder / name).write_bytes(body)
    terminal.run("project", "create", "p")
    terminal.run("upload", *sorted(folder.iterdir()), "-p", "p", "-m", "m", "--create")
    terminal.run("verify", "--remote", "-p", "p", "-m", "m")
    assert terminal.run("admin", "scrub", "--json").json()["last"]["compared"] == len(bodies)
    _damage_objects(cluster, bodies)

    scrubbed = terminal.run("admin", "scrub", code=9)
    assert "newly lost:    1" in scrubbed.out
    assert "newly corrupt: 1" in scrubbed.out
    verified = terminal.run("verify", "--remote", "-p", "p", "-m", "m", code=9)
    assert "Upload it again to repair it." in verified.err
    states = _states(terminal)
    for name, (state, why) in _DAMAGE.items():
        assert states[name][0] == state
        assert why in str(states[name][1])
        assert why in terminal.run("file", "info", name, "-p", "p", "-m", "m").out
    assert states["good.bin"] == ("verified", None)
    shown = terminal.run("mission", "info", "-p", "p", "-m", "m").out
    assert "WHAT DIFFERS" in shown
    terminal.run("download", "-p", "p", "-m", "m", "--dest", tmp_path / "none", code=9)

    terminal.run("upload", *sorted(folder.iterdir()), "-p", "p", "-m", "m")
    assert "same" in terminal.run("verify", "--remote", "-p", "p", "-m", "m").out
    assert set(_states(terminal).values()) == {("verified", None)}
    again = terminal.run("admin", "scrub", "--json").json()
    assert (again["last"]["lost"], again["last"]["corrupt"], again["last"]["aborted_reason"]) == (0, 0, None)
    terminal.run("download", "-p", "p", "-m", "m", "--dest", tmp_path / "back")
    assert {path.name: path.read_bytes() for path in (tmp_path / "back").rglob("*.bin")} == bodies
    backend.tidy(cluster)
    assert len(backend.objects(cluster)) == len(bodies), "what was damaged went with the sweep"


def _flip_byte(cluster: Cluster, needle: bytes) -> None:
    """Change one byte of an object on the store's disk, where its content has `needle`."""
    for path in cluster.data_dir.rglob("*.dat"):
        at = path.read_bytes().find(needle)
        if at >= 0:
            with path.open("r+b") as file:
                file.seek(at)
                file.write(bytes([needle[0] ^ 1]))
            return
    raise AssertionError("no object on disk has it")


def test_a_download_reports_a_damaged_object_within_a_minute(cluster: Cluster, tmp_path: Path) -> None:
    cluster.start()
    terminal, folder = cluster.terminal, tmp_path / "day"
    folder.mkdir()
    needle = os.urandom(32)
    (folder / "drive.bin").write_bytes(os.urandom(20_000) + needle + os.urandom(300_000))
    (folder / "other.bin").write_bytes(os.urandom(5000))
    terminal.run("project", "create", "p")
    terminal.run("upload", *sorted(folder.iterdir()), "-p", "p", "-m", "m", "--create")
    terminal.run("verify", "--remote", "-p", "p", "-m", "m")
    _flip_byte(cluster, needle)
    began = time.monotonic()
    ran = terminal.run("download", "-p", "p", "-m", "m", "--dest", tmp_path / "back", code=9)
    assert time.monotonic() - began < 75, "a minute, and the start of a program on a busy machine"
    assert "corrupt" in ran.err
    assert "away" not in ran.err
    assert [path.name for path in (tmp_path / "back").rglob("*.bin")] == ["other.bin"]
    state, why = _states(terminal)["drive.bin"]
    assert (state, "serves others" in str(why)) == ("corrupt", True)
    token = (cluster.data_dir / "owner-token").read_text().strip()
    with connect(cluster.runtime_info()["url"], token) as client:
        needs = {(item.kind.value, item.count) for item in client.home.get().attention}
    assert ("files_corrupt", 1) in needs
