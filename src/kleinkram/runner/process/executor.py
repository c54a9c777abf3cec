"""The executor of processes."""

import os
from collections.abc import Collection

from kleinkram.action.places import IN_VARIABLE, OUT_VARIABLE
from kleinkram.contract.actions import Network
from kleinkram.contract.runners import ExecutorAbilities, Isolation
from kleinkram.contract.runs import EndReason, Usage
from kleinkram.runner.process import room, warden
from kleinkram.runner.wardens import Wardens, check_doors, make_folders
from kleinkram.runner.work import CannotStart, Ending, ImagePinned, Work

_NO_IMAGES = Ending(EndReason.not_possible, "Without an engine of containers, no image can be run.")


class ProcessExecutor:
    """Runs commands as processes, in rooms where the kernel gives them."""

    def __init__(self) -> None:
        self._is_isolated = room.can_be_made()
        self._wardens = Wardens(warden.__name__, outlived=False)

    @property
    def abilities(self) -> ExecutorAbilities:
        """What it can do here. Without a room, a run reads and reaches whatever its runner does."""
        return ExecutorAbilities(
            executor="process",
            isolation=Isolation.namespaces if self._is_isolated else Isolation.none,
            images=False,
            networks=frozenset(Network) if self._is_isolated else frozenset({Network.open}),
            gpus=False,
            bounds_memory=True,
            bounds_disk=True,
        )

    def prepare(self, image: str) -> ImagePinned:
        """Run no image.

        Raises:
            CannotStart: always.
        """
        raise CannotStart(_NO_IMAGES)

    def start(self, work: Work) -> None:
        """Start a run and return while it lasts.

        Raises:
            CannotStart: it asks for an image, or for what this machine does not give; its command is not there.
        """
        if work.image is not None:
            raise CannotStart(_NO_IMAGES)
        if work.network not in self.abilities.networks:
            message = f"Without an engine of containers, no run here has the network {work.network.value!r}."
            raise CannotStart(Ending(EndReason.not_possible, message))
        check_doors(work)
        uid = make_folders(work, is_root=os.getuid() == 0 and self._is_isolated)
        task = {
            "command": list(work.command),
            "environment": {**self._environment(work), **work.environment},
            "is_isolated": self._is_isolated,
            "has_network": work.network is Network.open,
            "uid": uid,
        }
        self._wardens.start(work, task)

    def wait(self, work: Work, timeout_s: float) -> Ending | None:
        """Return how a run ended, or None if it goes on for longer than `timeout_s`."""
        return self._wardens.wait(work, timeout_s)

    def stop(self, work: Work) -> None:
        """Ask a run to end, and kill it `GRACE_S` later; return at once. Nothing happens to one that is over."""
        self._wardens.stop(work)

    def usage(self, work: Work) -> Usage | None:
        """Return what a run uses, or did until it was over; None before it has begun."""
        return self._wardens.usage(work)

    def remove(self, work: Work) -> None:
        """Kill what is left of a run and forget it; its folder stays."""
        self._wardens.remove(work)

    def sweep(self, known: Collection[str]) -> None:
        """Do nothing: a run of which nobody knows the folder ends by itself, with its time."""

    def _environment(self, work: Work) -> dict[str, str]:
        environment = {"PATH": os.environ.get("PATH", os.defpath), "LANG": "C.UTF-8", "PYTHONUNBUFFERED": "1"}
        if self._is_isolated:
            return environment | {"HOME": "/tmp", "TMPDIR": "/tmp"}  # noqa: S108  the run's own
        places = {name: str(work.folder / name) for name in ("in", "out", "tmp")}
        environment |= {IN_VARIABLE: places["in"], OUT_VARIABLE: places["out"]}
        return environment | {"TMPDIR": places["tmp"], "HOME": places["tmp"]}
