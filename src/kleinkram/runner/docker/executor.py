"""The executor of containers."""

import contextlib
import logging
import os
from collections.abc import Collection, Sequence

from kleinkram.contract.actions import Network
from kleinkram.contract.runners import ExecutorAbilities, Isolation
from kleinkram.contract.runs import EndReason, Usage
from kleinkram.runner.docker import container, warden
from kleinkram.runner.docker.engine import Engine, EngineAway, Refused
from kleinkram.runner.docker.images import Images, Pull
from kleinkram.runner.wardens import Wardens, check_doors, make_folders
from kleinkram.runner.work import CannotStart, Ending, ImagePinned, Work

_log = logging.getLogger("kleinkram.runner")
_STILL_THERE = Ending(EndReason.not_possible, "The engine of containers does not remove what an earlier start left.")


class DockerExecutor:
    """Runs containers by an engine of this machine. `runner` tells its containers from another runner's.

    `allowed`: the registries, or folders of registries, that images may be of; None for all.
    """

    def __init__(
        self,
        engine: Engine,
        *,
        runner: str = "local",
        pull: Pull = Pull.missing,
        allowed: Sequence[str] | None = None,
    ) -> None:
        self._engine = engine
        self._runner = runner
        self._wardens = Wardens(warden.__name__, outlived=True)
        self._is_root = os.geteuid() == 0
        facts = engine.facts()
        self._has_gpus = facts.has_gpus
        self._images = Images(engine, facts.architecture, pull=pull, allowed=allowed)

    @property
    def abilities(self) -> ExecutorAbilities:
        """What it can do here. Doors into a container's network are made by root alone."""
        networks = {Network.none, Network.open} | ({Network.api} if self._is_root else set())
        return ExecutorAbilities(
            executor="docker",
            isolation=Isolation.container,
            images=True,
            networks=frozenset(networks),
            gpus=self._has_gpus,
            bounds_memory=True,
            bounds_disk=True,
        )

    def prepare(self, image: str) -> ImagePinned:
        """Have an image here, fetched where that is needed and allowed, which may take long.

        Raises:
            CannotStart: it is not allowed, cannot be had, or is for another architecture.
        """
        return self._images.prepare(image)

    def start(self, work: Work) -> None:
        """Start a run of an image that is here and return while it lasts.

        Raises:
            CannotStart: its image is not here; it asks for what this machine does not give; its command is not there.
        """
        if work.image is None:
            raise CannotStart(Ending(EndReason.not_possible, "A container needs an image, and it names none."))
        if work.network not in self.abilities.networks:
            message = f"A runner that is not root gives no run the network {work.network.value!r}."
            raise CannotStart(Ending(EndReason.not_possible, message))
        check_doors(work)
        try:
            image = self._engine.find_image(work.image)
            # Its folders were made anew: what it still writes would be lost, and its end taken for this one's.
            is_there = self._engine.find(container.name_of(work)) is not None
        except (EngineAway, Refused) as error:
            raise CannotStart(Ending(EndReason.not_possible, f"{error}.")) from error
        if image is None:
            message = f"The image {work.image} is not on this runner."
            raise CannotStart(Ending(EndReason.image_unavailable, message))
        if is_there:
            raise CannotStart(_STILL_THERE)
        uid = make_folders(work, is_root=self._is_root)
        user = os.getuid() if uid is None else uid
        for number, _ in enumerate(image.volumes):
            folder = container.volume_folder(work, number)
            folder.mkdir(exist_ok=True)
            os.chown(folder, user, -1)
        described = container.describe(work, f"{user}:{user}", image.volumes, self._runner)
        task = {"socket": str(self._engine.path), "name": container.name_of(work), "container": described}
        if work.doors:
            task["gated"] = container.gated(described, work, image)
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
        """Kill what is left of a run and forget it; its folder stays. What stays of it, too, is left to be swept."""
        self._wardens.remove(work)
        with contextlib.suppress(EngineAway):
            self._remove(container.name_of(work))

    def sweep(self, known: Collection[str]) -> None:
        """Remove the containers of this runner's runs, but for those with a known key."""
        try:
            for name, labels in self._engine.labelled(f"{container.RUNNER_LABEL}={self._runner}"):
                if labels.get(container.RUN_LABEL) not in known:
                    self._remove(name)
        except (EngineAway, Refused) as error:
            _log.warning("containers of earlier runs stay for now: %s", error)

    def _remove(self, name: str) -> None:
        try:
            self._engine.remove(name)
        except Refused as error:
            _log.warning("the container %s stays for now: %s", name, error)
