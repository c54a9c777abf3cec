"""Moving bytes: plan, upload, download, verify. The bytes go straight to and from the store, never through the API."""

from kleinkram.client.transfer.download import download
from kleinkram.client.transfer.download_target import DownloadPlan, DownloadTarget, plan_download
from kleinkram.client.transfer.plan import LocalFile, UploadPlan, plan_upload
from kleinkram.client.transfer.report import CONNECTIONS, LinkReport, Outcome, TransferReport, TransferResult, Watcher
from kleinkram.client.transfer.slices import SlicePlan, SliceRange, download_slices, plan_slices, select_targets
from kleinkram.client.transfer.upload import upload
from kleinkram.client.transfer.verify import Comparison, FileComparison, verify_local, verify_remote

__all__ = [
    "CONNECTIONS",
    "Comparison",
    "DownloadPlan",
    "DownloadTarget",
    "FileComparison",
    "LinkReport",
    "LocalFile",
    "Outcome",
    "SlicePlan",
    "SliceRange",
    "TransferReport",
    "TransferResult",
    "UploadPlan",
    "Watcher",
    "download",
    "download_slices",
    "plan_download",
    "plan_slices",
    "plan_upload",
    "select_targets",
    "upload",
    "verify_local",
    "verify_remote",
]
