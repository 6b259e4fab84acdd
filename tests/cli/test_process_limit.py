import resource
import threading

import pytest

from sightline.cli import process_limit
from sightline.cli.process_limit import warn_of_few_threads


@pytest.fixture
def few_threads(monkeypatch):
    """Let no more than five threads run."""
    start = threading.Thread.start

    def start_one_of_few(thread):
        if threading.active_count() > count:
            raise RuntimeError("can't start new thread")
        start(thread)

    count = threading.active_count() + 4
    monkeypatch.setattr(threading.Thread, "start", start_one_of_few)


def limit(monkeypatch, tmp_path, user, container):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (user, user))
    monkeypatch.setattr(process_limit, "_CONTAINER_LIMIT", tmp_path / "pids.max")
    (tmp_path / "pids.max").write_text(f"{container}\n")


@pytest.mark.usefixtures("few_threads")
@pytest.mark.parametrize(("user", "container"), [(20, "max"), (resource.RLIM_INFINITY, 20)])
def test_few_threads_of_a_low_limit_are_warned_of(monkeypatch, tmp_path, user, container):
    limit(monkeypatch, tmp_path, user, container)
    with pytest.warns(UserWarning, match=r"only 5 further threads .* raise the limit of processes"):
        warn_of_few_threads()


@pytest.mark.usefixtures("few_threads")
@pytest.mark.parametrize(("user", "container"), [(50_000, "max"), (50_000, 60_000)])
def test_a_usual_limit_is_not_tried_out(monkeypatch, tmp_path, user, container):
    limit(monkeypatch, tmp_path, user, container)
    warn_of_few_threads()


def test_a_low_limit_with_enough_threads_is_no_problem(monkeypatch, tmp_path):
    limit(monkeypatch, tmp_path, 1000, "max")
    before = threading.active_count()
    warn_of_few_threads()
    assert threading.active_count() == before
