"""Projects through HTTP."""

import uuid

from tests.integration.running import Api


def test_makes_a_project_and_reads_it_back(api: Api) -> None:
    name = f"Field day {uuid.uuid4()}"
    made = api.post("/projects", {"name": name, "description": "Zürich"}).ok(201)
    assert (made["name"], made["description"], made["created_by"]["name"]) == (name, "Zürich", "owner")
    assert made["metadata_fields"] == {"fields": [], "undeclared": "accept"}
    amounts = ("mission_count", "file_count", "size_bytes", "duration_ns", "unsatisfied_mission_count")
    assert [made[amount] for amount in amounts] == [0, 0, 0, 0, 0]
    assert api.get(f"/projects/{made['id']}").ok() == made
