"""Getting a run ready: its image at hand, its inputs in place, and what it is told."""

import os
import threading
from dataclasses import dataclass
from pathlib import Path

from kleinkram.client._retry import Backoff
from kleinkram.contract.actions import Network
from kleinkram.contract.errors import FileUnavailable, InvalidRequest, KleinkramError, NotFound, RunGone
from kleinkram.contract.runners import Isolation
from kleinkram.contract.runs import EndReason
from kleinkram.runner.attempts import Attempt
from kleinkram.runner.disk import remove_tree
from kleinkram.runner.fetching import InputFetcher
from kleinkram.runner.given import write_given
from kleinkram.runner.ground import Ground
from kleinkram.runner.orders import Orders
from kleinkram.runner.work import CannotStart, Ending, Executor, ImagePinned

# A server that is away, or in trouble, comes back.
_PATIENCE_S = 600.0
_NEVER = (NotFound, FileUnavailable, InvalidRequest)
_LOOK_EVERY_S = 0.02


@dataclass(frozen=True)
class Ready:
    """What a run that is ready is started with: its image, and where the store is, for one that reaches it."""

    image: ImagePinned | None
    store_url: str


class Preparing:
    """Makes the folder of one run what it finds. May be done again from the beginning."""

    def __init__(self, ground: Ground, attempt: Attempt, orders: Orders) -> None:
        self._ground = ground
        self._claim = attempt.state.claim
        self._folder = attempt.folder
        self._orders = orders

    def prepare(self) -> Ready:
        """Get it ready.

        Raises:
            CannotStart: it cannot be had here what it needs.
            Told: it is to end.
            RunGone: it is not this runner's.
        """
        image = self._image()
        pull = _Pull(self._ground.executor, image) if image else None
        given, store_url = self._folder / "in", None
        backoff = Backoff(_PATIENCE_S, self._orders.wait)
        while store_url is None:
            store_url = self._lay_out(backoff)
        for path in [given, *given.rglob("*")]:
            if path.is_dir():
                path.chmod(0o755)
            elif path.stat().st_mode & 0o777 != 0o444:
                path.chmod(0o444)
        return Ready(pull.pinned(self._orders) if pull else None, store_url)

    def _store_url(self) -> str:
        return self._ground.service.get().store_url if self._claim.network is Network.api else ""

    def _lay_out(self, backoff: Backoff) -> str | None:
        """Lay out what the run is given, and return where the store is; None to be tried again."""
        try:
            self._lay()
            return self._store_url()
        except RunGone:
            raise
        except KleinkramError as error:
            if isinstance(error, _NEVER) or not backoff.pause():
                raise CannotStart(Ending(EndReason.inputs_unavailable, str(error))) from error
            return None

    def _lay(self) -> None:
        ground, given = self._ground, self._folder / "in"
        may_share = ground.executor.abilities.isolation is not Isolation.none
        fetcher = InputFetcher(ground.runners, ground.store, ground.cache, self._claim, self._orders)
        remove_tree(given)
        given.mkdir()
        fetcher.lay(given, may_share=may_share)
        context = ground.runners.context(self._claim.run_id, self._claim.attempt)
        write_given(given, context, self._claim.script, self._authorities())

    def _authorities(self) -> str | None:
        believed = os.environ.get("SSL_CERT_FILE")
        return Path(believed).read_text() if believed and self._claim.network is Network.api else None

    def _image(self) -> str | None:
        """Return the image that is to be run, if any.

        Raises:
            CannotStart: this runner can do less than the run needs.
        """
        claim, abilities = self._claim, self._ground.executor.abilities
        lacks = None
        if claim.network not in abilities.networks:
            lacks = f"has the network {claim.network.value!r} for no run"
        elif claim.image is not None and not abilities.images:
            lacks = "runs no images, only scripts"
        elif claim.resources.gpus and not abilities.gpus:
            lacks = "has no GPU for runs"
        elif claim.image is None and abilities.images and self._ground.default_image is None:
            lacks = "has no default image to run scripts on"
        if lacks is not None:
            raise CannotStart(Ending(EndReason.not_possible, f"The runner that got it {lacks}."))
        if claim.image is None:
            return self._ground.default_image if abilities.images else None
        is_pinned = claim.image_digest is None or "@" in claim.image
        return claim.image if is_pinned else f"{claim.image}@{claim.image_digest}"


class _Pull:
    """An image on its way, in a thread of its own: a run that is cancelled does not wait for it."""

    def __init__(self, executor: Executor, image: str) -> None:
        self._executor = executor
        self._image = image
        self._is_over = threading.Event()
        self._pinned: ImagePinned | None = None
        self._failure = Ending(EndReason.image_unavailable, f"The image {image} could not be fetched.")
        threading.Thread(target=self._fetch, name="image", daemon=True).start()

    def pinned(self, orders: Orders) -> ImagePinned:
        """Wait for it.

        Raises:
            CannotStart: it cannot be had.
            Told: the run is to end.
        """
        while not self._is_over.wait(_LOOK_EVERY_S):
            orders.check()
        if self._pinned is None:
            raise CannotStart(self._failure)
        return self._pinned

    def _fetch(self) -> None:
        try:
            self._pinned = self._executor.prepare(self._image)
        except CannotStart as error:
            self._failure = error.ending
        finally:
            self._is_over.set()
