"""Files, recordings and topics, inserted directly into the database."""

import datetime
import hashlib
import json
import uuid
from dataclasses import dataclass
from typing import Any

from kleinkram.contract.names import name_key
from kleinkram.server.access.builtin_groups import OWNER_ID
from tests.integration.api_server import Api


@dataclass(frozen=True)
class Sample:
    """Puts rows behind an API's back."""

    api: Api

    def file(
        self,
        mission_id: str,
        path: str,
        *,
        topics: list[dict[str, Any]] | None = None,
        labels: tuple[str, ...] = (),
        **bytes_: Any,
    ) -> str:
        """Put a file, with a blob of its own described by `bytes_`; returns its id."""
        blob_id = self.blob(**bytes_)
        for topic in topics or []:
            self._insert("topic", {"blob_id": blob_id, **topic})
        return self.link(mission_id, path, blob_id, labels=labels)

    def blob(self, **columns: Any) -> str:
        """Put a blob; returns its id."""
        blob_id = str(columns.get("id", uuid.uuid4()))
        values = {
            "id": blob_id,
            "key": f"blobs/{blob_id}",
            "size_bytes": 100,
            "sha256": hashlib.sha256(blob_id.encode()).digest(),
            "uploaded_by_id": OWNER_ID,
            "content": "indexed",
            "format": "mcap",
            "summarised_at": datetime.datetime.now(datetime.timezone.utc),
            **columns,
        }
        self._insert("blob", values)
        return blob_id

    def link(self, mission_id: str, path: str, blob_id: str, *, labels: tuple[str, ...] = ()) -> str:
        """Put a file for a blob that is there; returns its id."""
        file_id = str(uuid.uuid4())
        names = {"mission_id": mission_id, "path": path, "path_key": name_key(path), "blob_id": blob_id}
        who = {"origin": "upload", "uploaded_by_id": OWNER_ID, "labels": list(labels)}
        self._insert("file", {"id": file_id, **names, **who})
        # Marks the mission as changed, as services do, so that its totals are computed again.
        self.api.sql("UPDATE mission SET file_count = NULL, duration_ns = NULL WHERE id = %s", mission_id)
        return file_id

    def recording(self, mission_id: str, name: str, file_ids: list[str], **columns: Any) -> str:
        """Put a recording made of files; returns its id."""
        recording_id = str(uuid.uuid4())
        self._insert(
            "recording", {"id": recording_id, "mission_id": mission_id, "name": name, "kind": "mcap", **columns}
        )
        self.api.sql("UPDATE file SET recording_id = %s WHERE id = ANY(%s::uuid[])", recording_id, file_ids)
        return recording_id

    def _insert(self, table: str, values: dict[str, Any]) -> None:
        names = ", ".join(f'"{name}"' for name in values)
        places = ", ".join(["%s"] * len(values))
        # dicts are for jsonb columns
        row = [json.dumps(value) if isinstance(value, dict) else value for value in values.values()]
        self.api.sql(f"INSERT INTO {table} ({names}) VALUES ({places})", *row)
