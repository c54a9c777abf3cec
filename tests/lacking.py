"""What a machine lacks: skipped out loud, and a failure where all is required."""

import os
from typing import NoReturn

import pytest


def missing(what: str) -> NoReturn:
    """Skip, or fail where all is required: this machine cannot do `what` a test needs."""
    if os.environ.get("KLEINKRAM_REQUIRE_ALL") == "1":
        pytest.fail(what)
    pytest.skip(what)
