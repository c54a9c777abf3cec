"""The real recordings, uploaded once for all tests that compare them with the server's results."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kleinkram.contract.uploads import MAX_FILES_PER_REQUEST
from tests.integration.api_server import Api
from tests.integration.jobs import run_jobs
from tests.integration.upload_client import upload_all


@dataclass(frozen=True)
class Corpus:
    """Where the real recordings are: locally, and in one mission with all its jobs done."""

    api: Api
    mission_id: str
    folder: Path
    files: Mapping[str, str]


def upload_corpus(api: Api, folder: Path) -> Corpus:
    """Upload the folder of real recordings as one mission, and wait for what the server says of it."""
    mission_id = str(api.mission(api.project()["id"])["id"])
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and path != folder / "manifest.json"]
    bodies = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
    files: dict[str, Any] = {}
    for start in range(0, len(paths), MAX_FILES_PER_REQUEST):
        names = [*bodies][start : start + MAX_FILES_PER_REQUEST]
        files |= upload_all(api, mission_id, {name: bodies[name] for name in names})
    run_jobs(api)
    return Corpus(api, mission_id, folder, {name: file["id"] for name, file in files.items()})
