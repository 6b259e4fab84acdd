"""Actors of Ray, with a stand-in for its library."""

from types import SimpleNamespace

import pytest

from sightline.jobs import ray_crew


def fake_ray(free, whole):
    return SimpleNamespace(
        is_initialized=lambda: True,
        available_resources=lambda: free,
        cluster_resources=lambda: whole,
        put=lambda piece: piece,
        remote=lambda **_: lambda _: SimpleNamespace(remote=None),
    )


def crew(monkeypatch, free, whole):
    for name in ("RAY_USAGE_STATS_ENABLED", "RAY_AUTH_MODE"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(ray_crew, "import_library", lambda *_: fake_ray(free, whole))
    return ray_crew.RayCrew(str)


@pytest.mark.parametrize(
    ("whole", "said"), [({}, "it has 0 in all"), ({"CPU": 8.0}, "it has 8 in")]
)
def test_a_cluster_without_a_free_cpu_is_told(monkeypatch, whole, said):
    with pytest.warns(UserWarning, match=f"no CPU of the Ray cluster is free, {said}"):
        crew(monkeypatch, {"memory": 1.0}, whole)


def test_a_cluster_with_a_free_cpu_needs_no_word(monkeypatch, recwarn):
    crew(monkeypatch, {"CPU": 1.0}, {"CPU": 8.0})
    assert not recwarn.list
