"""Random histories of uploads and blobs on a real server, checked against a model after each step."""

import re
import uuid
from functools import partial
from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, rule

from kleinkram.server.blobs.scrub import scrub_store
from kleinkram.server.context import AppContext
from kleinkram.server.maintenance import collect_garbage
from kleinkram.server.uploads.jobs import maintain_uploads
from tests.integration.api_server import Api
from tests.integration.upload_client import begin, complete, send, sha256
from tests.integration.uploads.server_access import SiteThread, verify_all

_PAGE = Path(__file__).parents[3] / "docs" / "states.md"
_PATHS = ("a.bin", "b.bin", "c/d.bin")
_BODIES = (b"one", b"another", b"the third one")

# The server's answer about an upload, if it must be sent, and the bytes to send.
Upload = tuple[dict[str, Any], bytes]


def documented(heading: str) -> set[tuple[str, str]]:
    """Return the changes of state that the page on states names under a heading."""
    section = _PAGE.read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    return set(re.findall(r"^\| (\w+) \| (\w+) \| ", section, re.MULTILINE)) - {("from", "to")}


def _reached(edges: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Several changes may lie between two looks."""
    result = set(edges)
    while more := {(a, d) for a, b in result for c, d in result if b == c} - result:
        result |= more
    return result


class Machine(RuleBasedStateMachine):
    """What people, jobs and a lying store do to one mission, in any order."""

    api: Api
    context: SiteThread
    uploads: Bundle[Upload] = Bundle("uploads")

    def __init__(self) -> None:
        super().__init__()
        self._wipe()
        self.project_id = self.api.project()["id"]
        self.mission_id = self.api.mission(self.project_id)["id"]
        # By key: how the test changed an object in the store.
        self.done_to: dict[str, str] = {}
        self.trashed: dict[str, str] = {}
        self.seen: dict[tuple[str, str], str] = {}
        # To complete is to go two ways at once; a blob goes one at a time.
        self.edges = {"upload": _reached(documented("An upload")), "blob": documented("A blob")}

    def _wipe(self) -> None:
        """Take away what an earlier life left that something was wrong with."""
        for table in ("upload", "file", "blob"):
            self.api.sql(f"DELETE FROM {table}")
        for key in self._keys():
            self.context.run(partial(_delete, key=key))

    # What people do.

    @rule(target=uploads, path=st.sampled_from(_PATHS), body=st.sampled_from(_BODIES), hashed=st.booleans())
    def announce(self, path: str, body: bytes, hashed: bool) -> Upload:
        """Announce a file; it is sent, linked, there already, or refused since the name is held or taken."""
        return self._begin(path, body, hashed=hashed)

    def _begin(self, path: str, body: bytes, *, hashed: bool) -> Upload:
        decision = begin(self.api, self.mission_id, {path: body}, hashed=hashed)[0]
        if decision["decision"] == "refused":
            assert decision["problem"]["code"] in {"name_leased", "file_exists"}
            assert self._holds(path), "refused, although the name is free"
        if decision["decision"] in {"deduplicated", "already_present"}:
            self._see_that_it_can_be_read(path, body)
        return decision.get("upload") or {}, body

    @rule(path=st.sampled_from(_PATHS), body=st.sampled_from(_BODIES))
    def bring(self, path: str, body: bytes) -> None:
        """Upload a file completely, if its name is free; this repairs a damaged one."""
        upload = self._begin(path, body, hashed=True)
        self._send(upload)
        self._complete(upload)
        if upload[0]:
            self._see_that_it_can_be_read(path, body)

    @rule(upload=uploads)
    def send(self, upload: Upload) -> None:
        """Send all of a file, if its upload is open."""
        self._send(upload)

    def _send(self, upload: Upload) -> None:
        if upload[0] and self._state(upload[0]) == "open" and self._key(upload[0]) not in self._keys():
            send(self.api, *upload)

    @rule(upload=uploads)
    def complete(self, upload: Upload) -> None:
        """Complete an upload; what is said to be completed is a file with these bytes."""
        self._complete(upload)

    def _complete(self, upload: Upload) -> None:
        if not upload[0]:
            return
        was, arrived_bytes = self._state(upload[0]), self._keys().get(self._key(upload[0]))
        outcome = complete(self.api, *upload)
        if outcome["outcome"] == "completed":
            assert outcome["file"]["sha256"] == sha256(upload[1])
            assert was == "done" or (was, arrived_bytes) == ("open", len(upload[1])), "it ended, or not all of it came"
        elif was == "open" and arrived_bytes == len(upload[1]):
            assert outcome["problem"]["code"] in {"file_exists", "upload_gone"}

    @rule(upload=uploads)
    def abort(self, upload: Upload) -> None:
        """Break an upload off."""
        if upload[0]:
            self.api.delete(f"/uploads/{upload[0]['id']}").ok(204)

    @rule(place=st.integers(0, 2))
    def delete(self, place: int) -> None:
        """Move a file to the trash."""
        if len(files := self._files()) > place:
            self.api.delete(f"/files/{files[place]['id']}").ok()
            self.trashed[files[place]["id"]] = files[place]["path"]

    @rule(place=st.integers(0, 2))
    def restore(self, place: int) -> None:
        """Put a file back, where its name is free."""
        for file_id, path in list(self.trashed.items())[place : place + 1]:
            is_free = path not in {file["path"] for file in self._files()}
            answer = self.api.post(f"/trash/file/{file_id}/restore")
            assert answer.status == (204 if is_free else 409), answer
            if is_free:
                del self.trashed[file_id]

    # What time and jobs do.

    @rule()
    def expire_lease(self) -> None:
        """Let all names go that are held for uploads; these can go on until another takes the name."""
        self.api.sql("UPDATE upload SET lease_ends_at = now() - interval '1 hour' WHERE state = 'open'")

    @rule()
    def expire(self) -> None:
        """Let all that is under way expire, and clean up after it; then nothing is reserved."""
        self.expire_lease()
        self.api.sql("UPDATE upload SET expires_at = now() WHERE state = 'open'")
        self.context.run(lambda context: maintain_uploads(context, stale_after_s=0))
        reply = self.api.get(f"/projects/{self.project_id}").ok()
        assert (reply["used_files"], reply["used_bytes"]) == (reply["file_count"], reply["size_bytes"])

    @rule()
    def empty_trash(self) -> None:
        """Let what is in the trash be old enough, and collect garbage."""
        self.api.sql("UPDATE file SET deleted_at = now() - interval '31 days' WHERE deleted_at IS NOT NULL")
        self.trashed.clear()
        self.collect_garbage()

    @rule()
    def collect_garbage(self) -> None:
        """Mark what nothing refers to, then delete it."""
        for _ in range(2):
            self.context.run(collect_garbage)

    @rule()
    def verify(self) -> None:
        """Read every blob; afterwards each says what was done to it."""
        self.context.run(verify_all)
        self._check_answer({"whole": "verified", "gone": "lost", "cut": "corrupt", "altered": "corrupt"})

    @rule()
    def scrub(self) -> None:
        """Compare the store's list; afterwards each blob says whether its object is there, and of its size."""
        scrub_id = uuid.UUID(self.api.post("/admin/scrub", {"accept_losses": True}).ok(202)["id"])
        self.context.run(lambda context: scrub_store(context, scrub_id))
        self._check_answer({"gone": "lost", "cut": "corrupt"})

    # What a store does that lies.

    @rule(path=st.sampled_from(_PATHS), body=st.sampled_from(_BODIES), what=st.sampled_from(["gone", "cut"]))
    def bring_in_vain(self, path: str, body: bytes, what: str) -> None:
        """Upload a file of which less is kept than was sent, or nothing."""
        upload = self._begin(path, body, hashed=True)
        self._send(upload)
        self.swallow(upload, what)
        self._complete(upload)

    @rule(path=st.sampled_from(_PATHS), body=st.sampled_from(_BODIES), is_regretted=st.booleans())
    def bring_too_late(self, path: str, body: bytes, is_regretted: bool) -> None:
        """Upload a file, and complete it once it was broken off or has expired."""
        upload = self._begin(path, body, hashed=True)
        self._send(upload)
        if is_regretted:
            self.abort(upload)
        else:
            self.expire()
        self._complete(upload)

    def swallow(self, upload: Upload, what: str) -> None:
        """Keep less than what was sent of an upload that is open, or nothing."""
        if not upload[0] or self._state(upload[0]) != "open" or (key := self._key(upload[0])) not in self._keys():
            return
        if what == "gone":
            self.context.run(lambda context: context.storage.delete(key))
        else:
            self.context.run(lambda context: context.storage.put_object(key, upload[1][:-1]))

    @rule(place=st.integers(0, 2), what=st.sampled_from(["gone", "cut", "altered", "whole"]))
    def lie(self, place: int, what: str) -> None:
        """Remove, cut or alter an object of a file, or bring back what it was."""
        rows = self._blobs()
        if len(rows) <= place:
            return
        key, digest = rows[place][1], rows[place][3]
        body = next(item for item in _BODIES if sha256(item) == digest)
        if what == "gone":
            self.context.run(lambda context: context.storage.delete(key))
        else:
            put = {"cut": body[:-1], "altered": body[:-1] + b"\0", "whole": body}[what]
            self.context.run(lambda context: context.storage.put_object(key, put))
        self.done_to[key] = what

    # What is always true.

    @invariant()
    def every_file_is_readable_or_says_that_it_is_not(self) -> None:
        """An undamaged object is complete, and its row does not say that it is lost."""
        listed = self._keys()
        for state, key, size_bytes, _ in self._blobs():
            harm = self.done_to.get(key)
            if harm is None:
                assert listed.get(key) == size_bytes
                assert state in {"stored", "verified"}
            elif harm != "whole":
                assert state in {"stored", "verified", "lost", "corrupt"}

    @invariant()
    def every_object_is_known(self) -> None:
        """No object without a row that sees to its end."""
        known = "SELECT key FROM blob UNION SELECT key FROM upload WHERE cleaned_at IS NULL"
        assert {key for key in self._keys() if not key.startswith("probe/")} <= {row[0] for row in self.api.sql(known)}

    @invariant()
    def what_is_used_adds_up(self) -> None:
        """Files and uploads under way, each once."""
        reply = self.api.get(f"/projects/{self.project_id}").ok()
        sizes = [file["size_bytes"] for file in self._files()]
        under_way = "SELECT size_bytes FROM upload WHERE mission_id = %s AND state IN ('open', 'completing')"
        coming = [row[0] for row in self.api.sql(under_way, self.mission_id)]
        assert len(coming) <= len(_PATHS), "a name is held twice"
        assert (reply["file_count"], reply["size_bytes"]) == (len(sizes), sum(sizes))
        assert (reply["used_files"], reply["used_bytes"]) == (len(sizes + coming), sum(sizes + coming))

    @invariant()
    def states_move_along_documented_edges(self) -> None:
        """As `docs/states.md` has them; and a marked blob stays marked."""
        now = {("upload", row[0]): row[1] for row in self.api.sql("SELECT id::text, state FROM upload")}
        now |= {("blob", row[0]): row[1] for row in self.api.sql("SELECT id::text, state FROM blob")}
        for what, state in now.items():
            before = self.seen.get(what, state)
            assert before == state or (before, state) in self.edges[what[0]], (what[0], before, state)
        self.seen = now

    def teardown(self) -> None:
        """In the end nothing is blocked, and nothing is left."""
        self.done_to |= dict.fromkeys(self._keys(), "whole")  # what is looked at now is only what is left
        self.expire()
        for file in self._files():
            self.api.delete(f"/files/{file['id']}").ok()
        for path in _PATHS:
            assert begin(self.api, self.mission_id, {path: b"free?" + path.encode()})[0]["decision"] == "upload"
        self.expire()
        self.empty_trash()
        assert {key for key in self._keys() if not key.startswith("probe/")} == set()
        assert self.api.sql("SELECT count(*) FROM blob") == [(0,)]
        self.api.delete(f"/projects/{self.project_id}").ok()

    # How it looks.

    def _files(self) -> list[Any]:
        return self.api.all("/files", {"mission_id": self.mission_id})

    def _blobs(self) -> list[tuple[Any, ...]]:
        """State, key, size and SHA-256 of the live files' blobs, by path."""
        return self.api.sql(
            "SELECT b.state, b.key, b.size_bytes, encode(b.sha256, 'hex') FROM file f JOIN blob b ON b.id = f.blob_id"
            " WHERE f.mission_id = %s AND f.deleted_at IS NULL ORDER BY f.path",
            self.mission_id,
        )

    def _keys(self) -> dict[str, int]:
        return self.context.run(lambda context: context.storage.sizes(""))

    def _state(self, upload: dict[str, Any]) -> str | None:
        rows = self.api.sql("SELECT state FROM upload WHERE id = %s", upload["id"])
        return str(rows[0][0]) if rows else None

    def _key(self, upload: dict[str, Any]) -> str:
        rows = self.api.sql("SELECT key FROM upload WHERE id = %s", upload["id"])
        return str(rows[0][0]) if rows else ""

    def _holds(self, path: str) -> bool:
        locked = (
            "SELECT 1 FROM upload WHERE mission_id = %s AND path = %s"
            " AND (state = 'completing' OR state = 'open' AND lease_ends_at > now())"
        )
        return bool(self.api.sql(locked, self.mission_id, path)) or path in {file["path"] for file in self._files()}

    def _see_that_it_can_be_read(self, path: str, body: bytes) -> None:
        """No response presents a file as present that is known to be lost or corrupt."""
        [file] = [item for item in self._files() if item["path"] == path]
        assert (file["sha256"], file["state"] in {"stored", "verified"}) == (sha256(body), True)

    def _check_answer(self, shown: dict[str, str]) -> None:
        for state, key, *_ in self._blobs():
            done = self.done_to.get(key, "whole")
            assert state == shown.get(done, state), (done, state)


async def _delete(context: AppContext, key: str) -> None:
    await context.storage.delete(key)
