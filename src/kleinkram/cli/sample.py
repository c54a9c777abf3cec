"""`klein sample`"""

from pathlib import Path
from typing import Annotated

import typer

from kleinkram.cli.errors import Interrupted
from kleinkram.cli.filters import Many
from kleinkram.cli.options import AsJson
from kleinkram.cli.render import show_json, table
from kleinkram.cli.units import parse_size, size, span
from kleinkram.client.errors import InvalidInput
from kleinkram.recordings.sample import Faults, FileTruth, SampleFormat, generate_mission


def sample(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to make it in.", show_default=False)],
    size_: Annotated[str, typer.Option("--size", metavar="SIZE", help="Of all files together.")] = "50MB",
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same bytes.")] = 1,
    formats: Annotated[Many, typer.Option("--format", help="mcap, bag, db3; several times for several.")] = None,
    drop_topic: Annotated[str | None, typer.Option("--drop-topic", help="A topic that is missing.")] = None,
    truncate: Annotated[
        float | None, typer.Option("--truncate", min=0.01, max=0.99, help="Share of each file that is left of it.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a sample mission of a small vehicle: camera, lidar, IMU, GPS, odometry and transforms."""
    size_bytes = parse_size(size_)
    faults = Faults(dropped_topic=drop_topic, truncate_to=truncate)
    try:
        kinds = [SampleFormat(name) for name in formats] if formats else [*SampleFormat]
        truth = generate_mission(directory, size_bytes=size_bytes, seed=seed, formats=kinds, faults=faults)
    except FileExistsError as error:
        raise InvalidInput(what=f"The folder {str(directory)!r}", reason=str(error)) from None
    except ValueError as error:
        raise InvalidInput(what="The sample", reason=str(error)) from None
    except OSError as error:
        raise InvalidInput(what=f"The folder {str(directory)!r}", reason=error.strerror or str(error)) from None
    except KeyboardInterrupt:
        raise Interrupted from None
    if as_json:
        show_json({"items": [_plain(file) for file in truth.files]})
        return
    table(
        ["file", "size", "messages", "topics", "span"],
        [
            (
                str(file.path),
                size(file.size_bytes),
                file.message_count,
                len(file.topics),
                span(file.start_ns, file.end_ns),
            )
            for file in truth.files
        ],
    )


def _plain(file: FileTruth) -> dict[str, object]:
    return {**vars(file), "path": str(file.path), "topics": [vars(topic) for topic in file.topics]}
