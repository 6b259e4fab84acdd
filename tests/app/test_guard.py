import pytest
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.responses import PlainTextResponse
from starlette.routing import Route
from starlette.testclient import TestClient

from sightline.app.guard import HEADERS, LOOPBACK, Guard


def client(hosts=LOOPBACK, token=None):
    async def answer(_request):
        return PlainTextResponse("ok")

    routes = [Route("/", answer), Route("/api", answer)]
    guard = Middleware(Guard, hosts=hosts, token=token)
    return TestClient(
        Starlette(routes=routes, middleware=[guard]),
        base_url="http://127.0.0.1:8000",
        follow_redirects=False,
    )


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost", "LocalHost:1", "[::1]:8000"])
def test_this_machine_s_names_are_answered(host):
    assert client().get("/api", headers={"host": host}).text == "ok"


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8000",
        "127.0.0.1.evil.example",
        "127.0.0.1:@evil.example",
        "127.0.0.1:8000.evil.example",
        "",
    ],
)
def test_other_names_are_refused_as_a_page_could_have_rebound_them(host):
    refused = client().get("/api", headers={"host": host})
    assert refused.status_code == 421
    assert refused.headers["x-content-type-options"] == "nosniff"


def test_pages_of_other_sites_get_no_data_but_may_link_to_the_page():
    headers = {"sec-fetch-site": "cross-site"}
    assert client().get("/api", headers=headers).status_code == 403
    assert client().get("/", headers=headers).status_code == 200
    assert client().get("/api", headers={"sec-fetch-site": "same-origin"}).status_code == 200


def test_nothing_can_be_sent_to_the_server():
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert client().request(method, "/api").status_code == 405


def test_long_addresses_are_refused():
    assert client().get("/api?" + "a" * 9000).status_code == 414


def test_every_answer_has_the_headers():
    for path in ("/", "/api", "/nothing"):
        answer = client().get(path)
        assert {name: answer.headers[name] for name in HEADERS} == HEADERS


def test_with_a_token_the_address_opens_the_page_and_then_a_cookie_does():
    own = client(token="secret-of-this-run")
    assert own.get("/").status_code == 403
    assert own.get("/api").status_code == 403
    assert own.get("/?token=wrong").status_code == 403
    assert own.get(f"/?{'a=1&' * 200}").status_code == 403
    opened = own.get("/?token=secret-of-this-run")
    assert (opened.status_code, opened.headers["location"]) == (303, "/")
    assert "HttpOnly" in opened.headers["set-cookie"]
    assert "samesite=strict" in opened.headers["set-cookie"].lower()
    assert own.get("/api").status_code == 200
    own.cookies.clear()
    assert own.get("/api?token=secret-of-this-run").status_code == 403


@pytest.mark.parametrize("host", ["192.168.7.9:8000", "lab.local:8000", "[fe80::1]:8000"])
def test_with_a_token_this_machine_may_be_called_by_any_of_its_names(host):
    own = client(token="secret-of-this-run")
    assert own.get("/api", headers={"host": host}).status_code == 403
    opened = own.get("/?token=secret-of-this-run", headers={"host": host})
    cookie = opened.headers["set-cookie"].partition(";")[0]
    assert own.get("/api", headers={"host": host, "cookie": cookie}).status_code == 200
