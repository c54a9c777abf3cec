"""A statement prepared for one actor and executed for another equals the statement built for that other actor."""

import ast
import re
import uuid
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import ClauseElement
from sqlalchemy.dialects.postgresql import psycopg

import kleinkram.server
from kleinkram.contract.access import Right, Scope
from kleinkram.contract.files import FileFilter, FileSort
from kleinkram.contract.missions import MissionFilter, MissionSort
from kleinkram.server.access.actor import ALL_SCOPES, STRANGER, Actor, ActorKind, Limits
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.files import queries as files
from kleinkram.server.filters.plan import (
    NO_PLAN,
    MatchedFiles,
    SearchPlan,
    SearchWord,
    prepare_statement,
    visible_ids,
)
from kleinkram.server.missions import positions
from kleinkram.server.missions import queries as missions
from kleinkram.server.pagination import PagedQuery
from kleinkram.server.search import facets, planner, service

_DIALECT = psycopg.dialect(paramstyle="format")  # type: ignore[no-untyped-call]
_MISSION = Limits(mission_ids=frozenset({uuid.UUID(int=1)}))
_PROJECT = Limits(project_ids=frozenset({uuid.UUID(int=2)}))
_FILES = Limits(mission_ids=frozenset({uuid.UUID(int=1)}), file_ids=frozenset({uuid.UUID(int=3)}))
_READ = frozenset({Scope.read})
_KINDS: Mapping[str, Actor] = {
    "admin": Actor(None, "", None, None, is_admin=True),
    "member": Actor(None, "", None, None),
    "read-only token": Actor(None, "", None, None, scopes=_READ),
    "token for uploads": Actor(None, "", None, None, scopes=frozenset({Scope.upload})),
    "token limited to a project": Actor(None, "", None, None, limits=_PROJECT),
    "run": Actor(None, "", None, None, scopes=ALL_SCOPES, limits=_MISSION, max_right=Right.write),
    "run of an admin": Actor(None, "", None, None, is_admin=True, limits=_MISSION, max_right=Right.write),
    "runner": Actor(None, "", None, None, ActorKind.runner),
    "link to a mission": Actor(None, "", None, None, ActorKind.share, scopes=_READ, limits=_MISSION),
    "link to files": Actor(None, "", None, None, ActorKind.share, scopes=_READ, limits=_FILES),
    "guest": STRANGER,
}
_WITHOUT_PERSON = {"link to a mission", "link to files", "guest"}


def actors_of(kind: str) -> tuple[Actor, Actor]:
    """Return two actors of a kind that differ in everything that is not a right."""
    first, second = (
        _KINDS[kind],
        replace(
            _KINDS[kind],
            name="second",
            token_id=uuid.uuid4(),
            request_id="request",
            session_id=uuid.uuid4(),
            share_id=uuid.uuid4(),
            address="192.0.2.1",
            run_id=uuid.uuid4(),
            runner_id=uuid.uuid4(),
            sign_in_age_s=1.0,
            operation="search",
        ),
    )
    if kind in _WITHOUT_PERSON:
        return first, second
    return replace(first, person_id=uuid.uuid4()), replace(second, person_id=uuid.uuid4())


def _arrays() -> tuple[str, str, str]:
    return f"{{{uuid.uuid4()}}}", f"{{{uuid.uuid4()}}}", f"{{{uuid.uuid4()}}}"


def plans(*words: str) -> Iterator[SearchPlan]:
    """Yield plans of every shape; two calls differ in all ids and names."""
    unknown = {word: SearchWord(word, at) for at, word in enumerate(words)}
    known = {
        word: SearchWord(word, at, [uuid.uuid4()], [f"/{word}"], [] if at else [f"msg/{word}"], at)
        for at, word in enumerate(words)
    }
    mission_ids = f"{{{uuid.uuid4()},{uuid.uuid4()}}}"
    yield SearchPlan(unknown)
    yield SearchPlan(known)
    yield SearchPlan(known, is_common=True)
    yield SearchPlan(known, is_common=True, has_time=False)
    yield SearchPlan(known, has_time=True)
    yield SearchPlan(known, mission_ids=mission_ids)
    yield SearchPlan(known, matched=MatchedFiles(1, *_arrays(), [uuid.uuid4()]))
    if words:
        yield SearchPlan(known, leading_word=words[-1])


def file_filters(*words: str) -> Iterator[FileFilter]:
    """Yield filters of several shapes; two calls with other words differ in all words and ids."""
    text = " ".join(words)
    yield FileFilter(
        text=text, project_id=uuid.uuid4(), where=["robot=spot", "mass>20"], without=["label:old", "drive"]
    )
    yield FileFilter(
        text=text,
        mission_id=uuid.uuid4(),
        recording_id=uuid.uuid4(),
        topic=["/imu*"],
        message_type=["Imu"],
        label=["night"],
        path=["*.bag"],
        month=["2024-05"],
        projects=["alps", "f*"],
    )


