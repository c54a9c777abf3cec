"""`klein`, `python -m kleinkram.server` and scripts as processes of their own, forked from one with all they import.

Their arguments, environment, folder, output and exit code are those of a command line. What this saves is the start of
Python and the imports: half a second of CPU time, or two for the server, for each of the hundreds of commands that
tests run.
"""

import contextlib
import functools
import gc
import importlib
import json
import os
import pkgutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TextIO

KLEIN = Path(sys.executable).parent / "klein"
_TIMEOUT_S = 100
# Variables that Python or its loader reads before the first line of a program.
_READ_AT_START = ("PYTHON", "LD_", "LC_", "LANG")
_FORK = """
import sys
from tests.klein import become_command
become_command({channel}, {modules})
from {module} import main
sys.exit(main())
"""

_ASK = """#!{python} -IS
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as asking:
    asking.connect("{socket}")
    socket.send_fds(asking, [b"x"], [0, 1, 2])
    asking.sendall(json.dumps([sys.argv, {{**os.environ}}, os.getcwd()]).encode() + b"\\n")
    _, code = asking.makefile("r")
sys.exit(int(code))
"""


class _Program(NamedTuple):
    """How a command line begins; the module with its `main`, and those that its commands import when they run."""

    command: tuple[str, ...]
    module: str
    imports: tuple[str, ...]


_KLEIN = _Program((str(KLEIN),), "kleinkram.cli.main", ("kleinkram.cli.*",))
_SERVER = _Program(
    (sys.executable, "-m", "kleinkram.server"),
    "kleinkram.server.__main__",
    ("kleinkram.server.health.checks", "kleinkram.server.migrations.migrate", "kleinkram.server.s3.bucket"),
)
_BACKUP = _Program((sys.executable, "-m", "kleinkram.server.backup"), "kleinkram.server.backup.__main__", ())
# But `kleinkram.action`, which reads its environment when it is imported.
_SCRIPT = _Program(
    (sys.executable,),
    "tests.script",
    (
        "numpy",
        "kleinkram.checks.local",
        "kleinkram.checks.results",
        "kleinkram.library.pictures",
        "kleinkram.recordings.trajectories",
        "kleinkram.recordings.writing.conversion",
    ),
)


def run_klein(
    arguments: Sequence[str], environment: Mapping[str, str], *, stdin: str = "", prefix: Sequence[str] = ()
) -> "subprocess.CompletedProcess[str]":
    """Run a command to its end, with text for its input and from its outputs; `prefix`: the beginning of its line."""
    return _run(_KLEIN, arguments, environment, stdin=stdin, prefix=prefix)


@contextlib.contextmanager
def klein_for_shells() -> Iterator[Path]:
    """Yield a folder for the front of PATH: its `klein` has commands of scripts forked, too."""
    channel, _ = _forking_process(_KLEIN)
    with tempfile.TemporaryDirectory() as name, socket.socket(socket.AF_UNIX) as listener:
        folder = Path(name)
        listener.bind(f"{folder}/socket")
        listener.listen()
        (folder / "klein").write_text(_ASK.format(python=sys.executable, socket=folder / "socket"))
        (folder / "klein").chmod(0o755)
        thread = threading.Thread(target=_pass_on, args=(listener, channel))
        thread.start()
        try:
            yield folder
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()


def _pass_on(listener: socket.socket, channel: socket.socket) -> None:
    """Pass the files of those who ask to the process that forks, which answers them; until the listener is shut."""
    while True:
        try:
            asking, _ = listener.accept()
        except OSError:
            return
        with asking:
            _, files, _, _ = socket.recv_fds(asking, 1, 3)
            socket.send_fds(channel, [b"x"], [*files, asking.fileno()])
            for file in files:
                os.close(file)


def run_server(arguments: Sequence[str], environment: Mapping[str, str]) -> "subprocess.CompletedProcess[str]":
    """Run a command of the server, such as `check`, to its end."""
    return _run(_SERVER, arguments, environment)


def run_backup(request: Mapping[str, object], environment: Mapping[str, str]) -> "subprocess.CompletedProcess[str]":
    """Run a command on backups, which `klein backup` and `klein restore` become, to its end."""
    return _run(_BACKUP, [json.dumps(request)], environment)


def run_script(
    script: Path, environment: Mapping[str, str], folder: Path, timeout_s: float
) -> "subprocess.CompletedProcess[str]":
    """Run a Python script to its end in a folder, with errors among its output."""
    command = [sys.executable, str(script)]
    with tempfile.TemporaryFile("w+") as out:
        ignored = {"PYTHONPATH": ""}  # a forked script adds it
        if {**_read_at_start(environment), **ignored} != {**_OURS_AT_START, **ignored}:
            done = subprocess.run(
                command, check=False, env=environment, cwd=folder, stdout=out, stderr=out, timeout=timeout_s
            )
            code = done.returncode
        else:
            with Path(os.devnull).open() as nothing:
                files = [nothing.fileno(), out.fileno(), out.fileno()]
                code = _fork(_SCRIPT, command[1:], environment, files, folder, timeout_s)
        out.seek(0)
        return subprocess.CompletedProcess(command, code, out.read())


