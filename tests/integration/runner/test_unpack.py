"""Layers of images are unpacked below their folder, whatever they contain."""

from __future__ import annotations

import json
import stat
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from kleinkram.runner.executors import process_sandbox
from kleinkram.runner.images import unpack
from kleinkram.runner.images.unpack import UnpackRequest, UnpackResult
from tests.integration.runner.registry_images import entry, gzipped, layer_of, zstandard_of
from tests.requirements import missing

MB = 10**6


def unpacked(
    folder: Path, *layers: bytes, directories: tuple[str, ...] = (), limit_bytes: int = 100 * MB
) -> UnpackResult:
    """Unpack layers below `folder/root`, as runners do."""
    if not process_sandbox.is_available():
        missing("this kernel gives no namespaces to this user")
    root = folder / "root"
    root.mkdir()
    paths = []
    for number, layer in enumerate(layers):
        paths.append(folder / f"layer-{number}")
        paths[-1].write_bytes(layer)
    request = UnpackRequest([str(path) for path in paths], directories, limit_bytes)
    command = [sys.executable, "-I", "-m", unpack.__name__, str(root)]
    done = subprocess.run(command, input=json.dumps(request), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return UnpackResult(*json.loads(done.stdout))


def files_of(folder: Path) -> dict[str, bytes]:
    root = folder / "root"
    paths = [path for path in root.rglob("*") if path.is_file() and not path.is_symlink()]
    return {str(path.relative_to(root)): path.read_bytes() for path in paths if path.parent != root / "etc"}


def folder_of(name: str) -> tarfile.TarInfo:
    return entry(name, tarfile.DIRTYPE, mode=0o755)


def test_layers_of_each_compression_are_applied_in_order(tmp_path: Path) -> None:
    result = unpacked(
        tmp_path,
        layer_of((entry("a"), b"1"), (entry("b"), b"1"), folder_of("d"), (entry("d/c"), b"1"), (entry("e"), b"1")),
        gzipped(layer_of((entry("./b"), b"2"), entry("d", tarfile.SYMTYPE, "/elsewhere"))),
        zstandard_of(layer_of((entry("/c/d"), b"3"), folder_of("e"), (entry("e/f"), b"3"))),
    )
    assert result.error == ""
    assert files_of(tmp_path) == {"a": b"1", "b": b"2", "c/d": b"3", "e/f": b"3"}
    assert (tmp_path / "root" / "d").readlink() == Path("/elsewhere")


def test_whiteouts_remove_what_lower_layers_have(tmp_path: Path) -> None:
    below = layer_of((entry("kept"), b"1"), (entry("gone"), b"1"), (entry("d/old"), b"1"), (entry("d/sub/old"), b"1"))
    above = layer_of(entry(".wh.gone"), entry(".wh.never"), (entry("d/sub/new"), b"2"), entry("d/.wh..wh..opq"))
    assert unpacked(tmp_path, below, above).error == ""
    assert files_of(tmp_path) == {"kept": b"1", "d/sub/new": b"2"}


def test_hard_links_and_times_stay(tmp_path: Path) -> None:
    old = entry("program", mode=0o755)
    old.mtime = 1_000_000_000
    assert unpacked(tmp_path, layer_of((old, b"x"), entry("other", tarfile.LNKTYPE, "program"))).error == ""
    status = (tmp_path / "root" / "other").stat()
    assert (status.st_nlink, status.st_mtime, stat.S_IMODE(status.st_mode)) == (2, 1_000_000_000, 0o755)


@pytest.mark.parametrize(
    "hostile",
    [
        [(entry("../outside"), b"x")],
        [(entry("a/../../outside"), b"x")],
        [entry("secret", tarfile.LNKTYPE, "../outside")],
    ],
)
def test_a_path_that_leads_out_of_the_image_is_refused(
    tmp_path: Path, hostile: list[tarfile.TarInfo | tuple[tarfile.TarInfo, bytes]]
) -> None:
    result = unpacked(tmp_path, layer_of(*hostile))
    assert "leads out of the image" in result.error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["layer-0", "root"]


def test_links_lead_nowhere_but_into_the_image(tmp_path: Path) -> None:
    target = tmp_path / "machine"
    target.mkdir()
    (target / "file").write_text("of the machine")
    layer = layer_of(
        entry("to-machine", tarfile.SYMTYPE, str(target)),
        entry("up", tarfile.SYMTYPE, "../../.."),
        (entry("up/written"), b"x"),
        folder_of(str(target)),
        (entry("to-machine/file"), b"of the image"),
        entry("etc", tarfile.SYMTYPE, str(target)),
    )
    result = unpacked(tmp_path, layer, directories=("/to-machine/volume", "/up/volume"))
    assert result.error == ""
    assert (target / "file").read_text() == "of the machine"
    assert [path.name for path in target.iterdir()] == ["file"]
    inside = tmp_path / "root" / str(target)[1:]
    assert (inside / "file").read_bytes() == b"of the image"
    assert (tmp_path / "root" / "written").read_bytes() == b"x"
    # Without symlinks: where a sandbox mounts.
    assert result.directories == [f"{target}/volume", "/volume"]


def test_devices_pipes_and_set_user_id_bits_are_left_out(tmp_path: Path) -> None:
    device = entry("device", tarfile.CHRTYPE)
    device.devmajor, device.devminor = 1, 3
    layer = layer_of(device, entry("pipe", tarfile.FIFOTYPE), (entry("su", mode=0o6755), b"x"), folder_of("d"))
    assert unpacked(tmp_path, layer).error == ""
    root = tmp_path / "root"
    assert sorted(path.name for path in root.iterdir()) == ["d", "etc", "su"]
    assert stat.S_IMODE((root / "su").stat().st_mode) == 0o755


def test_files_that_a_sandbox_replaces_are_plain(tmp_path: Path) -> None:
    layer = layer_of(entry("etc/hosts", tarfile.SYMTYPE, "/etc/passwd"), folder_of("etc/resolv.conf"))
    assert unpacked(tmp_path, layer).error == ""
    for name in ("hosts", "resolv.conf"):
        path = tmp_path / "root" / "etc" / name
        assert path.is_file()
        assert not path.is_symlink()


def test_a_small_layer_cannot_fill_the_disk(tmp_path: Path) -> None:
    result = unpacked(tmp_path, gzipped(layer_of((entry("zeros"), bytes(50 * MB)))), limit_bytes=10 * MB)
    assert "takes more than" in result.error
    assert sum(path.stat().st_size for path in (tmp_path / "root").rglob("*")) < 11 * MB


@pytest.mark.parametrize("damage", ["cut", "garbage"])
def test_a_damaged_layer_is_refused(tmp_path: Path, damage: str) -> None:
    layer = gzipped(layer_of((entry("a"), bytes(range(256)) * 100)))
    result = unpacked(tmp_path, layer[: len(layer) // 2] if damage == "cut" else b"no tar" * 1000)
    assert "damaged" in result.error
