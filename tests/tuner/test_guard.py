"""Who may open the page."""

from __future__ import annotations

import asyncio
from typing import Any

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


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_this_machine_needs_no_token_and_pages_of_another_origin_are_refused(kind):
    refused = 403 if kind == "http" else 1008
    for host in ("127.0.0.1:8600", "localhost:8600", "[::1]:8600", "localhost"):
        assert answer(None, kind=kind, host=host)[0] == 200
    others: list[Any] = [{"host": "evil.example:8600"}, {"host": "localhost:8600", "origin": "http://evil.example"}]
    for headers in [{}, *others]:
        assert answer(None, kind=kind, **headers)[0] == refused


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("given", "enters"),
    [
        ({}, False),
        ({"query": b"token=abd"}, False),
        ({"cookie": "shape_obs_tune_8600=wrong"}, False),
        ({"cookie": "shape_obs_tune_8601=abc"}, False),  # of another port
        ({"query": b"x=1&token=abc"}, True),
        ({"cookie": "a=b; shape_obs_tune_8600=abc"}, True),
    ],
)
def test_a_token_is_needed_in_the_query_or_in_the_cookie(kind, given, enters):
    refused = 403 if kind == "http" else 1008
    assert answer("abc", kind=kind, host="192.168.0.7:8600", **given)[0] == (200 if enters else refused)


def test_the_first_answer_sets_the_cookie():
    status, headers = answer("abc", host="192.168.0.7:8600", query=b"token=abc")
    cookie = headers[b"set-cookie"].decode()
    assert (status, cookie.startswith("shape_obs_tune_8600=abc; "), "HttpOnly" in cookie) == (200, True, True)


def test_local_hosts():
    hosts = ["127.0.0.1", "127.0.1.1", "::1", "0.0.0.0", "robot.local"]
    assert [is_local(host) for host in hosts] == [True, True, True, False, False]
