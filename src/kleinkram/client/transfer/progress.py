"""How a transfer tells what it is doing. Called from several threads at once; must return quickly."""

from typing import Protocol


class Watcher(Protocol):
    """What a transfer tells. Sizes in bytes."""

    def began(self, files: int, size_bytes: int) -> None:
        """The whole is known."""

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """So many more bytes of a file of `total_bytes` have moved; those that must move again count once."""

    def held(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """So many bytes of a file need not move: the other side has them."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """A file is done, well or not."""

    def said(self, text: str) -> None:
        """Something a person should know while waiting."""


class Unwatched:
    """A watcher that looks away."""

    def began(self, files: int, size_bytes: int) -> None:
        """Do nothing."""

    def moved(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Do nothing."""

    def held(self, path: str, size_bytes: int, total_bytes: int) -> None:
        """Do nothing."""

    def ended(self, path: str, outcome: str, reason: str | None) -> None:
        """Do nothing."""

    def said(self, text: str) -> None:
        """Do nothing."""
