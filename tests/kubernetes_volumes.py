"""The volumes of a cluster for tests: folders of this machine, made for each claim and removed with it."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import urllib3

from tests.kubernetes_access import Api, ApiRefusal, Body
from tests.kubernetes_cluster import NODE, PROVISIONER, STORAGE_CLASS

_POLL_S = 0.1
_NODE_CHOSEN = "volume.kubernetes.io/selected-node"


class FolderVolumes:
    """Makes a volume for each claim, once the scheduler has chosen a node, as storage drivers do.

    `folder_of` names a folder for some claims, which stays; the others have one of their own.
    """

    def __init__(self, api: Api, folder: Path) -> None:
        self._api = api
        self._folder = folder
        self.folder_of: Callable[[str], Path | None] = lambda claim: None
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="volumes", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._is_closed.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._is_closed.wait(_POLL_S):
            try:
                self._remove_released()
                self._make_missing()
            except (ApiRefusal, urllib3.exceptions.HTTPError):  # noqa: PERF203  each round is a request
                continue  # the API server is away, or somebody else was faster

    def _make_missing(self) -> None:
        for claim in self._api.items("/api/v1/persistentvolumeclaims"):
            is_ours = claim["spec"].get("storageClassName") == STORAGE_CLASS
            is_wanted = _NODE_CHOSEN in claim["metadata"].get("annotations", {})
            if is_ours and is_wanted and claim["status"]["phase"] == "Pending":
                self._make(claim)

    def _make(self, claim: Body) -> None:
        metadata = claim["metadata"]
        name = f"pvc-{metadata['uid']}"
        if self._api.find(f"/api/v1/persistentvolumes/{name}") is not None:
            return
        folder = self.folder_of(metadata["name"]) or self._folder / name
        folder.mkdir(parents=True, exist_ok=True)
        body: Body = {
            "apiVersion": "v1",
            "kind": "PersistentVolume",
            "metadata": {"name": name, "annotations": {"pv.kubernetes.io/provisioned-by": PROVISIONER}},
            "spec": {
                "capacity": claim["spec"]["resources"]["requests"],
                "accessModes": claim["spec"]["accessModes"],
                "persistentVolumeReclaimPolicy": "Delete",
                "storageClassName": STORAGE_CLASS,
                "local": {"path": str(folder)},
                "claimRef": {
                    "kind": "PersistentVolumeClaim",
                    "namespace": metadata["namespace"],
                    "name": metadata["name"],
                    "uid": metadata["uid"],
                },
                "nodeAffinity": {
                    "required": {
                        "nodeSelectorTerms": [
                            {
                                "matchExpressions": [
                                    {"key": "kubernetes.io/hostname", "operator": "In", "values": [NODE]}
                                ]
                            }
                        ]
                    }
                },
            },
        }
        self._api.send("POST", "/api/v1/persistentvolumes", body)

    def _remove_released(self) -> None:
        for volume in self._api.items("/api/v1/persistentvolumes"):
            if volume["status"].get("phase") in {"Released", "Failed"}:
                name = volume["metadata"]["name"]
                shutil.rmtree(self._folder / name, ignore_errors=True)
                self._api.send("DELETE", f"/api/v1/persistentvolumes/{name}")
