"""`klein action init`: a small action that runs as it is, with a test that passes, to be made one's own."""

import re
from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli.options import AsJson
from kleinkram.cli.render import note, show_json
from kleinkram.client.errors import InvalidInput

_HEADER = """\
# /// script
# requires-python = ">=3.10"
# dependencies = ["open-kleinkram"]
#
# [tool.kleinkram]
# name = "{name}"
# description = "Counts the messages of each topic."
# inputs = {{paths = ["*.mcap", "*.bag", "*.db3"]}}
# parameters = [{{name = "topics", type = "string", default = "*", description = "Only topics of such a name."}}]
# resources = {{memory = "1GB", time = "30m"}}
# ///
"""

_CODE = '''\
"""Counts the messages of each topic."""

from collections import Counter

from kleinkram.action import inputs, out, parameters, progress, report
from kleinkram.recordings import NotARecording, Recording


def main() -> None:
    lines = ["file,topic,messages"]
    for number, path in enumerate(inputs()):
        progress(number / len(inputs()), path.name)
        print("reading", path.name, flush=True)
        try:
            with Recording.open(path) as recording:
                counts = Counter(message.topic for message in recording.raw_messages(str(parameters()["topics"])))
        except NotARecording as error:
            report.finding("error", "file.unreadable", str(error), file=path)
            continue
        lines += [f"{path.name},{topic},{count}" for topic, count in sorted(counts.items())]
        report.metric("messages", counts.total(), file=path)
        if not counts:
            report.finding("warning", "topics.none", "has no message of such a topic", file=path)
    table = out / "topics.csv"
    table.write_text("\\n".join(lines) + "\\n")
    report.preview(table, "Messages of each topic")


if __name__ == "__main__":
    main()
'''

_TEST = '''\
"""Run me with pytest: no server is needed, and no container."""

from pathlib import Path

from kleinkram.action.testing import try_out
from kleinkram.recordings.sample import generate_mcap

MAIN = Path(__file__).with_name("main.py")


def test_messages_are_counted(tmp_path: Path) -> None:
    truth = generate_mcap(tmp_path / "drive.mcap", duration_s=1)
    (tmp_path / "run").mkdir()
    files = {"day/drive.mcap": truth.path, "notes.mcap": b"not a recording"}

    ran = try_out(MAIN, tmp_path / "run", files=files, parameters={"topics": "/imu*"})

    assert ran.exit_code == 0, ran.log
    imu = next(topic.count for topic in truth.topics if topic.name == "/imu/data")
    assert ran.metric("messages", "day/drive.mcap") == imu
    assert ran.codes() == {"file.unreadable"}
    assert f"drive.mcap,/imu/data,{imu}" in (ran.out / "topics.csv").read_text()
'''

_MANIFEST = """\
name: {name}
description: Counts the messages of each topic.
image: {image}
command: [python3, /action/main.py]
inputs:
  paths: ["*.mcap", "*.bag", "*.db3"]
parameters:
  - {{name: topics, type: string, default: "*", description: Only topics of such a name.}}
resources: {{cores: 1, memory: 1GB, disk: 1GB, time: 30m}}
network: none
"""

_DOCKERFILE = """\
# The image of script actions, with open-kleinkram; deploy/images/action-python in Kleinkram's repository makes it.
ARG BASE={base}
FROM ${{BASE}}
COPY main.py /action/main.py
CMD ["python3", "/action/main.py"]
"""

DEFAULT_IMAGE = "kleinkram/action-python:latest"


def init(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A folder to be made.", show_default=False)],
    image: Annotated[bool, typer.Option("--image", help="As an image of its own, not as a script.")] = False,
    as_json: AsJson = False,
) -> None:
    """Make a small action to begin with: its code, its manifest, and a test that passes."""
    name = _name(directory)
    files = {"main.py": _CODE, f"test_{name.replace('-', '_')}.py": _TEST}
    if image:
        files["action.yaml"] = _MANIFEST.format(name=name, image=f"{name}:1")
        files["Dockerfile"] = _DOCKERFILE.format(base=DEFAULT_IMAGE)
    else:
        files["main.py"] = _HEADER.format(name=name) + _CODE
    _write(directory, files)
    if as_json:
        show_json({"name": name, "files": [str(directory / each) for each in sorted(files)]})
    note(f"Made the action {name} in {directory}: {', '.join(sorted(files))}.")
    for step in _next_steps(directory, name, image):
        note(f"  {step}")


def _next_steps(directory: Path, name: str, image: bool) -> list[str]:
    build = [f"docker build -t {name}:1 {directory}"] if image else []
    run = f"klein action run-local {directory} -m MISSION"
    return [f"pytest {directory}", *build, run, f"klein action run {directory} -m MISSION --follow"]


def _name(directory: Path) -> str:
    name = re.sub(r"[^a-z0-9]+", "-", directory.resolve().name.lower()).strip("-")
    if not name:
        raise InvalidInput(
            what=f"The folder {str(directory)!r}", reason="gives the action no name of letters or digits"
        )
    return name[:64]


def _write(directory: Path, files: dict[str, str]) -> None:
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise InvalidInput(
            what=f"The folder {str(directory)!r}", reason="is there already; say one that is new or empty"
        )
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path, text in files.items():
            (directory / path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InvalidInput(what=f"The folder {str(directory)!r}", reason=error.strerror or str(error)) from None
