"""Every request that the OpenAPI document allows, or does not, gets a documented response."""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from schemathesis import Case, GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import FailureGroup
from schemathesis.core.result import Ok
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from kleinkram.contract.access import Right, Scope, TokenKind
from tests.integration import people
from tests.integration.access import world as worlds
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.openapi_check import assert_is_described

_CHECKS = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]
_MODES = (GenerationMode("positive"), GenerationMode("negative"))
# The short round calls so many operations, that of the soak all of them.
_OPERATIONS = 10
# Requests per operation in both rounds. Generating a request takes longer than answering it.
_SHORT, _SOAK = 3, 60

# Refused by the HTTP parser, before there is a request: too long or malformed.
_NOT_HTTP = "Invalid HTTP request received."
_HEAD_TOO_LARGE, _MAX_HEAD_BYTES = 431, 64 * 1024


@dataclass(frozen=True)
class ProxiedRequest:
    """The API, the headers of each principal, and ids of existing objects."""

    api: Api
    principals: Mapping[str, Mapping[str, str]]
    known: Mapping[str, str]


@pytest.fixture(scope="module")
def requested(start_api: StartApi) -> ProxiedRequest:
    api = start_api()
    items = worlds.create_objects(api, is_public=False)
    member, group = people.person(api), people.group(api)
    people.join(api, member, group, is_editor=True)
    people.grant(api, member, Right.delete, project_id=items.project)
    robot = people.token(api, member, [Scope.upload], limits=[items.project], kind=TokenKind.robot)
    runner = people.token(api, member, [Scope.run], kind=TokenKind.runner)
    secrets = {
        "member": member.token,
        "robot": robot.secret,
        "runner": runner.secret,
        "link": people.share(api, items.mission).secret,
        "admin": people.person(api, admin=True).token,
    }
    known = {
        "project_id": items.project,
        "mission_id": items.mission,
        "file_id": items.file,
        "recording_id": items.recording,
        "upload_id": worlds.create_upload(api, member.id, items.mission),
        "group_id": group,
        "person_id": items.unrelated_person,
        "token_id": people.token(api, member).id,
        "share_id": items.link,
        "grant_id": people.grant(api, group, Right.read, project_id=items.project),
        "resource_type": "mission",
        "resource_id": items.trashed_mission,
        "name": "none",
    }
    principals = {name: {"Authorization": f"Bearer {secret}"} for name, secret in secrets.items()}
    return ProxiedRequest(api, {**principals, "anonymous": {}}, known)


def _send(requested: ProxiedRequest, case: Case[Any], who: str, *, is_known: bool) -> None:
    case.headers.pop("Authorization", None)
    if is_known:
        case.path_parameters.update(
            {name: requested.known[name] for name in case.path_parameters if name in requested.known}
        )
    if case.operation.path == "/api/v1/events":
        case.query["for_s"] = "0"  # end the stream after the first events
    response = case.call(base_url=requested.api.url, headers=dict(requested.principals[who]))
    if response.text == _NOT_HTTP:
        return
    if response.status_code == _HEAD_TOO_LARGE:
        request = response.request
        head = f"{request.method} {request.path_url} HTTP/1.1\r\n" + "".join(map(str, request.headers.items()))
        assert len(head) > 0.9 * _MAX_HEAD_BYTES
        return
    case.validate_response(response, checks=_CHECKS)
    body = response.json() if response.status_code >= 400 else None
    path = case.formatted_path
    assert_is_described(case.method, path, response.status_code, body)


def _call_operations(requested: ProxiedRequest, examples: int, *, operations: int | None = None) -> list[str]:
    """Call all operations, or a sample of them, with generated requests, and return the failures."""
    described = schemathesis.openapi.from_dict(requested.api.app.openapi())
    actual = []
    for result in described.get_all_operations():
        assert isinstance(result, Ok), result
        actual.append(result.ok())
    wrong = []
    for operation in actual if operations is None else random.Random(operations).sample(actual, operations):
        allowed, forbidden = (operation.as_strategy(generation_mode=mode) for mode in _MODES)

        @seed(operation.label)
        @settings(
            max_examples=examples,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=allowed | forbidden, who=st.sampled_from(sorted(requested.principals)), is_known=st.booleans())
        def send(case: Case[Any], who: str, is_known: bool) -> None:
            _send(requested, case, who, is_known=is_known)

        try:
            send()
        except (AssertionError, FailureGroup) as error:
            causes = getattr(error, "exceptions", [error])
            wrong.append(f"{operation.label}: {' '.join(str(cause) for cause in causes)[:1500]}")
    return wrong


def test_every_operation_answers_as_described(requested: ProxiedRequest) -> None:
    wrong = _call_operations(requested, _SHORT, operations=_OPERATIONS)
    assert not wrong, "\n\n".join(wrong)


@pytest.mark.soak
def test_many_generated_requests_are_answered_as_described(requested: ProxiedRequest) -> None:
    wrong = _call_operations(requested, _SOAK)
    assert not wrong, "\n\n".join(wrong)
