# SPDX-License-Identifier: Apache-2.0
"""Access to the page: only for browsers that come to one of its own addresses, and from no other web page.

Any web page that a user opens can connect to a server of this machine, and viser lets it steer. The browser sends two
headers that such a page cannot forge. `Origin` is the page that asks, and `Host` is the name by which it came here. A
foreign name that resolves to this machine (DNS rebinding) shows in `Host`.
"""

from __future__ import annotations

import contextlib
import logging
import socket
from collections.abc import Callable, Iterator, Sequence
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

_MOST_TOLD = 20  # sentences about refused visitors that go to the log; a page may come again and again
_log = logging.getLogger(__name__)


def make_server(host: str, port: int, allowed_hosts: Sequence[str] = ()) -> viser.ViserServer:
    """Return a server of viser at host and port that checks Host and Origin of every visitor. allowed_hosts: see
    `Visitors`.

    Raises RuntimeError if the version of viser does not call the check.
    """
    with _asking(Visitors(host, allowed_hosts)) as asked:
        server = viser.ViserServer(host=host, port=port, label="cloth_sim", verbose=False)
    if not asked:
        server.stop()
        raise RuntimeError(f"viser {viser.__version__} cannot be kept from foreign web pages; install viser 1.1")
    return server


class Visitors:
    """Rules for visitors.

    A visitor comes to localhost, to the address at which the server took the call, to the name of this machine, to
    `host`, or to one of `allowed_hosts`. The page that asks was loaded from here or from one of `allowed_hosts`, or
    there is none: programs other than browsers send no Origin.
    """

    def __init__(self, host: str, allowed_hosts: Sequence[str] = ()):
        self._further = {name.lower() for name in allowed_hosts if name}
        machine = socket.gethostname().lower() or "localhost"
        self._names = {"localhost", host.lower(), machine, f"{machine}.local", *self._further}
        self._told: set[str] = set()

    def refusal(self, request: Request, local_address: str) -> str | None:
        """Return why a request that came to `local_address` is refused; None if it is not."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_ours(hosts[0], local_address):
            came_to = ", ".join(hosts) or "no host"
            return f"This page is not served as {came_to}. Start the viewer with allowed_hosts for this name."
        if len(origins) > 1 or origins and not self._is_own_page(origins[0], hosts[0]):
            return f"A web page of {', '.join(origins)} may not use this one, unless allowed_hosts names it."
        return None

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a visitor who is refused; None to the others."""
        why = self.refusal(request, connection.local_address[0])
        if why is None:
            return None
        if why not in self._told and len(self._told) < _MOST_TOLD:
            self._told.add(why)
            _log.warning("cloth_sim_viewer: refused a visitor. %s", why)
        return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")

    def _is_ours(self, host: str, local_address: str) -> bool:
        name = _name_in(f"//{host}")
        if name in self._names:
            return True
        try:
            address, local = ip_address(name), ip_address(local_address)
        except ValueError:
            return False
        return address.is_loopback or address in (local, getattr(local, "ipv4_mapped", None))

    def _is_own_page(self, origin: str, host: str) -> bool:
        return origin.lower() in (f"http://{host}".lower(), f"https://{host}".lower()) or (
            _name_in(origin) in self._further
        )


@contextlib.contextmanager
def _asking(visitors: Visitors) -> Iterator[list[Callable]]:
    """Make servers that viser starts meanwhile ask `visitors` first; the yielded list fills with their checks.

    viser offers no hook for this. It calls `websockets.asyncio.server.serve` by this name, with `process_request`,
    which answers plain requests. A version of viser that calls it otherwise leaves the list empty, and then nothing is
    served.
    """
    serve, asked = websockets.asyncio.server.serve, []

    def serve_asking(*given: Any, process_request: Callable, **options: Any) -> Any:
        def process(connection: ServerConnection, request: Request) -> Response | None:
            response = visitors.answer(connection, request) or process_request(connection, request)
            if response is not None:
                response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"  # not within a foreign page
            return response

        asked.append(process)
        return serve(*given, process_request=process, **options)

    websockets.asyncio.server.serve = serve_asking
    try:
        yield asked
    finally:
        websockets.asyncio.server.serve = serve


def _name_in(address: str) -> str:
    """Return the name of the host in `scheme://host:port` or `//host:port`, "" if there is none."""
    try:
        return urlsplit(address).hostname or ""
    except ValueError:
        return ""
