"""For tests of an action: run its code as a plain process, without server, container or mission.

```python
def test_it_counts(tmp_path):
    ran = try_out("main.py", tmp_path, files={"drive.mcap": SAMPLE}, parameters={"topics": "/imu*"})
    assert ran.exit_code == 0, ran.log
    assert ran.metric("messages") == 589
```

Dependencies of a script that are not installed where the test runs are installed for it, from the package index of
`KLEINKRAM_PACKAGE_INDEX` (default: PyPI). The run is not isolated: it can read and write whatever the test can.
`klein action run-local` is the next step.
"""

import contextlib
import datetime
import hashlib
import os
import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kleinkram.action.launch import find_missing
from kleinkram.action.run_files import IN_VARIABLE, OUT_VARIABLE, PACKAGES_VARIABLE
from kleinkram.checks.document import read_checks, reference_of
from kleinkram.client.actions import MANIFEST, read_manifest
from kleinkram.client.errors import InvalidInput
from kleinkram.contract.access import Right
from kleinkram.contract.actions import ActionDefinition, ParameterValues
from kleinkram.contract.checks import CheckStatus, Verdict
from kleinkram.contract.files import BlobState, ContentState, FileRead
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.missions import MissionRead, MissionRef
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.reports import EVENTS_FILE, REPORT_FILE, Report, ReportEvent, verdict_of_report
from kleinkram.contract.runs import CONTEXT_FILE, ActionRef, Cause, RunChecks, RunContext
from kleinkram.environments.cache import CannotInstall, Environment, EnvironmentRequest, compile_packages
from kleinkram.environments.local import local_environments, local_index, with_lock
from kleinkram.environments.python import PROBE, PythonUnknown, parse_python

_NOBODY = PersonRef(id=uuid.UUID(int=1), name="nobody")
_MISSION = MissionRef(id=uuid.UUID(int=2), name="mission", project=ProjectRef(id=uuid.UUID(int=3), name="project"))
_CREATED_AT = datetime.datetime(2024, 5, 1, tzinfo=datetime.timezone.utc)


@dataclass(frozen=True)
class TryOutResult:
    """The exit code, output, results directory and report of a run."""

    exit_code: int
    log: str
    out: Path
    report: Report

    def metric(
        self, name: str, file: str | None = None, *, topic: str | None = None, labels: Mapping[str, str] | None = None
    ) -> float:
        """Return the last value of a metric, by default of the whole run.

        Raises:
            KeyError: it was not reported.
        """
        key = (name, file, topic, tuple(sorted((labels or {}).items())))
        return {entry.key: entry.value for entry in self.report.metrics}[key]

    def statuses(self, name: str) -> set[CheckStatus]:
        """Return the statuses of the checks of this name."""
        return {entry.status for entry in self.report.checks if entry.name == name}

    @property
    def verdict(self) -> Verdict | None:
        """The worst of what it reported: verdict, checks and findings; None where it judged nothing."""
        return verdict_of_report(self.report)

    def codes(self) -> set[str]:
        """Return the codes of all findings."""
        return {entry.code for entry in self.report.findings}


def try_out(
    script: str | os.PathLike[str],
    folder: Path,
    *,
    files: Mapping[str, Path | bytes],
    parameters: ParameterValues | None = None,
    metadata: Metadata | None = None,
    checks: str | None = None,
    timeout_s: float = 60,
) -> TryOutResult:
    """Run a script on files, given by their paths in the mission, in an empty directory.

    The manifest is `action.yaml` beside the script, or the script's header. All files are inputs, whatever `inputs` the
    manifest declares. `metadata` is that of the mission, `checks` the text of its project's `checks.yaml`; they name
    the reference that the run reads, if the manifest declares it.

    Raises:
        InvalidInput: the manifest or a parameter is invalid, or its dependencies cannot be installed.
        YamlInvalid: the text of the checks is wrong, and names the reference.
        subprocess.TimeoutExpired: it took too long.
    """
    code = Path(script).resolve()
    definition = read_manifest(code.parent if (code.parent / MANIFEST).exists() else code)
    try:
        values = definition.fill_in(parameters or {})
    except ValueError as error:
        raise InvalidInput(what="The parameters", reason=str(error)) from error
    in_dir, out, scratch = (folder / name for name in ("in", "out", "tmp"))
    for directory in (in_dir, out, scratch):
        directory.mkdir()
    context = RunContext(
        run_id=None,
        action=ActionRef(name=definition.name, version=None),
        parameters=values,
        cause=Cause(person=None),
        mission=_mission(metadata or {}),
        files=[_put(in_dir, path, content) for path, content in sorted(files.items())],
        topics=[],
        recordings=[],
        checks=None if checks is None else _checks(checks),
        reference=reference_of(read_checks(checks) if checks else None, metadata or {})
        if definition.inputs.reference
        else None,
    )
    (in_dir / CONTEXT_FILE).write_text(context.model_dump_json())
    variables = {IN_VARIABLE: str(in_dir), OUT_VARIABLE: str(out), "TMPDIR": str(scratch)}
    with contextlib.ExitStack() as stack:
        if (environment := _install(definition)) is not None:
            stack.callback(environment.close)
            path = [str(environment.packages), *filter(None, [os.environ.get("PYTHONPATH")])]
            variables |= {PACKAGES_VARIABLE: str(environment.packages), "PYTHONPATH": os.pathsep.join(path)}
        ran = _run_script(code, {**os.environ, **variables}, scratch, timeout_s)
    return TryOutResult(ran.returncode, ran.stdout, out, _read_report(out))


