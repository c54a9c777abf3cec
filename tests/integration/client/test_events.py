"""Following events: after a reconnect the client requests the events it missed."""

import json

import pytest

from kleinkram.client import Client, Endpoint, EndpointSource, server
from kleinkram.contract.audit import Change, Refetch
from tests.scripted_server import scripted

NOTHING = {"id": None, "project_id": None, "mission_id": None}
CHANGE = f"event: change\ndata: {json.dumps({'resource_type': 'mission', 'change': 'changed', **NOTHING})}\n\n".encode()
REFETCH = b'event: refetch\ndata: {"reason": "missed"}\n\n'


@pytest.mark.parametrize(
    ("first", "came_back_with"),
    [
        pytest.param(b"retry: 2000\nid: era-7\n\n", "era-7", id="from where it was"),
        pytest.param(b"retry: 2000\nid: era-7\n\n" + CHANGE + b"id: era-8\n\n", "era-8", id="from the last event"),
        pytest.param(b"", "nowhere", id="cut off before it knew where it was"),
    ],
)
def test_after_a_lost_connection_missed_events_are_requested(
    monkeypatch: pytest.MonkeyPatch, first: bytes, came_back_with: str
) -> None:
    monkeypatch.setattr(server, "_PAUSE_S", 0.01)
    events: list[Change | Refetch] = []
    with scripted(first, REFETCH) as script, Client(Endpoint("x", script.url, "t", EndpointSource.argument)) as client:
        for item in client.events.follow(for_s=20):
            events.append(item)
            if isinstance(item, Refetch):
                break
    assert [type(item) for item in events] == [Change] * first.count(b"change\n") + [Refetch]
    assert "after=" not in script.requests[0].path
    assert f"after={came_back_with}&" in script.requests[1].path + "&"
