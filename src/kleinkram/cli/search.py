"""`klein search`"""

import enum
from typing import Annotated

import typer

from kleinkram import connect
from kleinkram.cli.file import show_found
from kleinkram.cli.filters import Choice, Many, file_filter, mission_filter, with_choice
from kleinkram.cli.mission_view import show_missions, show_topics
from kleinkram.cli.options import AsJson, Limit
from kleinkram.cli.render import show_json, show_json_list
from kleinkram.client import Client
from kleinkram.contract.files import FileSort


class Shown(str, enum.Enum):
    """What a search lists."""

    files = "files"
    missions = "missions"
    topics = "topics"


@with_choice
def search(
    choice: Choice,
    words: Annotated[
        str | None, typer.Argument(metavar="TEXT", help="Found in names, notes and metadata.", show_default=False)
    ] = None,
    show: Annotated[Shown, typer.Option("--show", help="What to list.")] = Shown.files,
    path: Annotated[Many, typer.Option("--path", metavar="GLOB", help="Path in the mission.")] = None,
    sort: Annotated[FileSort | None, typer.Option("--sort", help="Order of files; a - turns it round.")] = None,
    limit: Limit = None,
    count: Annotated[bool, typer.Option("--count", help="Only say how many.")] = False,
    as_json: AsJson = False,
) -> None:
    """Find files, missions or topics, in all projects: by text, metadata, topic, type, time, size and more."""
    if words is not None:
        choice = Choice(**{**vars(choice), "text": words})
    with connect() as client:
        if count:
            number = _count(client, choice, show, path or [])
            show_json({"total": number}) if as_json else typer.echo(str(number))
        elif show is Shown.missions:
            missions = [*client.missions.list(mission_filter(client, choice), limit=limit)]
            show_json_list(missions) if as_json else show_missions(missions)
        elif show is Shown.topics:
            topics = [*client.files.find_topics(file_filter(client, choice, path or []), limit=limit)]
            show_json_list(topics) if as_json else show_topics(topics, {})
        else:
            files = [*client.files.list(file_filter(client, choice, path or []), sort=sort, limit=limit)]
            show_json_list(files) if as_json else show_found(files)


def _count(client: Client, choice: Choice, show: Shown, paths: list[str]) -> int:
    if show is Shown.missions:
        return client.missions.count(mission_filter(client, choice))
    if show is Shown.topics:
        return sum(1 for _ in client.files.find_topics(file_filter(client, choice, paths)))
    return client.files.count(file_filter(client, choice, paths))
