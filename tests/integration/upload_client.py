"""A client of the upload protocol, one step at a time."""

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import urllib3

from kleinkram.contract.uploads import crc64nvme
from tests.integration.api_server import Answer, Api

_POOL = urllib3.PoolManager(retries=False, timeout=30, maxsize=4)


def sha256(body: bytes) -> str:
    """Lower-case hex."""
    return hashlib.sha256(body).hexdigest()


def crc64(body: bytes) -> str:
    """CRC-64/NVME, lower-case hex."""
    return int(crc64nvme(body)).to_bytes(8, "big").hex()


def md5(body: bytes) -> str:
    """Lower-case hex."""
    return hashlib.md5(body).hexdigest()


def checksum(kind: str, body: bytes) -> str:
    """The checksum that an upload asks for."""
    return {"crc64nvme": crc64, "sha256": sha256, "md5": md5}[kind](body)


def begin(api: Api, mission_id: str, files: Mapping[str, bytes], *, hashed: bool = True, **more: Any) -> list[Any]:
    """Announce files; returns the decisions."""
    requested = [
        {"path": path, "size_bytes": len(body), **({"sha256": sha256(body)} if hashed else {}), **more}
        for path, body in files.items()
    ]
    return list(api.post(f"/missions/{mission_id}/uploads", {"files": requested}).ok()["items"])


def parts_of(upload: Mapping[str, Any], body: bytes) -> list[tuple[int, bytes]]:
    """Cut a body as the upload says."""
    size = upload["part_size_bytes"]
    return [(number, body[start : start + size]) for number, start in enumerate(range(0, max(1, len(body)), size), 1)]


def sign(api: Api, upload: Mapping[str, Any], parts: Sequence[tuple[int, bytes]]) -> Answer:
    """Ask where to send parts."""
    requested = [
        {"upload_id": upload["id"], "number": number, "checksum": checksum(upload["checksum"], body)}
        for number, body in parts
    ]
    return api.post("/uploads/parts", {"parts": requested})


def put(signed: Mapping[str, Any], body: bytes, headers: Mapping[str, str] | None = None) -> int:
    """Send one part; returns the store's status."""
    sent = signed["headers"] if headers is None else headers
    return int(_POOL.request("PUT", signed["url"], body=body, headers=sent).status)


def send(api: Api, upload: Mapping[str, Any], body: bytes, *, only: Sequence[int] | None = None) -> None:
    """Send the parts of a body, or only some of them."""
    parts = [part for part in parts_of(upload, body) if only is None or part[0] in only]
    for (_, piece), signed in zip(parts, sign(api, upload, parts).ok()["items"], strict=True):
        assert put(signed, piece) == 200


def complete(api: Api, upload: Mapping[str, Any], body: bytes) -> Any:
    """Finish one upload; returns its outcome."""
    finish = {"upload_id": upload["id"], "sha256": sha256(body), "crc64nvme": crc64(body)}
    return api.post("/uploads/complete", {"uploads": [finish]}).ok()["items"][0]


def upload(api: Api, mission_id: str, path: str, body: bytes) -> Any:
    """Upload one file, whole; returns the file."""
    decision = begin(api, mission_id, {path: body})[0]
    if decision["decision"] in {"already_present", "deduplicated"}:
        return decision["file"]
    assert decision["decision"] == "upload", decision
    send(api, decision["upload"], body)
    outcome = complete(api, decision["upload"], body)
    assert outcome["outcome"] == "completed", outcome
    return outcome["file"]


def upload_all(api: Api, mission_id: str, files: Mapping[str, bytes]) -> dict[str, Any]:
    """Upload many small files with few requests; returns the files by path."""
    decisions = dict(zip(files, begin(api, mission_id, files), strict=True))
    ready = {
        path: decision["file"]
        for path, decision in decisions.items()
        if decision["decision"] in {"already_present", "deduplicated"}
    }
    uploads = {path: decision["upload"] for path, decision in decisions.items() if path not in ready}
    if not uploads:
        return ready
    return ready | complete_all(api, uploads, files)


def complete_all(api: Api, uploads: Mapping[str, Any], files: Mapping[str, bytes]) -> dict[str, Any]:
    """Send and finish many uploads with few requests; returns what became of each, by path."""
    parts = [(uploads[path], part) for path in uploads for part in parts_of(uploads[path], files[path])]
    requested = [
        {"upload_id": upload["id"], "number": number, "checksum": checksum(upload["checksum"], body)}
        for upload, (number, body) in parts
    ]
    signed = api.post("/uploads/parts", {"parts": requested}).ok()["items"]
    with ThreadPoolExecutor(4) as threads:
        statuses = threads.map(put, signed, [body for _, (_, body) in parts])
    assert set(statuses) <= {200}
    finished = [
        {"upload_id": upload["id"], "sha256": sha256(files[path]), "crc64nvme": crc64(files[path])}
        for path, upload in uploads.items()
    ]
    outcomes = api.post("/uploads/complete", {"uploads": finished}).ok()["items"]
    assert {decision["outcome"] for decision in outcomes} <= {"completed"}, outcomes
    return {path: decision["file"] for path, decision in zip(uploads, outcomes, strict=True)}


def fetch(url: str, **headers: str) -> tuple[int, bytes]:
    """Read from a signed address."""
    answer = _POOL.request("GET", url, headers=headers)
    return int(answer.status), bytes(answer.data)


def wait_until(holds: Callable[[], bool], *, limit_s: float = 60) -> None:
    """Ask again until something holds."""
    deadline = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < deadline, "it did not come to hold in time"
        time.sleep(0.05)
