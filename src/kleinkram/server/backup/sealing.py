"""Sealing files: AES-256-GCM in frames of 1 MiB, so that a changed bit and an end that was cut off are noticed.

A file begins with a word and 16 random bytes, from which its key follows (HKDF). Frame n has n as nonce, and the last
one is told apart in it: the STREAM construction. What a file is called is authenticated with it. The key of all stands
in the repository, sealed by one that follows from the passphrase (scrypt).

Source: Hoang, Reyhanitabar, Rogaway, Vizár, "Online Authenticated-Encryption and its Nonce-Reuse Misuse-Resistance"
(CRYPTO 2015), section 7; RFC 5869; RFC 7914.
"""

import asyncio
import hmac
import secrets
from collections.abc import AsyncGenerator, AsyncIterator

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

from kleinkram.server.backup.failing import Damaged, NotOpened

_WORD = b"kleinkram sealed 1\n"
_SALT_BYTES = 16
_TAG_BYTES = 16
_FRAME_BYTES = 1024 * 1024
_SCRYPT_COST = 2**16  # 64 MiB, a fifth of a second


class Seal:
    """What a repository's key can do."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._names = _derived(key, b"", b"names")

    def name(self, sha256: bytes) -> str:
        """Return what a content is called, which tells nothing about it to whoever has not the key."""
        return hmac.digest(self._names, sha256, "sha256").hex()

    async def seal(self, pieces: AsyncIterator[bytes], about: str) -> AsyncGenerator[bytes, None]:
        """Yield the sealed file of what `pieces` yields; `about` is what it is called."""
        salt = secrets.token_bytes(_SALT_BYTES)
        yield _WORD + salt
        cipher = AESGCM(_derived(self._key, salt, b"file"))
        number, held = 0, bytearray()
        async for piece in pieces:
            held += piece
            while len(held) > _FRAME_BYTES:  # the last frame is the one that nothing follows
                frame = bytes(held[:_FRAME_BYTES])
                del held[:_FRAME_BYTES]
                yield await asyncio.to_thread(cipher.encrypt, _nonce(number, last=False), frame, about.encode())
                number += 1
        yield cipher.encrypt(_nonce(number, last=True), bytes(held), about.encode())

    async def unseal(self, pieces: AsyncIterator[bytes], about: str) -> AsyncGenerator[bytes, None]:
        """Yield what was sealed.

        Raises:
            Damaged: it was changed or cut off, is no sealed file, or another's.
        """
        head_bytes, sealed_bytes = len(_WORD) + _SALT_BYTES, _FRAME_BYTES + _TAG_BYTES
        cipher: AESGCM | None = None
        number, held = 0, bytearray()
        async for piece in pieces:
            held += piece
            if cipher is None and len(held) >= head_bytes:
                if held[: len(_WORD)] != _WORD:
                    break
                cipher = AESGCM(_derived(self._key, bytes(held[len(_WORD) : head_bytes]), b"file"))
                del held[:head_bytes]
            while cipher is not None and len(held) > sealed_bytes:
                frame = bytes(held[:sealed_bytes])
                del held[:sealed_bytes]
                yield await asyncio.to_thread(_opened, cipher, _nonce(number, last=False), frame, about)
                number += 1
        if cipher is None:
            raise Damaged(f"{about} is no sealed file of this version, or was cut off.")
        yield _opened(cipher, _nonce(number, last=True), bytes(held), about)


def sealed_size(size_bytes: int) -> int:
    """Return how long the sealed file of so many bytes is."""
    frames = max(1, -(-size_bytes // _FRAME_BYTES))
    return len(_WORD) + _SALT_BYTES + size_bytes + frames * _TAG_BYTES


def new_key(passphrase: str) -> tuple[Seal, str]:
    """Return a new seal, and its key in the form that a repository keeps: hexadecimal, sealed by the passphrase."""
    key, salt = secrets.token_bytes(32), secrets.token_bytes(_SALT_BYTES)
    # What seals it is used once: the nonce may be anything.
    sealed = AESGCM(_from_passphrase(passphrase, salt)).encrypt(bytes(12), key, _WORD)
    return Seal(key), (salt + sealed).hex()


def open_key(kept: str, passphrase: str) -> Seal:
    """Return the seal of a repository.

    Raises:
        NotOpened: the passphrase is another's.
    """
    raw = bytes.fromhex(kept)
    try:
        return Seal(
            AESGCM(_from_passphrase(passphrase, raw[:_SALT_BYTES])).decrypt(bytes(12), raw[_SALT_BYTES:], _WORD)
        )
    except InvalidTag:
        raise NotOpened("The passphrase is not the one these backups were sealed with.") from None


def _opened(cipher: AESGCM, nonce: bytes, frame: bytes, about: str) -> bytes:
    try:
        return cipher.decrypt(nonce, frame, about.encode())
    except InvalidTag:
        raise Damaged(f"{about} was changed or cut off since it was sealed.") from None


def _nonce(number: int, *, last: bool) -> bytes:
    return number.to_bytes(11, "big") + bytes([last])


def _derived(key: bytes, salt: bytes, use: bytes) -> bytes:
    return HKDF(SHA256(), 32, salt or None, b"kleinkram backup " + use).derive(key)


def _from_passphrase(passphrase: str, salt: bytes) -> bytes:
    return Scrypt(salt, 32, _SCRYPT_COST, 8, 1).derive(passphrase.encode())
