"""The token of the local owner: once revoked it stays revoked, and the next start writes a new one."""

import asyncio
from pathlib import Path

import pytest

from kleinkram.contract.tokens import has_valid_checksum
from kleinkram.server.app import create_app
from kleinkram.server.auth import bootstrap as owner
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi


def _start_again(api: Api) -> str:
    """Start another process of the server, end it, and return what is in the owner's file then."""
    app = create_app(api.app.state.settings)

    async def start() -> None:
        async with app.router.lifespan_context(app):
            pass

    asyncio.run(start())
    return _file(api).read_text().strip()


def _file(api: Api) -> Path:
    file: Path = api.app.state.settings.owner_token_file
    return file


def test_a_revoked_owner_token_is_replaced_at_the_next_start(start_api: StartApi) -> None:
    api = start_api()
    revoked = api.token or ""
    assert _start_again(api) == revoked, "as long as it is good, it stays"
    api.delete(f"/tokens/{api.get('/me').ok()['credential']['id']}").ok(204)
    renewed = _start_again(api)
    assert renewed != revoked
    assert has_valid_checksum(renewed)
    assert _file(api).stat().st_mode & 0o777 == 0o600
    api.get("/me").refused(401, "not_authenticated")
    assert api.as_(renewed).get("/me").ok()["is_admin"]
    assert _start_again(api) == renewed
    # One that was the file's before is no good either when it is put back there.
    _file(api).write_text(revoked)
    api.get("/me").refused(401, "not_authenticated")
    assert _start_again(api) not in {revoked, renewed}
    api.as_(renewed).get("/me").refused(401, "not_authenticated")


def test_an_owner_token_file_that_cannot_be_written_is_named(
    start_api: StartApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    api = start_api()
    api.delete(f"/tokens/{api.get('/me').ok()['credential']['id']}").ok(204)

    def refuse(_path: Path, _text: str) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(owner, "_write_private", refuse)
    with pytest.raises(RuntimeError, match="takes no other: read-only"):
        _start_again(api)
    # Nothing is kept of a token that nobody has.
    assert api.sql("SELECT 1 FROM token WHERE revoked_at IS NULL") == []
