"""Moving bytes: plan, upload, download, verify. The bytes go straight to and from the store, never through the API."""

from kleinkram.client.transfer.destination import DownloadPlan, Target, plan_download
from kleinkram.client.transfer.download import download
from kleinkram.client.transfer.link import LinkReport
from kleinkram.client.transfer.outcome import Outcome, TransferReport, TransferResult
from kleinkram.client.transfer.plan import LocalFile, UploadPlan, plan_upload
from kleinkram.client.transfer.progress import Watcher
from kleinkram.client.transfer.upload import upload
from kleinkram.client.transfer.verify import Verdict, Verified, verify_local, verify_remote

__all__ = [
    "DownloadPlan",
    "LinkReport",
    "LocalFile",
    "Outcome",
    "Target",
    "TransferReport",
    "TransferResult",
    "UploadPlan",
    "Verdict",
    "Verified",
    "Watcher",
    "download",
    "plan_download",
    "plan_upload",
    "upload",
    "verify_local",
    "verify_remote",
]
