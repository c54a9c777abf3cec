"""People, groups, tokens, the trash and the audit log in real browsers, two at once."""

from pathlib import Path

import pytest

from tests.acceptance.conftest import wait_until
from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

# A job that failed just now: the worker deletes failed jobs without recent events, and queues those without an error.
_FAILED = """
WITH given_up AS (
  INSERT INTO procrastinate_jobs (queue_name, task_name, status, attempts, args)
    SELECT 'default', 'verify_blob', 'failed', 8, jsonb_build_object('ref', id) FROM blob
    RETURNING id, args ->> 'ref' AS ref
), known AS (
  INSERT INTO procrastinate_events (job_id, type, at) SELECT id, 'failed', now() FROM given_up
), explained AS (
  INSERT INTO job_error (job_id, sentence) SELECT id, 'The store did not answer.' FROM given_up
)
SELECT id, ref FROM given_up
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_people_groups_tokens_trash_and_audit_log(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    terminal.run("project", "create", "Alps")
    (tmp_path / "ridge.txt").write_text("above the snow line")
    terminal.run("upload", "-p", "Alps", "-m", "ridge", "--create", tmp_path / "ridge.txt")
    terminal.run("mission", "delete", "ridge", "-p", "Alps", "--yes")
    project = terminal.run("project", "list", "--json").json()["items"][0]["id"]
    # A verification that failed while the store did not answer. A retry succeeds now.
    ((job, blob),) = sql(cluster, _FAILED)

    results = run_browser("people.mjs", cluster, project, job, pictures)

    assert results["executed"] == [], "markup in a name was executed"
    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert (results["refused"], results["adminLinks"]) == ("Admins only", 0)
    assert results["grantStatus"] == 201
    assert (results["statusBefore"], results["statusDuring"], results["statusAfter"]) == (404, 200, 404)
    assert "Read" in results["accessRow"]
    assert "as a member of <img" in results["accessRow"]
    assert "Read" in results["personRights"]
    assert results["createDisabled"], "the form does not create a robot's token without limits"
    assert f"klein login http://127.0.0.1:{cluster.port} --token" in results["loginLine"]
    assert (results["robotStatus"], results["revokedStatus"]) == (200, 401)
    assert "1 file" in results["trashRow"]
    assert terminal.run("mission", "list", "-p", "Alps", "--json").json()["items"][0]["name"] == "ridge"
    assert "revoked the token" in results["auditRow"]
    assert (
        {"token.create", "token.revoke"}
        <= set(results["exportedOperations"])
        <= {"token.create", "token.revoke", "token.bind"}
    )
    assert "robot" in results["changes"]
    assert "1 session" in results["deactivation"]
    assert results["adminStatuses"] == [200, 403]
    assert results["resetStatuses"] == [401, 200], "a new password ends the sessions of the old one"
    assert results["deactivated"][0] == 401
    assert "is wrong" in results["deactivated"][1], (
        "the correct password of a deactivated account is refused like a wrong one"
    )
    assert results["reactivatedStatus"] == 200
    assert results["eraseDisabled"], "the name must be typed"
    assert "appears as “erased person" in results["erasure"]
    assert (results["erasedStatus"], results["eraseButtons"]) == (401, 0)
    assert results["noFailedJobs"] == 1
    ended = "SELECT status::text FROM procrastinate_jobs WHERE id = %s"
    wait_until(lambda: sql(cluster, ended, job) in ([], [("succeeded",)]), "the job to be done")
    assert sql(cluster, "SELECT state FROM blob WHERE id = %s", blob) == [("verified",)]