def _run(
    program: _Program,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    *,
    stdin: str = "",
    prefix: Sequence[str] = (),
) -> "subprocess.CompletedProcess[str]":
    if prefix or _read_at_start(environment) != _OURS_AT_START:
        command = [*prefix, *program.command, *arguments]
        return subprocess.run(
            command, check=False, env=environment, input=stdin, capture_output=True, text=True, timeout=_TIMEOUT_S
        )
    with (
        tempfile.TemporaryFile("w+") as source,
        tempfile.TemporaryFile("w+") as out,
        tempfile.TemporaryFile("w+") as err,
    ):
        source.write(stdin)
        source.seek(0)
        code = _fork(program, arguments, environment, [source.fileno(), out.fileno(), err.fileno()])
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(arguments, code, out.read(), err.read())


def _read_at_start(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(_READ_AT_START)}


_OURS_AT_START = _read_at_start(os.environ)


def _fork(
    program: _Program,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    files: list[int],
    folder: Path | None = None,
    timeout_s: float = _TIMEOUT_S,
) -> int:
    """Have a command forked, by default in the current folder, and return its exit code."""
    ours, theirs = socket.socketpair()
    with ours, ours.makefile("r") as answers:
        with theirs:
            socket.send_fds(_forking_process(program)[0], [b"x"], [*files, theirs.fileno()])
        ours.settimeout(timeout_s)
        request = [[program.command[0], *arguments], {**environment}, str(folder or Path.cwd())]
        ours.sendall(json.dumps(request).encode() + b"\n")
        pid = _number(answers)
        try:
            return _number(answers)
        except BaseException as error:  # also of the test's own timeout: no command outlives its test
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            if isinstance(error, TimeoutError):
                raise subprocess.TimeoutExpired([*program.command, *arguments], timeout_s) from None
            raise


def _number(answers: TextIO) -> int:
    line = answers.readline()
    assert line, "a process that forks commands has ended; its traceback is on stderr"
    return int(line)


@functools.cache
def _forking_process(program: _Program) -> "tuple[socket.socket, subprocess.Popen[bytes]]":
    """Start the process that forks commands; it ends when its socket is closed, with this process at the latest."""
    ours, theirs = socket.socketpair()
    with theirs:
        source = _FORK.format(
            channel=theirs.fileno(), modules=(program.module, *program.imports), module=program.module
        )
        command = [sys.executable, "-c", source]
        # Whatever a test has set meanwhile.
        others = {name: value for name, value in os.environ.items() if not name.startswith(_READ_AT_START)}
        environment, folder, nothing = {**others, **_OURS_AT_START}, Path(__file__).parents[1], subprocess.DEVNULL
        files = [theirs.fileno()]
        return ours, subprocess.Popen(
            command, cwd=folder, env=environment, pass_fds=files, stdin=nothing, stdout=nothing
        )


def become_command(channel_fd: int, modules: Sequence[str]) -> None:
    """Import modules; fork a process for each command, and return in it, as the command line would begin it."""
    channel = socket.socket(fileno=channel_fd)
    sys.path.remove("")
    _open_standard_files()
    for name in modules:
        module = importlib.import_module(name.removesuffix(".*"))
        if name.endswith(".*"):
            for part in pkgutil.iter_modules(module.__path__):
                importlib.import_module(f"{module.__name__}.{part.name}")
    gc.collect()
    gc.freeze()  # or each command would copy the memory of all objects
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the processes between this one and the commands
    while True:
        message, files, _, _ = socket.recv_fds(channel, 1, 4)
        if not message:
            os._exit(0)
        if os.fork() == 0:
            channel.close()
            _become_next(files)
            return
        for file in files:
            os.close(file)


def _open_standard_files() -> None:
    """Open stdout and stderr anew, as pipes: in files, Python would seek, and so later in the pipes of a command."""
    read_end, write_end = os.pipe()
    for name, number, buffering in (("stdout", 1, -1), ("stderr", 2, 1)):
        file = getattr(sys, name)
        before = os.dup(number)
        os.dup2(write_end, number)
        setattr(sys, name, os.fdopen(number, "w", buffering, file.encoding, file.errors, closefd=False))
        os.dup2(before, number)
        os.close(before)
    os.close(read_end)
    os.close(write_end)


def _become_next(files: list[int]) -> None:
    """Fork once more: the parent reports the pid and exit code of the command."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    with socket.socket(fileno=files.pop()) as status:
        with status.makefile("r") as request:
            sys.argv, environment, folder = json.loads(request.readline())
        if (pid := os.fork()) != 0:
            status.sendall(f"{pid}\n".encode())
            code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            status.sendall(f"{code}\n".encode())
            os._exit(0)
    for standard, file in enumerate(files):
        os.dup2(file, standard)
        os.close(file)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    time.tzset()
