"""Completion of names in the shell: quick, and silent where no server answers. Nothing but stdout may be written."""

import logging
from collections.abc import Callable, Iterator

import typer

_WAIT_S = 1.0
_MOST = 100


def complete_project(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the projects whose names begin so."""
    return _quietly(lambda: _names("/projects", incomplete, None))


def complete_mission(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the missions whose names begin so, in the project that was named."""
    project = ctx.params.get("project")
    return _quietly(lambda: _names("/missions", incomplete, project))


def complete_endpoint(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the saved endpoints whose names begin so."""

    def saved() -> Iterator[str]:
        from kleinkram.client.config import load_endpoints

        yield from (name for name in load_endpoints().endpoints if name.startswith(incomplete))

    return _quietly(saved)


def _names(path: str, incomplete: str, project: object) -> Iterator[str]:
    from kleinkram.client._http import Api
    from kleinkram.client._nouns import pages
    from kleinkram.client.config import find_endpoint
    from kleinkram.contract.missions import MissionRead
    from kleinkram.contract.projects import ProjectRead

    api = Api(find_endpoint(), read_timeout_s=_WAIT_S, is_patient=False)
    begins = [("name", f"{incomplete}*")]
    if path == "/projects":
        yield from (row.name for row in pages(api, path, ProjectRead, begins, limit=_MOST))
        return
    within = [project] if isinstance(project, str) else [*project] if isinstance(project, list | tuple) else []
    begins += [("projects", str(ref)) for ref in within]
    yield from dict.fromkeys(row.name for row in pages(api, path, MissionRead, begins, limit=_MOST))


def _quietly(names: Callable[[], Iterator[str]]) -> list[str]:
    """Return names; none where anything is wrong: the shell is no place to say so."""
    logging.disable()
    try:
        return [*names()]
    except Exception:
        return []
    finally:
        logging.disable(logging.NOTSET)
