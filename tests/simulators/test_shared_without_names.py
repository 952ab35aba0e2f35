"""Locks and memory without a name: as many holders as there are tokens, over processes, and the same bytes."""

import gc
import os
import time
from queue import Full

import pytest

from simgap.simulators.process import SharedBytes, Tokens, Unnamed


def test_it_is_taken_as_often_as_it_has_tokens_and_again_when_one_is_given_back():
    tokens = Tokens(2)
    assert [tokens.acquire(block=False) for _ in range(3)] == [True, True, False]
    began = time.monotonic()
    assert not tokens.acquire(timeout=0.05)
    assert time.monotonic() - began >= 0.05
    tokens.release()
    assert tokens.acquire(timeout=0.05)


def test_what_nobody_holds_any_more_is_closed():
    gc.collect()  # what other tests left in circles
    before = len(os.listdir("/proc/self/fd"))
    held = [(Tokens(1), SharedBytes(10)) for _ in range(20)]
    assert len(os.listdir("/proc/self/fd")) >= before + 60
    held.clear()
    assert len(os.listdir("/proc/self/fd")) == before


def count(lock, memory, times):
    numbers = memory.view.cast("q")
    for _ in range(times):
        with lock:
            seen = numbers[0]
            time.sleep(0)  # another process would be let in here
            numbers[0] = seen + 1


def test_two_processes_that_count_in_shared_memory_lose_nothing():
    context = Unnamed()
    lock, memory = context.Lock(), SharedBytes(8)
    others = [context.Process(target=count, args=(lock, memory, 2000)) for _ in range(2)]
    for process in others:
        process.start()
    for process in others:
        process.join(120)
        assert process.exitcode == 0
    assert memory.view.cast("q")[0] == 4000


def test_queues_between_processes_take_its_locks():
    context = Unnamed()
    queue = context.Queue(1)
    process = context.Process(target=queue.get)
    queue.put("a")
    assert queue.full()
    with pytest.raises(Full):
        queue.put("b", timeout=0.05)
    process.start()
    queue.put("b", timeout=60)
    process.join(60)
    assert process.exitcode == 0
    assert queue.get(timeout=60) == "b"
    assert not queue.full()


@pytest.mark.parametrize("held", [Tokens(1), SharedBytes(1)])
def test_they_go_to_no_other_process_than_one_that_is_being_started(held):
    with pytest.raises(RuntimeError, match="inheritance"):
        held.__getstate__()
