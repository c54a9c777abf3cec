"""Secrets have a documented form that scanners find."""

import re
from pathlib import Path

import pytest

from kleinkram.contract.token_format import PATTERN, SecretKind, has_valid_checksum, with_checksum
from kleinkram.server.access.actor import new_secret, secret_prefix


@pytest.mark.parametrize("kind", SecretKind)
def test_a_new_secret_is_found_and_verified(kind: SecretKind) -> None:
    secrets = [new_secret(kind) for _ in range(200)]
    assert len({secret.text for secret in secrets}) == 200
    for secret in secrets:
        assert re.findall(PATTERN, f"token='{secret.text}',") == [secret.text]
        assert has_valid_checksum(secret.text)
        assert len(secret.prefix) == len(f"klein_{kind.value}_") + 4
        assert secret.text not in repr(secret)


def test_tokens_of_another_form_are_not_shown() -> None:
    assert secret_prefix("klein_pat_too-short") == secret_prefix("0123456789abcdef") == ""


def test_the_checksum_is_the_documented_one() -> None:
    # CRC-32 of "123456789" is 0xCBF43926 (the check value of every table of CRCs): 3421780262 in base 62.
    assert with_checksum("123456789") == "1234567893jZRME"


def test_any_changed_character_fails_the_checksum() -> None:
    secret = new_secret(SecretKind.robot).text
    begin = len("klein_robot_")
    for place in range(begin, len(secret)):
        other = "A" if secret[place] != "A" else "B"
        assert not has_valid_checksum(secret[:place] + other + secret[place + 1 :])


def test_the_token_page_contains_the_pattern() -> None:
    assert PATTERN in (Path(__file__).parents[3] / "docs" / "tokens.md").read_text()
