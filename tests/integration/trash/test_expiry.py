"""Expired trash is deleted, and nothing is restored in part."""

from typing import Any

import pytest

from kleinkram.server.context import AppContext
from kleinkram.server.trash.service import empty_trash
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site
from tests.integration.races import racing
from tests.integration.sample import Sample


@pytest.fixture(name="own", scope="module")
def _own(start_api: StartApi) -> Api:
    return start_api()


@pytest.fixture(name="tree")
def _tree(own: Api) -> dict[str, str]:
    project = own.project()["id"]
    mission = own.mission(project)["id"]
    return {"project": project, "mission": mission, "file": Sample(own).file(mission, "a.mcap")}


def _empty(api: Api, *, limit: int = 100) -> None:
    async def work(context: AppContext) -> None:
        async with context.database.begin() as db:
            await empty_trash(db, older_than_days=30, limit=limit)

    on_site(api, work)


def _age(api: Api, resource_type: str, resource_id: str, days: int = 31) -> None:
    api.sql(
        f"UPDATE {resource_type} SET deleted_at = now() - make_interval(days => %s) WHERE id = %s", days, resource_id
    )


def _left(api: Api, tree: dict[str, str]) -> list[str]:
    return [
        resource_type
        for resource_type, resource_id in tree.items()
        if api.sql(f"SELECT 1 FROM {resource_type} WHERE id = %s", resource_id)
    ]


def _restore(api: Api, resource_type: str, resource_id: str) -> Any:
    return api.post(f"/trash/{resource_type}/{resource_id}/restore")


@pytest.mark.parametrize("resource_type", ["project", "mission", "file"])
def test_expired_trash_cannot_be_restored(own: Api, tree: dict[str, str], resource_type: str) -> None:
    own.delete(f"/{resource_type}s/{tree[resource_type]}").ok()
    _age(own, resource_type, tree[resource_type])
    assert tree[resource_type] not in [row["id"] for row in own.all("/trash")]
    _restore(own, resource_type, tree[resource_type]).refused(404, "not_found")
    _age(own, resource_type, tree[resource_type], 29)
    assert tree[resource_type] in [row["id"] for row in own.all("/trash")]
    _restore(own, resource_type, tree[resource_type]).ok(204)


@pytest.mark.parametrize(
    ("resource_type", "left"), [("project", []), ("mission", ["project"]), ("file", ["project", "mission"])]
)
def test_expired_objects_are_purged_and_audited_with_their_project(
    own: Api, tree: dict[str, str], resource_type: str, left: list[str]
) -> None:
    own.delete(f"/{resource_type}s/{tree[resource_type]}").ok()
    _age(own, resource_type, tree[resource_type])
    _empty(own)
    assert _left(own, tree) == left
    events = own.all("/audit", {"project_id": tree["project"]})
    purged = {
        event["resource_type"]: (event["resource_id"], event["actor"])
        for event in events
        if event["operation"].endswith("purge")
    }
    assert purged == {item: (resource_id, None) for item, resource_id in tree.items() if item not in left}


def test_the_uploads_of_an_expired_mission_are_deleted_after_their_bytes(own: Api, tree: dict[str, str]) -> None:
    file = {"path": "b.bin", "size_bytes": 3}
    (begun,) = own.post(f"/missions/{tree['mission']}/uploads", {"files": [file]}).ok()["items"]
    upload = begun["upload"]["id"]
    own.delete(f"/missions/{tree['mission']}").ok()
    _age(own, "mission", tree["mission"])
    _empty(own)
    assert own.sql("SELECT state FROM upload WHERE id = %s", upload) == [("expired",)]
    assert _left(own, tree) == ["project", "mission"]
    own.sql("UPDATE upload SET cleaned_at = now() WHERE id = %s", upload)
    _empty(own)
    assert (own.sql("SELECT 1 FROM upload WHERE id = %s", upload), _left(own, tree)) == ([], ["project"])


def test_expiry_deletes_a_limited_number_of_files_per_round(own: Api, tree: dict[str, str]) -> None:
    for number in range(2):
        Sample(own).file(tree["mission"], f"{number}.mcap")
    own.delete(f"/projects/{tree['project']}").ok()
    _age(own, "project", tree["project"])
    for files in (2, 1):
        _empty(own, limit=1)
        assert own.sql("SELECT count(*) FROM file WHERE mission_id = %s", tree["mission"]) == [(files,)]
    _empty(own, limit=1)
    assert _left(own, tree) == []


@pytest.mark.parametrize("resource_type", ["project", "mission", "file"])
def test_locked_rows_are_skipped(own: Api, tree: dict[str, str], resource_type: str) -> None:
    own.delete(f"/{resource_type}s/{tree[resource_type]}").ok()
    _age(own, resource_type, tree[resource_type])
    with racing(own, f"SELECT 1 FROM {resource_type} WHERE id = %s FOR UPDATE", tree[resource_type]):
        _empty(own)
        assert _left(own, tree) == ["project", "mission", "file"]
    _empty(own)
    assert resource_type not in _left(own, tree)


@pytest.mark.parametrize("resource_type", ["mission", "file"])
def test_a_mission_is_restored_only_after_its_project(own: Api, tree: dict[str, str], resource_type: str) -> None:
    own.delete(f"/{resource_type}s/{tree[resource_type]}").ok()
    with racing(own, "SELECT 1 FROM project WHERE id = %s FOR UPDATE", tree["project"]) as send:
        restored = send(_restore, own, resource_type, tree[resource_type])
        # While it waits for the lock of the project, it has not locked the object itself.
        own.sql(f"SELECT 1 FROM {resource_type} WHERE id = %s FOR UPDATE NOWAIT", tree[resource_type])
    restored.result().ok(204)
