# SPDX-License-Identifier: Apache-2.0
"""Browsers come to the page at its own addresses and from no foreign web page, at the real server."""

import http.client
import socket

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cloth_sim_ros.viewer import visitors
from cloth_sim_ros.viewer.window import Page, Window

MACHINE = socket.gethostname()


@pytest.fixture(scope="module")
def window():
    """A window of one empty page, which may be reached as robot.example too."""
    found = Window("127.0.0.1", 18120, {"empty": Page}, ["robot.example"])
    yield found
    found.close()


def knock(window: Window, host: str, origin: str | None) -> str:
    """ "in", or the sentence with which the websocket refuses."""
    port = window.server.get_port()
    headers = {} if origin is None else {"Origin": origin.format(port=port)}
    with socket.create_connection(("127.0.0.1", port)) as way:
        try:
            address = f"ws://{host.format(port=port)}"
            socket_of = connect(
                address, sock=way, additional_headers=headers, subprotocols=[f"viser-v{viser.__version__}"],
                max_size=None, open_timeout=20.0,
            )  # fmt: skip
        except InvalidStatus as refused:
            assert refused.response.status_code == 403
            return refused.response.body.decode()
        with socket_of:
            assert isinstance(socket_of.recv(timeout=20.0), bytes)
        return "in"


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("localhost:{port}", "http://localhost:{port}"),
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}"),
        ("[::1]:{port}", "http://[::1]:{port}"),
        ("localhost:9000", "http://localhost:9000"),  # another port leads here, as by ssh -L
        (f"{MACHINE}:{{port}}", f"http://{MACHINE}:{{port}}"),
        ("robot.example", "https://robot.example"),
        ("localhost:{port}", "https://robot.example"),  # a proxy that names another host to us than to the browser
        ("localhost:{port}", None),  # no browser
    ],
)
def test_visitors_of_the_page_itself_come_in(window, host, origin):
    assert knock(window, host, origin) == "in"


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("localhost:{port}", "http://evil.example"),
        ("localhost:{port}", "http://evil.example:{port}"),
        ("localhost:{port}", "http://localhost.evil.example:{port}"),
        ("localhost:{port}", "http://evil.example/localhost:{port}"),
        ("localhost:{port}", "http://localhost:3000"),  # another server of this machine
        ("localhost:{port}", "null"),  # a file, or a frame in a sandbox
        ("localhost:{port}", "http://[evil"),
    ],
)
def test_foreign_web_pages_are_refused(window, host, origin):
    named = origin.format(port=window.server.get_port())
    assert f"A web page of {named} may not use this one" in knock(window, host, origin)


@pytest.mark.parametrize("host", ["evil.example:{port}", "192.0.2.7:{port}", "localhost.evil.example:{port}"])
def test_names_that_are_not_the_pages_own_are_refused(window, host):
    """As a name of DNS rebinding: the browser takes page and server for the same."""
    answer = knock(window, host, f"http://{host}")
    assert answer.startswith(f"This page is not served as {host.format(port=window.server.get_port())}.")


@pytest.mark.parametrize(("host", "status"), [("localhost", 200), ("evil.example", 403)])
def test_the_document_is_for_the_same_visitors_and_for_no_frame(window, host, status):
    asked = http.client.HTTPConnection("127.0.0.1", window.server.get_port(), timeout=20.0)
    asked.request("GET", "/", headers={"Host": host})
    answer = asked.getresponse()
    assert answer.status == status
    assert (b"viser" in answer.read().lower()) == (status == 200)
    assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"


def test_a_refused_visitor_is_told_in_the_log_once(window, caplog):
    for _ in range(3):
        knock(window, "localhost:{port}", "http://once.example")
    assert sum("http://once.example" in each.message for each in caplog.records) == 1


def test_a_server_that_does_not_ask_is_not_served(monkeypatch):
    class Deaf(viser.ViserServer):
        """As a version of viser that calls websockets in another way."""

        def __init__(self, **given):
            import websockets.asyncio.server as server

            serve_asking, server.serve = server.serve, SERVE
            try:
                super().__init__(**given)
            finally:
                server.serve = serve_asking

    monkeypatch.setattr(visitors.viser, "ViserServer", Deaf)
    with pytest.raises(RuntimeError, match="cannot be kept from foreign web pages"):
        visitors.make_server("127.0.0.1", 18130)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", 18130), timeout=5.0)


SERVE = visitors.websockets.asyncio.server.serve
