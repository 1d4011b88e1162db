"""Calls of several threads wait for each other."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from lumitree.core.backend import in_turn, passed_on
from lumitree.core.executor import run_tasks
from lumitree.errors import LumitreeError

running = []


@in_turn
def alone(value):
    """Says how many calls there are at once; 0 within another call."""
    running.append(value)
    count = len(running)
    time.sleep(0.01)
    running.pop()
    return count, value


@in_turn
def nested(value):
    return alone(value)


@in_turn
def with_tasks(executor):
    with run_tasks(executor, alone, [(n,) for n in range(4)], what="numbers") as results:
        return sorted(result for _, result in results)


@in_turn
def failing():
    raise MemoryError


def test_one_thread_at_a_time():
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(nested, range(8)))
    assert found == [(1, n) for n in range(8)]


def test_tasks_in_threads_of_the_process_get_the_turn():
    """The call that waits for them holds it otherwise."""
    with ThreadPoolExecutor(2) as threads, ThreadPoolExecutor(2) as callers:
        for found in callers.map(with_tasks, [threads] * 4):
            assert found == [(1, n) for n in range(4)]


def test_an_error_ends_the_turn():
    """It is explained as by `explained`."""
    with ThreadPoolExecutor(1) as threads:
        with pytest.raises(LumitreeError, match="not enough memory"):
            threads.submit(failing).result()
        assert alone(3) == (1, 3)
        assert threads.submit(alone, 4).result(timeout=10) == (1, 4)


def test_without_a_turn_there_is_none_to_pass_on():
    with passed_on():
        assert alone(5) == (1, 5)