@dataclass(frozen=True)
class Shape:
    """A builder with options, and the number and kind of its filters."""

    build: Callable[..., Any]
    filters: Callable[..., Iterator[tuple[Any, ...]]]
    options: Mapping[str, Hashable] = field(default_factory=dict)
    with_plans: bool = True


def _no_filter(*_: str) -> Iterator[tuple[Any, ...]]:
    yield ()


def _one_file_filter(*words: str) -> Iterator[tuple[Any, ...]]:
    for matching in file_filters(*words):
        yield (matching,)


def _mission_filters(*words: str) -> Iterator[tuple[Any, ...]]:
    yield (MissionFilter(text=" ".join(words), project_id=uuid.uuid4()),)
    yield (MissionFilter(topic=["/imu"], completed=True),)
    for (matching,) in _one_file_filter(*words):
        yield MissionFilter(), matching


def _two_file_filters(*words: str) -> Iterator[tuple[Any, ...]]:
    for (matching,) in _one_file_filter(*words):
        yield matching, matching.model_copy(update={"label": []})


def _project_filter(*_: str) -> Iterator[tuple[Any, ...]]:
    yield (MissionFilter(),)
    yield (MissionFilter(project_id=uuid.uuid4()),)


_SHAPES = (
    Shape(files.file_listing, _one_file_filter, {"sort": FileSort.start_desc}),
    Shape(files.count_all, _no_filter, with_plans=False),
    Shape(files.first_missions, _project_filter, {"is_first": False, "descending": True, "limit": 4}, with_plans=False),
    *(Shape(missions.mission_listing, _mission_filters, {"sort": sort}) for sort in (MissionSort.start, "meta.robot")),
    Shape(positions._latest_positions, _mission_filters),
    Shape(visible_ids, _no_filter, {"limit": 33}, with_plans=False),
    Shape(planner._sampled, _two_file_filters),
    Shape(planner._one_match, _one_file_filter),
    Shape(planner._matched, _one_file_filter, {"sort": FileSort.start_desc, "limit": 21}),
    Shape(planner._sampled_missions, _one_file_filter, {"size": 100}),
    *(Shape(service.topics_found, _one_file_filter, {"by_blobs": by_blobs, "limit": 20}) for by_blobs in (True, False)),
    Shape(facets.facet_rows, _one_file_filter, {"max_files": 200, "common": (False,) * 9}),
)


def compiled(built: Any, values: Mapping[str, object]) -> list[tuple[str, list[object]]]:
    """Return SQL text and bound values of the statements of a builder."""
    statements: list[ClauseElement] = [built]
    if isinstance(built, PagedQuery):
        statements = [built.page(10, is_first=False), built.count]
    result = []
    for statement in statements:
        one: Any = statement.compile(dialect=_DIALECT)
        bound = one.construct_params(values, _check=False)
        # Names of lists are numbered by the order of all names.
        sql = re.sub(r"POSTCOMPILE_\w+", "POSTCOMPILE", str(one))
        result.append((sql, [bound[name] for name in one.positiontup]))
    return result


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("shape", _SHAPES, ids=lambda shape: shape.build.__name__)
def test_a_statement_prepared_for_another_actor_equals_the_one_built_directly(shape: Shape, kind: str) -> None:
    first, second = actors_of(kind)
    pairs = [*zip(shape.filters("alpha", "beta"), shape.filters("gamma", "delta"), strict=True)]
    if not sees_whole_missions(first):
        pairs = [pair for pair in pairs if not any(getattr(matching, "where", []) for matching in pair[0])]
    # Each kind of actor is tried with other plans of a filter.
    turn = [*_KINDS].index(kind)
    for at, (first_filters, filters) in enumerate(pairs):
        has_words = any(matching.text for matching in filters)
        first_plans, second_plans = plans("alpha", "beta"), plans("gamma", "delta")
        if not has_words:
            first_plans, second_plans = plans(), plans()
        tried = [*zip(first_plans, second_plans, strict=True)] if shape.with_plans else [(NO_PLAN, NO_PLAN)]
        first_plan, plan = tried[(at + turn) % len(tried)]
        prepared, _ = prepare_statement(shape.build, first, *first_filters, plan=first_plan, **shape.options)
        reused, values = prepare_statement(shape.build, second, *filters, plan=plan, **shape.options)
        assert reused is prepared
        direct = shape.build(second, *filters, plan=plan, **shape.options)
        assert compiled(reused, values) == compiled(direct, values)
    assert pairs


def test_every_prepared_statement_is_compared() -> None:
    server = Path(kleinkram.server.__file__).parent
    calls = [
        node.args[0]
        for path in server.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "prepare_statement"
    ]
    names = {builder.attr if isinstance(builder, ast.Attribute) else ast.unparse(builder) for builder in calls}
    assert names == {shape.build.__name__ for shape in _SHAPES}
