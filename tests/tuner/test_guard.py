"""Who may open the page."""

from __future__ import annotations

import asyncio

import pytest

from shape_obs.tuner.guard import Guard, is_local


def answer(token, *, kind="http", query=b"", **headers):
    """Return (status or close code, headers) of a request through the guard; 200 is the application's own answer."""
    sent = []

    async def app(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    async def receive():
        return {}

    named = [(name.encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "headers": named, "query_string": query}
    asyncio.run(Guard(app, token, 8600)(scope, receive, send))
    return sent[0].get("status", sent[0].get("code")), dict(sent[0].get("headers", ()))


def test_this_machine_needs_no_token():
    for host in ("127.0.0.1:8600", "localhost:8600", "[::1]:8600", "localhost"):
        assert answer(None, host=host)[0] == 200


def test_another_name_for_this_machine_is_refused():
    assert answer(None, host="evil.example:8600")[0] == 403
    assert answer(None)[0] == 403


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_pages_of_another_origin_are_refused(kind):
    refused = 403 if kind == "http" else 1008
    assert answer(None, kind=kind, host="localhost:8600", origin="http://evil.example")[0] == refused
    assert answer(None, kind=kind, host="localhost:8600", origin="http://localhost:8600")[0] == 200


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_a_token_is_needed_in_the_query_or_in_the_cookie(kind):
    refused, host = 403 if kind == "http" else 1008, "192.168.0.7:8600"
    assert answer("abc", kind=kind, host=host)[0] == refused
    assert answer("abc", kind=kind, host=host, query=b"token=abd")[0] == refused
    assert answer("abc", kind=kind, host=host, cookie="shape_obs_tune_8600=wrong")[0] == refused
    assert answer("abc", kind=kind, host=host, cookie="shape_obs_tune_8601=abc")[0] == refused
    assert answer("abc", kind=kind, host=host, query=b"x=1&token=abc")[0] == 200
    assert answer("abc", kind=kind, host=host, cookie="a=b; shape_obs_tune_8600=abc")[0] == 200


def test_the_first_answer_sets_the_cookie():
    status, headers = answer("abc", host="192.168.0.7:8600", query=b"token=abc")
    assert status == 200
    cookie = headers[b"set-cookie"].decode()
    assert cookie.startswith("shape_obs_tune_8600=abc; ")
    assert "HttpOnly" in cookie
    assert answer("abc", host="a", cookie=cookie.split(";")[0])[0] == 200


def test_local_hosts():
    assert is_local("127.0.0.1")
    assert is_local("127.0.1.1")
    assert is_local("::1")
    assert not is_local("0.0.0.0")
    assert not is_local("robot.local")
