"""The command `klein` as a process of its own, forked from a process that has imported all commands.

Its arguments, environment, folder, output and exit code are those of a command line. What it saves is the start of
Python and the imports: half a second of CPU time for each of the hundreds of commands that tests run.
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
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TextIO

KLEIN = Path(sys.executable).parent / "klein"
_TIMEOUT_S = 100
# Variables that Python or its loader reads before the first line of a program.
_READ_AT_START = ("PYTHON", "LD_", "LC_", "LANG")
_FORK = """
import sys
from tests.klein import become_command
become_command({channel})
from kleinkram.cli.main import main
sys.exit(main())
"""


def run_klein(
    arguments: Sequence[str], environment: Mapping[str, str], *, stdin: str = "", prefix: Sequence[str] = ()
) -> "subprocess.CompletedProcess[str]":
    """Run a command to its end, with text for its input and from its outputs; `prefix`: the beginning of its line."""
    if prefix or _read_at_start(environment) != _read_at_start(os.environ):
        command = [*prefix, str(KLEIN), *arguments]
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
        code = _fork(arguments, environment, [source.fileno(), out.fileno(), err.fileno()])
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(arguments, code, out.read(), err.read())


def _read_at_start(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(_READ_AT_START)}


def _fork(arguments: Sequence[str], environment: Mapping[str, str], files: list[int]) -> int:
    """Have a command forked, and return its exit code."""
    ours, theirs = socket.socketpair()
    with ours, ours.makefile("r") as answers:
        with theirs:
            socket.send_fds(_forking_process()[0], [b"x"], [*files, theirs.fileno()])
        ours.settimeout(_TIMEOUT_S)
        ours.sendall(json.dumps([[str(KLEIN), *arguments], {**environment}, str(Path.cwd())]).encode() + b"\n")
        pid = _number(answers)
        try:
            return _number(answers)
        except BaseException as error:  # also of the test's own timeout: no command outlives its test
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            if isinstance(error, TimeoutError):
                raise subprocess.TimeoutExpired(["klein", *arguments], _TIMEOUT_S) from None
            raise


def _number(answers: TextIO) -> int:
    line = answers.readline()
    assert line, "a process that forks commands has ended; its traceback is on stderr"
    return int(line)


@functools.cache
def _forking_process() -> "tuple[socket.socket, subprocess.Popen[bytes]]":
    """Start the process that forks commands; it ends when its socket is closed, with this process at the latest."""
    ours, theirs = socket.socketpair()
    with theirs:
        command = [sys.executable, "-c", _FORK.format(channel=theirs.fileno())]
        folder, nothing = Path(__file__).parents[1], subprocess.DEVNULL
        files = [theirs.fileno()]
        return ours, subprocess.Popen(command, cwd=folder, pass_fds=files, stdin=nothing, stdout=nothing)


def become_command(channel_fd: int) -> None:
    """Fork a process for each command, and return in that process, as the command line would begin it."""
    channel = socket.socket(fileno=channel_fd)
    sys.path.remove("")
    commands = importlib.import_module("kleinkram.cli")
    for module in pkgutil.iter_modules(commands.__path__):
        importlib.import_module(f"kleinkram.cli.{module.name}")
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
