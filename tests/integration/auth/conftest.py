"""An API of its own for sign-in tests, which exceed the rate limits on purpose."""

import pytest

from kleinkram.server.audit import requests
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi


@pytest.fixture(scope="module")
def api(start_api: StartApi) -> Api:
    """The API of the module, without limits on sign-in attempts."""
    return start_api()


@pytest.fixture(autouse=True)
def _all_refusals_are_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "PER_MINUTE", 10_000)
