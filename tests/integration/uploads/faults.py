"""Faults to inject into the server, one at a time: the state machine must detect each of them."""

import inspect
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from types import FunctionType
from typing import Any, cast

from kleinkram.server.blobs import queries, scrub, service
from kleinkram.server.blobs.readers import ObjectChecksums
from kleinkram.server.maintenance import _delete_object
from kleinkram.server.uploads import completion, jobs, parts
from kleinkram.server.uploads import queries as upload_queries
from kleinkram.server.uploads import service as upload_service
from tests.integration.uploads.state_machine import Machine, Upload


@dataclass(frozen=True)
class Fault:
    """One text of a function that is replaced, a history that suffices to show it, and what must then find it."""

    name: str
    function: Callable[..., Any]
    right: str
    wrong: str
    found_by: str
    history: str


@contextmanager
def planted(fault: Fault) -> Iterator[None]:
    """Replace the code of a server function until the block ends, for all its callers."""
    function = fault.function
    assert isinstance(function, FunctionType)
    source = textwrap.dedent(inspect.getsource(function))
    assert source.count(fault.right) == 1, f"{function.__qualname__} has changed: adapt {fault.name!r}"
    made: dict[str, Any] = {}
    exec(source.replace(fault.right, fault.wrong), {**vars(sys.modules[function.__module__])}, made)
    sound, function.__code__ = function.__code__, made[function.__name__].__code__
    try:
        yield
    finally:
        function.__code__ = sound


def live(life: Machine, history: str) -> None:
    """Do the steps that a history names, looking after each at what is always true."""
    announced: list[Upload] = []
    steps: dict[str, Callable[[], object]] = {
        "announce": lambda: announced.append(cast("Upload", life.announce("a.bin", b"one", hashed=True))),
        "announce another": lambda: life.announce("a.bin", b"another", hashed=True),
        "send": lambda: life.send(announced[0]),
        "keep a part": lambda: life.swallow(announced[0], "cut"),
        "keep nothing": lambda: life.swallow(announced[0], "gone"),
        "abort": lambda: life.abort(announced[0]),
        "complete": lambda: life.complete(announced[0]),
        "bring": lambda: life.bring("a.bin", b"one"),
        "bring duplicate": lambda: life.bring("b.bin", b"one"),
        "delete": lambda: life.delete(0),
        "restore": lambda: life.restore(0),
        **{f"object {what}": partial(life.lie, 0, what) for what in ("gone", "cut", "altered", "whole")},
        **{
            rule.__name__: rule
            for rule in (life.expire_lease, life.expire, life.collect_garbage, life.verify, life.scrub)
        },
        "empty trash": life.empty_trash,
    }
    for step in history.split(", "):
        steps[step]()
        for invariant in life.invariants:
            invariant.function(life)


_THE_OBJECT_GOES = "await context.storage.delete(row.key)\n"
_FILES_REFER = "exists().where(file.c.blob_id == blob.c.id)"

FAULTS = [
    Fault(
        "complete does not look at the size",
        parts._check_small_files,
        "sizes.get(row.key) != row.size_bytes",
        "row.key not in sizes",
        "_complete",
        "announce, send, keep a part, complete",
    ),
    Fault(
        "complete does not look whether anything came",
        completion.finish_uploads,
        "failures = await join_parts(context.storage, uploads)",
        "failures: Failures = {}",
        "_complete",
        "announce, send, keep nothing, complete",
    ),
    Fault(
        "complete takes up what was broken off",
        completion._reason_against,
        "row.state in {UploadState.aborted.value, UploadState.expired.value}",
        "row.state == UploadState.expired.value",
        "_complete",
        "announce, send, abort, complete",
    ),
    Fault(
        "expiry leaves the reservation",
        jobs.maintain_uploads,
        ".values(state=UploadState.expired.value)",
        ".values(state=UploadState.open.value)",
        "expire",
        "announce, expire",
    ),
    Fault(
        "expiry leaves the object",
        jobs._clean_up,
        _THE_OBJECT_GOES,
        "pass\n",
        "every_object_is_known",
        "announce, send, expire",
    ),
    Fault(
        "what came by two ways stays",
        completion._mark_done,
        "(is_used, func.now())",
        "(upload.c.id.is_not(None), func.now())",
        "every_object_is_known",
        "bring, delete, announce, send, restore, complete",
    ),
    Fault(
        "an expired lease still reserves the name",
        upload_service._decide_with_upload,
        "other.has_lease or",
        "True or",
        "_begin",
        "announce, expire_lease, announce another",
    ),
    Fault(
        "who takes a name over leaves the other's upload",
        upload_service._steal_leases,
        "state=UploadState.aborted.value",
        "state=UploadState.open.value",
        "_begin",
        "announce, expire_lease, announce another",
    ),
    Fault(
        "garbage collection takes what is in the trash",
        queries.is_referenced,
        _FILES_REFER,
        "exists().where(file.c.blob_id == blob.c.id, file.c.deleted_at.is_(None))",
        "collect_garbage",
        "bring, delete, collect_garbage",
    ),
    Fault(
        "garbage collection takes what a second file refers to",
        queries.is_referenced,
        _FILES_REFER,
        "exists().where(file.c.blob_id == blob.c.id, file.c.origin == 'upload')",
        "collect_garbage",
        "bring, bring duplicate, delete, empty trash",
    ),
    Fault(
        "garbage collection leaves the object",
        _delete_object,
        _THE_OBJECT_GOES,
        "pass\n",
        "every_object_is_known",
        "bring, delete, empty trash",
    ),
    Fault(
        "what is known to be lost is linked",
        upload_queries._is_trusted,
        "& (verified | own)",
        "",
        "_see_that_it_can_be_read",
        "bring, object gone, verify, bring duplicate",
    ),
    Fault(
        "what is lost counts as being there",
        upload_service._decide_with_existing,
        "existing.is_damaged",
        "False",
        "_see_that_it_can_be_read",
        "bring, object gone, verify, bring",
    ),
    Fault(
        "the verification does not compare",
        ObjectChecksums.differs_from,
        "if self.size_bytes",
        "if True:\n        return None\n    if self.size_bytes",
        "_check_answer",
        "bring, object altered, verify",
    ),
    Fault(
        "the scrub does not compare sizes",
        scrub._compare_blob,
        " or listed_bytes != row.size_bytes",
        "",
        "_check_answer",
        "bring, object cut, scrub",
    ),
    Fault(
        "what was verified again is still said to be lost",
        service.record_verified,
        '"state": BlobState.verified.value, "state_reason"',
        '"state_reason"',
        "_check_answer",
        "bring, object gone, verify, object whole, verify",
    ),
]
