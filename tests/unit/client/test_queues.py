"""The threads of a transfer pass items on, wait, and end together."""

import threading
from collections.abc import Callable

import pytest

from kleinkram.client.transfer.pool import Budget, Stop, Stopped, WorkQueue


def in_thread(work: Callable[[], object]) -> tuple[threading.Thread, list[object]]:
    """Run something beside the test; its answer, or its `Stopped`, lands in the list."""
    answers: list[object] = []

    def run() -> None:
        try:
            answers.append(work())
        except Stopped as stopped:
            answers.append(stopped)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread, answers


def test_items_arrive_in_order_and_in_batches() -> None:
    channel: WorkQueue[int] = WorkQueue(Stop())
    for number in range(5):
        channel.put(number)
    assert channel.take(3) == [0, 1, 2]
    assert channel.take(3) == [3, 4]
    assert channel.take(3, timeout_s=0.01) == []


def test_a_waiting_thread_is_woken_by_an_item() -> None:
    channel: WorkQueue[str] = WorkQueue(Stop())
    thread, answers = in_thread(lambda: channel.take(1))
    channel.put("thing")
    thread.join(10)
    assert answers == [["thing"]]


def test_a_budget_bounds_what_is_under_way() -> None:
    budget = Budget(Stop(), 10)
    budget.acquire(8)
    thread, answers = in_thread(lambda: budget.acquire(3))
    assert answers == []
    budget.release(8)
    thread.join(10)
    assert answers == [None]
    budget.release(3)
    budget.acquire(50)  # larger than all of it: alone
    budget.release(50)
    budget.wait_until_free()


def test_waiting_for_memory_ends_when_half_of_the_budget_is_free() -> None:
    budget = Budget(Stop(), 10)
    for _ in range(10):
        budget.acquire(1)
    thread, answers = in_thread(lambda: budget.acquire(1))
    for _ in range(5):
        budget.release(1)
    assert answers == []
    budget.release(1)
    thread.join(10)
    assert answers == [None]


def test_a_stop_wakes_all_threads_and_keeps_the_first_failure() -> None:
    stop = Stop()
    channel: WorkQueue[str] = WorkQueue(stop)
    budget = Budget(stop, 1)
    budget.acquire(1)
    waiting = [
        in_thread(lambda: channel.take(1)),
        in_thread(lambda: budget.acquire(1)),
        in_thread(budget.wait_until_free),
        in_thread(lambda: stop.wait(3600)),
    ]
    first = ValueError("first")
    stop.now(first)
    stop.now(ValueError("second"))
    for thread, answers in waiting:
        thread.join(10)
        assert [type(answer) for answer in answers] == [Stopped]
    assert stop.failure is first
    with pytest.raises(Stopped):
        channel.put("late")
