"""Settings of every room: no number of a dataclass with defaults may be NaN or infinite."""

import dataclasses
import importlib
import inspect
import math
import pkgutil
from typing import Any

import pytest

import sightline

_UNLIMITED_ABOVE = {"AdaptiveConfig.softening", "Within.highest"}
"""Numbers whose infinity has a meaning."""


def settings_classes():
    """Every dataclass of the package that can be made without arguments."""
    found: dict[str, Any] = {}
    for module in pkgutil.walk_packages(sightline.__path__, "sightline."):
        if ".app" in module.name or module.name.endswith("__main__"):
            continue  # the first needs an extra, the second runs
        loaded = importlib.import_module(module.name)
        for name, kind in vars(loaded).items():
            if inspect.isclass(kind) and dataclasses.is_dataclass(kind):
                found[f"{kind.__module__}.{name}"] = kind
    return found.values()


def with_one_replaced(value, bad):
    """Yield a number replaced, or each number of a tuple in turn."""
    if isinstance(value, float):
        yield bad
    elif isinstance(value, tuple) and all(isinstance(each, float) for each in value):
        for at in range(len(value)):
            yield (*value[:at], bad, *value[at + 1 :])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_number_of_settings_may_be_nan_or_infinite(bad):
    taken, tried = [], 0
    for kind in settings_classes():
        try:
            settings = kind()
        except (TypeError, ValueError):  # it needs arguments
            continue
        for field in dataclasses.fields(kind):
            name = f"{kind.__name__}.{field.name}"
            if name in _UNLIMITED_ABOVE and bad == math.inf:
                continue
            for value in with_one_replaced(getattr(settings, field.name, None), bad):
                tried += 1
                try:
                    dataclasses.replace(settings, **{field.name: value})
                except ValueError:
                    continue
                taken.append(name)
    assert tried > 200
    assert not taken
