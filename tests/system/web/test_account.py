"""The own account, creating a mission, a failed job and a scrub, in a real browser."""

import json
from pathlib import Path

import pytest
import urllib3

from kleinkram.server.jobs.execution import ATTEMPTS
from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.web.conftest import Act

_EMAIL, _PASSWORD = "ada@lab.example", "correct horse battery"
# What Rust reads and a browser does not: the server alone can say that a value does not match it.
_FIELDS = """
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true}
  - {name: operator, type: string, pattern: "(?i)[a-z]+", required: true}
  - {name: day, type: date}
"""


def _join(cluster: Cluster) -> str:
    """Make somebody's account by an invitation, and return whose it is."""
    link = cluster.terminal.run("person", "invite", _EMAIL, "--name", "Ada").out.strip()
    url = cluster.runtime_info()["url"]
    accepted = {"code": link.partition("#")[2], "name": "Ada", "password": _PASSWORD}
    headers = {"Content-Type": "application/json", "Origin": url}
    answer = urllib3.request("POST", f"{url}/api/v1/auth/invitation", body=json.dumps(accepted), headers=headers)
    assert answer.status == 200, answer.data
    joined: str = answer.json()["person"]["id"]
    return joined


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_an_account_a_mission_and_a_failed_job(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    cluster.start()
    terminal = cluster.terminal
    # As the worker finds one that was tried as often as it may be: it fails once more, and is given up.
    sql(
        cluster,
        "INSERT INTO procrastinate_jobs (queue_name, task_name, attempts, args)"
        " VALUES ('default', 'summarise_blob', %s, '{\"ref\": \"no id\"}') RETURNING id",
        ATTEMPTS,
    )
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    project = terminal.run("project", "create", "Alps", "--fields", tmp_path / "fields.yaml", "--json").json()["id"]
    (tmp_path / "taken.yaml").write_text("robot: spot\noperator: ada\nday: 2026-05-01\n")
    terminal.run("mission", "create", "taken", "-p", "Alps", "--metadata", tmp_path / "taken.yaml")
    ada = _join(cluster)
    sql(
        cluster,
        "INSERT INTO identity (id, person_id, issuer, subject, email)"
        " VALUES (gen_random_uuid(), %s, 'https://gone.example', 'ada', 'ada@gone.example') RETURNING id",
        ada,
    )
    seen = act("account.mjs", cluster, _EMAIL, _PASSWORD, project, pictures)

    assert [seen[name] for name in ("complaints", "axe", "wide", "ran")] == [[], [], [], []]
    assert "Compared\n0 objects" in seen["scrub"]
    assert "Newly lost\n0" in seen["scrub"]
    assert "ada@lab.example verified by your invitation" in seen["account"]
    assert "This server no longer offers this provider." in seen["account"]
    assert seen["tooShort"] == "Use at least 10 characters."
    assert seen["wrongPassword"] == "Wrong password."
    assert (seen["before"], seen["after"]) == (200, 401)
    assert sql(cluster, "SELECT unlinked_at IS NULL FROM identity WHERE person_id = %s", ada) == [(False,)]
    assert seen["prefilled"] == ["spot", "", ""], "but for the operator and the day, which are others"
    assert seen["unconfirmed"] == "Confirm or change this value."
    assert seen["nameMissing"] == "Enter a name."
    assert seen["robotMissing"] == "Required."
    assert "[a-z]+" in seen["operatorWrong"]
    assert "already" in seen["nameTaken"]
    assert "spot" in seen["mission"]
    assert "Ada" in seen["mission"]
    metadata = {row["name"]: row["metadata"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    assert metadata["ridge"] == {"robot": "spot", "operator": "Ada"}
