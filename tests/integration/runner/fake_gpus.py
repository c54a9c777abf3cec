"""A machine with GPUs that does not exist: `nvidia-smi`, the driver's files, CDI specifications, and locks."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from kleinkram.runner.executors import gpus, machine_locks

# A device that every machine has, for the files of GPUs.
NODE = "/dev/full"
_NVIDIA_SMI = """#!/bin/sh
case "$1" in
-L) cat {folder}/list ;;
--query-gpu=uuid,mig.mode.current) cat {folder}/modes ;;
*) echo "nvidia-smi: $1 is not known here" >&2; exit 2 ;;
esac
"""


@dataclass
class FakeGpus:
    """The GPUs of a machine. `slices` are the MIG devices of one more GPU, which is divided into them."""

    folder: Path
    count: int = 0
    slices: int = 0
    specification: dict[str, object] = field(default_factory=dict)

    @property
    def uuids(self) -> list[str]:
        """The UUIDs of all that can be given to runs."""
        return [f"GPU-{n}" for n in range(self.count)] + [f"MIG-{n}" for n in range(self.slices)]

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Have this process see this machine, and no other."""
        programs = self.folder / "bin"
        programs.mkdir(parents=True)
        if self.count or self.slices:
            self._write_nvidia_smi(programs / "nvidia-smi")
        self.write_cdi("nvidia.com/gpu", self.specification)
        monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
        monkeypatch.setattr(gpus, "SYSTEM", gpus.GpuSources((self.folder / "cdi",), self.folder / "driver"))
        (self.folder / "locks").mkdir()
        monkeypatch.setattr(machine_locks, "places", lambda: [self.folder / "locks"])

    def write_cdi(self, kind: str, nodes: dict[str, object]) -> None:
        """Write the CDI specification of a vendor: the files of each device."""
        devices = [{"name": name, "containerEdits": {"deviceNodes": _nodes(paths)}} for name, paths in nodes.items()]
        (self.folder / "cdi").mkdir(exist_ok=True)
        path = self.folder / "cdi" / f"{kind.partition('/')[0]}.yaml"
        path.write_text(json.dumps({"cdiVersion": "0.5.0", "kind": kind, "devices": devices}))

    def _write_nvidia_smi(self, program: Path) -> None:
        lines = [f"GPU {n}: NVIDIA RTX A6000 (UUID: GPU-{n})" for n in range(self.count)]
        modes = [f"GPU-{n}, [N/A]" for n in range(self.count)]
        if self.slices:
            lines.append(f"GPU {self.count}: NVIDIA A100-SXM4-40GB (UUID: GPU-{self.count})")
            lines += [f"  MIG 3g.20gb     Device  {n}: (UUID: MIG-{n})" for n in range(self.slices)]
            modes.append(f"GPU-{self.count}, Enabled")
        (self.folder / "list").write_text("".join(f"{line}\n" for line in lines))
        (self.folder / "modes").write_text("".join(f"{line}\n" for line in modes))
        program.write_text(_NVIDIA_SMI.format(folder=self.folder))
        program.chmod(program.stat().st_mode | stat.S_IXUSR)


def _nodes(paths: object) -> list[dict[str, str]]:
    assert isinstance(paths, Sequence)
    return [{"path": path} for path in paths]


def described(count: int, slices: int) -> dict[str, object]:
    """Return the specification of a machine, each device of which has the same file below /dev."""
    names = [str(n) for n in range(count)] + [f"{count}:{n}" for n in range(slices)]
    return {name: [NODE] for name in [*names, "all"]}
