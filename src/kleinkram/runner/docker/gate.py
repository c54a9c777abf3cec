"""How the command of a container waits for its doors.

They are made in the container's own network, and the engine that makes the network starts the command at once. So where
a run has doors, it starts a shell of the image instead, which waits for a line in a pipe and then becomes the command.
Imports nothing but Python's own library, since wardens wait for it.
"""

import contextlib
import os
from pathlib import Path

PIPE = "doors"
SHELL = "/bin/sh"
INSIDE = "/kleinkram-doors"
# What it says of a command that is not there begins with this.
NAME = "kleinkram"
WAITING = (SHELL, "-c", f'read -r _ <{INSIDE}; exec "$@"', NAME)
_WAITING_TEXT = b"\0".join(word.encode() for word in WAITING)


def make(folder: Path, uid: int) -> Path:
    """Make the pipe of a run, which this user alone may read, and return where it is."""
    path = folder / PIPE
    with contextlib.suppress(FileExistsError):
        os.mkfifo(path)
    path.chmod(0o400)
    os.chown(path, uid, -1)
    return path


def open_for(folder: Path) -> None:
    """Let a run's command begin, if it waits."""
    # To read and to write, so that nobody needs to read yet. It stays open until this process ends: a pipe that nobody
    # has open forgets what was not read.
    os.write(os.open(folder / PIPE, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC), b"\n")


def is_waiting(command_line: bytes) -> bool:
    """Whether a process, by its words as the kernel tells them, is a command that waits."""
    return command_line.startswith(_WAITING_TEXT)
