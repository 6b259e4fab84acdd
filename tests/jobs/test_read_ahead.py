import threading

import pytest

from sightline.jobs.read_ahead import map_ahead


def test_results_are_in_order_and_only_a_few_items_are_read_ahead():
    drawn = []

    def items():
        for number in range(100):
            drawn.append(number)
            yield number

    results = map_ahead(lambda number: -number, items(), workers=1)
    assert next(results) == 0
    assert len(drawn) < 10
    assert list(results) == [-number for number in range(1, 100)]


def test_stopping_early_leaves_no_thread_and_no_item_behind():
    begun, stop = [], threading.Event()

    def work(number):
        begun.append(number)
        if number:
            stop.wait()

    before = threading.active_count()
    results = map_ahead(work, range(9), workers=1)
    next(results)
    threading.Timer(0.1, stop.set).start()
    results.close()
    assert len(begun) <= 2
    timers = [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]
    assert threading.active_count() - len(timers) == before


@pytest.mark.parametrize("workers", [-1, 0, 257, 10**9])
def test_a_number_of_threads_that_cannot_be_is_refused_before_the_first(workers):
    with pytest.raises(ValueError, match=f"workers must be at (least 1|most 256), got {workers}"):
        map_ahead(str, [], workers=workers)
