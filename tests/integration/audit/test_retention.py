"""Events of the audit log expire if the settings say so, and only then; an archive has each of them."""

import gzip
import json
import uuid
from pathlib import Path
from typing import Any

import pytest

from kleinkram.server.audit import retention
from kleinkram.server.context import AppContext
from kleinkram.server.migrations.migrate import set_audit_retention
from kleinkram.server.settings import Settings
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import in_worker
from tests.integration.people import person


@pytest.fixture(name="api")
def _api(start_api: StartApi) -> Api:
    """An API of its own for each test, since all events expire alike."""
    return start_api()


def keep(api: Api, days: int) -> None:
    """Do what `migrate` does with the setting."""
    url = api.database.info
    set_audit_retention(f"postgresql+psycopg://{url.user}:{url.password}@{url.host}:{url.port}/{url.dbname}", days)


def expire(api: Api, archive: Path | None = None) -> int:
    """Run the job; return the number of events that it deleted."""
    settings = api.app.state.settings.model_copy(update={"audit_archive": archive})

    def work(resources: Any) -> Any:
        context: AppContext = resources.context
        return retention.expire_events(AppContext(context.database, context.storage, settings))

    return int(in_worker(api, work))


def insert_events(api: Api, *, age_days: float, count: int = 1) -> list[int]:
    """Insert events of that age; return their ids."""
    return [
        int(
            api.sql(
                "INSERT INTO audit_event (at, operation, resource_type, resource_name, after)"
                " VALUES (now() - make_interval(secs => %s), 'project.update', 'project', %s, '{\"a\": 1}')"
                " RETURNING id",
                *(age_days * 86_400, f"old {number}"),
            )[0][0]
        )
        for number in range(count)
    ]


def stored_ids(api: Api) -> set[int]:
    """Return the ids of all events."""
    return {row[0] for row in api.sql("SELECT id FROM audit_event")}


def test_without_the_setting_events_never_expire(api: Api) -> None:
    old = insert_events(api, age_days=5000)
    assert expire(api) == 0
    assert set(old) <= stored_ids(api)
    keep(api, 30)
    keep(api, 0)
    assert expire(api) == 0
    assert set(old) <= stored_ids(api)


def test_events_expire_after_the_days_of_the_setting(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "BATCH", 2)
    old, young = insert_events(api, age_days=90.01, count=5), insert_events(api, age_days=89.99)
    keep(api, 90)
    assert expire(api) == 5
    assert stored_ids(api) & {*old, *young} == set(young)
    expired = api.all("/audit", {"operation": "audit.expire"})
    assert sum(event["after"]["events"] for event in expired) == 5
    assert expire(api) == 0
    assert api.all("/audit", {"operation": "audit.expire"}) == expired


def test_the_creation_of_a_valid_token_stays(api: Api) -> None:
    ada = person(api)
    valid, revoked = (
        api.as_(ada.token).post("/tokens", {"name": name}).ok(201)["token"]["id"] for name in ("one", "two")
    )
    api.delete(f"/tokens/{revoked}").ok(204)
    api.sql("UPDATE audit_event SET at = now() - interval '60 days'")
    keep(api, 30)
    expire(api)
    assert [event["operation"] for event in api.events(valid)] == ["token.create"]
    assert api.events(revoked) == []


def test_events_are_archived_before_they_are_deleted(api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "BATCH", 2)
    old = insert_events(api, age_days=31, count=3)
    young = insert_events(api, age_days=29)
    keep(api, 30)
    assert expire(api, tmp_path) == 3
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [f"audit-{old[0]}-{old[1]}.jsonl.gz", f"audit-{old[2]}-{old[2]}.jsonl.gz"]
    packed = [gzip.decompress((tmp_path / name).read_bytes()) for name in names]
    lines = [json.loads(line) for text in packed for line in text.splitlines()]
    assert [(line["id"], line["resource_name"], line["after"]) for line in lines] == [
        (event_id, f"old {number}", {"a": 1}) for number, event_id in enumerate(old)
    ]
    assert all((tmp_path / name).stat().st_mode & 0o077 == 0 for name in names)
    assert set(young) <= stored_ids(api)


def test_what_cannot_be_archived_is_not_deleted(api: Api, tmp_path: Path) -> None:
    old = insert_events(api, age_days=31)
    keep(api, 30)
    with pytest.raises(FileNotFoundError):
        expire(api, tmp_path / "missing")
    assert set(old) <= stored_ids(api)


def test_the_setting_is_off_or_at_least_a_month() -> None:
    known = {"database_url": "postgresql://a@b/c", "s3_internal_url": "http://s3", "s3_access_key": "a"}
    known["s3_secret_key"] = uuid.uuid4().hex
    for days in (0, 30, 3650):
        assert Settings(**known, audit_days=days).audit_days == days  # type: ignore[arg-type]  # validated
    for days in (-1, 1, 29):
        with pytest.raises(ValueError, match=r"at least 30|greater than or equal to 0"):
            Settings(**known, audit_days=days)  # type: ignore[arg-type]  # validated
