"""Making the secrets of tokens and links. What is kept of one is its hash and how it begins, never the secret."""

import secrets
from dataclasses import dataclass, field

from kleinkram.contract.tokens import SecretKind, is_whole, with_checksum
from kleinkram.server.access.actor import secret_hash

_RANDOM_BYTES = 32
# Enough to recognise one's own token in a list, and no help in guessing the rest.
_SHOWN_CHARACTERS = 4


@dataclass(frozen=True)
class NewSecret:
    """A secret that nobody has seen yet: shown once, to whoever asked for it."""

    text: str = field(repr=False)
    prefix: str

    @property
    def sha256(self) -> bytes:
        """What is kept of it."""
        return secret_hash(self.text)


def new_secret(kind: SecretKind) -> NewSecret:
    """Return a secret of 256 random bits."""
    text = with_checksum(f"klein_{kind.value}_{secrets.token_urlsafe(_RANDOM_BYTES)}")
    return NewSecret(text, beginning(text))


def beginning(secret: str) -> str:
    """Return how a secret of ours begins, as lists show it; nothing of one that is not in this form."""
    return secret[: secret.index("_", len("klein_")) + 1 + _SHOWN_CHARACTERS] if is_whole(secret) else ""
