"""The start-up probe of an unreliable store finds its capabilities or fails, and never assumes weaker ones."""

import asyncio
import threading
from contextlib import ExitStack

import pytest

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.uploads import ChecksumKind
from kleinkram.server.s3.capabilities import probe
from kleinkram.server.s3.storage import StoreCapabilities, open_storage
from kleinkram.server.settings import Settings
from tests.integration.api_server import Api
from tests.integration.fault_proxy import Lost, ProxiedRequest, Reply, Rule, standing_before
from tests.services import RunningStore

# More than a probe asks.
_QUESTIONS = 24
_TRUTH = StoreCapabilities(ChecksumKind.crc64nvme, writes_once=True)


def _probes(api: Api, store: RunningStore, rules: list[Rule]) -> list[StoreCapabilities | BaseException]:
    """Probe the store once for each rule, at the same time, each through a middleman of its own."""
    settings: Settings = api.app.state.settings

    async def one(url: str) -> StoreCapabilities:
        async with open_storage(settings.model_copy(update={"s3_internal_url": url})) as storage:
            return await probe(storage)

    async def run(urls: list[str]) -> list[StoreCapabilities | BaseException]:
        return await asyncio.gather(*map(one, urls), return_exceptions=True)

    with ExitStack() as stack:
        middlemen = [stack.enter_context(standing_before(store.endpoint)) for _ in rules]
        for middleman, rule in zip(middlemen, rules, strict=True):
            middleman.rule = rule
        return asyncio.run(run([middleman.url for middleman in middlemen]))


def _from(number: int, count: int, blink: "Reply | Lost") -> Rule:
    """Let so many questions through, and blink at the next `count`."""
    requested = 0
    lock = threading.Lock()

    def rule(_requests: ProxiedRequest) -> "Reply | Lost | None":
        nonlocal requested
        with lock:
            requested += 1
            return blink if number < requested <= number + count else None

    return rule


def test_probing_finds_the_capabilities_of_a_reliable_store(api: Api, store: RunningStore) -> None:
    assert _probes(api, store, [lambda _requests: None]) == [_TRUTH]


@pytest.mark.parametrize("blink", [Lost(), Reply(503, "SlowDown")], ids=["an answer lost", "once too busy"])
def test_one_failed_probe_changes_nothing(api: Api, store: RunningStore, blink: "Reply | Lost") -> None:
    actual = _probes(api, store, [_from(number, 1, blink) for number in range(_QUESTIONS)])
    assert actual == [_TRUTH] * _QUESTIONS


@pytest.mark.parametrize("blink", [Reply(403, "AccessDenied"), Reply(404), Reply(502)], ids=repr)
def test_an_unreachable_store_is_reported(api: Api, store: RunningStore, blink: Reply) -> None:
    actual = _probes(api, store, [_from(number, 1000, blink) for number in range(0, _QUESTIONS, 3)])
    away = [isinstance(item, StoreUnavailable) for item in actual]
    assert away == sorted(away, reverse=True), "away from some question on"
    assert away[0]
    assert {item for item in actual if not isinstance(item, BaseException)} <= {_TRUTH}
