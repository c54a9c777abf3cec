"""The own account, creating a mission, a failed job and a scrub, in a real browser."""

import json
from pathlib import Path

import pytest
import urllib3

from kleinkram.server.jobs.execution import ATTEMPTS
from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_EMAIL, _PASSWORD = "ada@lab.example", "correct horse battery"
# The syntax of Rust, which browsers do not support: only the server can report that a value does not match.
_FIELDS = """
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true}
  - {name: operator, type: string, pattern: "(?i)[a-z]+", required: true}
  - {name: day, type: date}
"""


def _accept_invitation(cluster: Cluster) -> str:
    """Create an account by an invitation, and return the id of its person."""
    link = cluster.terminal.run("person", "invite", _EMAIL, "--name", "Ada").out.strip()
    url = cluster.runtime_info()["url"]
    accepted = {"code": link.partition("#")[2], "name": "Ada", "password": _PASSWORD}
    headers = {"Content-Type": "application/json", "Origin": url}
    answer = urllib3.request("POST", f"{url}/api/v1/auth/invitation", body=json.dumps(accepted), headers=headers)
    assert answer.status == 200, answer.data
    person_id: str = answer.json()["person"]["id"]
    return person_id


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_account_mission_form_failed_job_and_scrub(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    # A job at its last attempt, which fails.
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
    ada = _accept_invitation(cluster)
    sql(
        cluster,
        "INSERT INTO identity (id, person_id, issuer, subject, email)"
        " VALUES (gen_random_uuid(), %s, 'https://gone.example', 'ada', 'ada@gone.example') RETURNING id",
        ada,
    )
    results = run_browser("account.mjs", cluster, _EMAIL, _PASSWORD, project, pictures)

    assert [results[name] for name in ("consoleErrors", "axe", "overflowing", "executed")] == [[], [], [], []]
    assert "Compared\n0 objects" in results["scrub"]
    assert "Newly lost\n0" in results["scrub"]
    assert "ada@lab.example verified by your invitation" in results["account"]
    assert "This server no longer offers this provider." in results["account"]
    assert results["tooShort"] == "Use at least 10 characters."
    assert results["wrongPassword"] == "Wrong password."
    assert (results["statusBefore"], results["statusAfter"]) == (200, 401)
    assert sql(cluster, "SELECT unlinked_at IS NULL FROM identity WHERE person_id = %s", ada) == [(False,)]
    assert results["prefilled"] == ["spot", "", ""], "all values except operator and day are copied"
    assert results["unconfirmed"] == "Confirm or change this value."
    assert results["nameMissing"] == "Enter a name."
    assert results["robotMissing"] == "Required."
    assert "[a-z]+" in results["operatorWrong"]
    assert "already" in results["nameTaken"]
    assert "spot" in results["mission"]
    assert "Ada" in results["mission"]
    metadata = {row["name"]: row["metadata"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    assert metadata["ridge"] == {"robot": "spot", "operator": "Ada"}