def _run_script(
    script: Path, environment: Mapping[str, str], folder: Path, timeout_s: float
) -> "subprocess.CompletedProcess[str]":
    """Run a script to its end, with errors among its output."""
    return subprocess.run(
        [sys.executable, str(script)],
        env=environment,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=timeout_s,
        check=False,
    )


def _install(definition: ActionDefinition) -> Environment | None:
    """Return the environment of a script; None where all of its dependencies are installed here."""
    path = [*os.environ.get("PYTHONPATH", "").split(os.pathsep), *sys.path]
    if definition.lock is None and not find_missing(definition.dependencies, path):
        return None
    try:
        index = local_index()
        locked = with_lock(definition, index, time.sleep)
        if locked.lock is None or index is None:
            return None
        probe = subprocess.run([sys.executable, "-I", "-c", PROBE], capture_output=True, text=True, check=False)
        request = EnvironmentRequest(locked.lock, parse_python(probe.stdout), definition.requires_python)
        return local_environments(index).get(
            request,
            wait=time.sleep,
            show=lambda *_: None,
            compile_in=lambda folder, wait: compile_packages(sys.executable, folder, wait),
        )
    except (ValueError, CannotInstall, PythonUnknown) as error:
        raise InvalidInput(what=f"The dependencies of {definition.name}", reason=str(error)) from error


def _put(folder: Path, path: str, content: Path | bytes) -> FileRead:
    file = folder / path
    file.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, bytes):
        file.write_bytes(content)
    else:
        shutil.copyfile(content, file)
    fields: dict[str, object] = dict.fromkeys(FileRead.model_fields.keys() - {"etag"})
    fields |= {"id": uuid.uuid4(), "mission": _MISSION, "path": path, "size_bytes": file.stat().st_size}
    fields |= {"state": BlobState.stored, "content": ContentState.pending, "origin": "test"}
    fields |= {"uploaded_by": _NOBODY, "created_at": _CREATED_AT}
    fields |= {name: [] for name in ("labels", "compression", "problems", "facts")}
    return FileRead.model_validate(fields)


def _checks(text: str) -> RunChecks:
    return RunChecks(version=1, sha256=hashlib.sha256(text.encode()).hexdigest(), text=text)


def _mission(metadata: Metadata) -> MissionRead:
    fields: dict[str, object] = dict.fromkeys(
        name for name, field in MissionRead.model_fields.items() if field.is_required()
    )
    fields |= {**_MISSION.model_dump(), "metadata": metadata, "metadata_problems": [], "notes": "", "right": Right.read}
    fields |= {"created_at": _CREATED_AT, "created_by": _NOBODY, "recordings_current": False}
    fields |= dict.fromkeys(("file_count", "size_bytes", "message_count", "pending_file_count"), 0)
    return MissionRead.model_validate(fields)


def _read_report(out: Path) -> Report:
    """Return the events, followed by the report."""
    events_file, report_file = out / EVENTS_FILE, out / REPORT_FILE
    lines = events_file.read_bytes().splitlines() if events_file.exists() else []
    events = [ReportEvent.model_validate_json(line) for line in lines]
    last = Report.model_validate_json(report_file.read_bytes()) if report_file.exists() else Report()
    metadata = {name: value for event in events for name, value in (event.metadata or {}).items()}
    verdicts = [*(event.verdict for event in events if event.verdict), *([last.verdict] if last.verdict else [])]
    return Report(
        checks=[*(event.check for event in events if event.check), *last.checks],
        verdict=verdicts[-1] if verdicts else None,
        findings=[*(event.finding for event in events if event.finding), *last.findings],
        metrics=[*(event.metric for event in events if event.metric), *last.metrics],
        previews=[*(event.preview for event in events if event.preview), *last.previews],
        metadata={**metadata, **last.metadata},
        mission_files=[*(event.mission_file for event in events if event.mission_file), *last.mission_files],
    )
