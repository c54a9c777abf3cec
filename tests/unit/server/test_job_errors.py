"""The stored reason of a failed job: one line without secrets."""

import pytest

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.jobs.execution import error_sentence


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (ValueError("7 is no size"), "ValueError: 7 is no size"),
        (KeyError(), "KeyError"),
        (ValueError("first\nSELECT secret"), "ValueError: first"),
        (OSError("GET https://s3.lab/b/k?X-Amz-Signature=abc refused"), "OSError: GET https://s3.lab/b/k?… refused"),
        (OSError("no postgresql://serve:geheim@db/kk there"), "OSError: no postgresql://serve:…@db/kk there"),
        (ValueError("a\x00b\x1b[31m"), "ValueError: a b [31m"),
        (ValueError("x" * 1000), "ValueError: " + "x" * 488),
    ],
)
def test_errors_are_stored_as_one_sentence(error: Exception, sentence: str) -> None:
    assert error_sentence(error) == sentence


def test_an_error_keeps_its_own_sentence() -> None:
    error = StoreUnavailable(reason="it is away")
    assert error_sentence(error) == error.sentence()
