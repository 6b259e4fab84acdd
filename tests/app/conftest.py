"""A browser and pages in it, for the tests that have an `address`; they skip without a browser."""

import pytest


@pytest.fixture(scope="module")
def browser():
    from tests.app.browsing import chromium  # skips what imports it, where there is none

    with chromium() as browser:
        yield browser


@pytest.fixture
def show(browser, address):
    from tests.app.browsing import Shown

    shown = []

    def open_page(*given, **settings):
        shown.append(Shown(browser, address, *given, **settings))
        return shown[-1]

    yield open_page
    for each in shown:
        assert each.complaints == []
        assert each.elsewhere == []
        each.context.close()
