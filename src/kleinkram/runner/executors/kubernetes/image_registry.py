"""Finds the digests of images in their registries, since a cluster reports them only once a pod runs."""

import re

from kleinkram.contract.runs import EndReason
from kleinkram.runner.executors.base import CannotStart, Ending, PinnedImage
from kleinkram.runner.images.names import parse_image_name
from kleinkram.runner.images.registry import RegistryFailure, find_digest

_DIGEST = re.compile(r"sha256:[0-9a-f]{64}")


def pin_image(text: str) -> PinnedImage:
    """Return an image by its digest, which its registry is asked for where the name has none.

    Raises:
        CannotStart: its registry does not tell.
    """
    name = parse_image_name(text)
    try:
        digest = name.digest or find_digest(name)
        if not _DIGEST.fullmatch(digest):
            raise RegistryFailure(f"{digest!r} is no digest.")
    except RegistryFailure as error:
        message = f"The digest of the image {text} is not known. {error} Name it with its digest (@sha256:…)."
        raise CannotStart(Ending(EndReason.image_unavailable, message)) from error
    return PinnedImage(f"{name.repository}@{digest}", digest)
