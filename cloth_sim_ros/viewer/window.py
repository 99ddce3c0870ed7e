# SPDX-License-Identifier: Apache-2.0
"""The web page: a server, the choice of a page, and the open page."""

from __future__ import annotations

import contextlib
import io
from collections import deque
from collections.abc import Callable, Sequence
from typing import ClassVar

import viser

from cloth_sim_ros.viewer.drawing import Click, Drag, Drawing
from cloth_sim_ros.viewer.look import furnish, look_from
from cloth_sim_ros.viewer.visitors import make_server


class Page:
    """One page: its drawing and its controls. It exists while it is open, and all browsers see the same one.

    All methods run in one thread, which may differ from the server's. `advance` therefore handles the clicks, drags and
    buttons of the browsers. `status` is the last sentence of `tell`.
    """

    title: ClassVar[str] = ""
    text: ClassVar[str] = ""  # what it teaches, in Markdown
    camera: ClassVar[tuple[tuple, tuple]] = ((1.6, -2.2, 1.6), (0.0, 0.0, 0.8))  # position, what it looks at [m]

    def __init__(self, server: viser.ViserServer):
        self.server, self.gui = server, server.gui
        self._uses: deque[Drag | Click] = deque()
        self._pressed: deque[Callable[[], None]] = deque()
        self.drawing = Drawing(server, "/page", self._uses.append)
        self.folder = self.gui.add_folder(None)
        with self.folder:
            if self.text:
                self.gui.add_markdown(self.text)
            self._status = self.gui.add_markdown("")
            self.build()
        look_from(server, *self.camera)

    @property
    def status(self) -> str:
        """The sentence on the page."""
        return self._status.content

    def tell(self, sentence: str) -> None:
        """Show a sentence in place of the one before."""
        self._status.content = sentence

    def build(self) -> None:
        """Make controls and drawing."""

    def frame(self) -> None:
        """Compute and draw the next frame, 60 times a second."""

    def dragged(self, drag: Drag) -> None:
        """Handle a drag."""

    def clicked(self, click: Click) -> None:
        """Handle a click."""

    def button(self, label: str, pressed: Callable[[], None]) -> None:
        """Add a button; `pressed` runs before the next frame."""
        self.gui.add_button(label).on_click(lambda event: self._pressed.append(pressed))

    def buttons(self, labels: Sequence[str], pressed: Callable[[str], None]) -> None:
        """Add buttons side by side; `pressed` gets the label before the next frame."""
        group = self.gui.add_button_group("", tuple(labels))
        group.on_click(lambda event: self._pressed.append(lambda label=event.target.value: pressed(label)))

    def advance(self) -> None:
        """Handle pressed buttons, then drags and clicks, then draw one frame."""
        while self._pressed:
            self._pressed.popleft()()
        while self._uses:
            use = self._uses.popleft()
            (self.dragged if isinstance(use, Drag) else self.clicked)(use)
        with self.server.atomic():  # so that what belongs together is seen together
            self.frame()

    def close(self) -> None:
        """Remove everything but the controls, which are hidden: see `remove`."""
        self.drawing.clear()
        self.folder.visible = False

    def remove(self) -> None:
        """Remove the hidden controls, which must have been left alone for a while.

        A browser does all updates that it finds waiting after all removals, and complains of those that come too late.
        """
        self.folder.remove()


class Window:
    """Serves `pages` (class or other callable by title) at host and port, the first one open.

    If the port is taken, the next free one is used: see `address`. `make_server` checks visitors, with `allowed_hosts`.
    """

    def __init__(
        self,
        host: str,
        port: int,
        pages: dict[str, Callable[[viser.ViserServer], Page]],
        allowed_hosts: Sequence[str] = (),
    ):
        with quiet():
            self.server = make_server(host, port, allowed_hosts)
        self._pages = pages
        furnish(self.server)
        self._choice = self.server.gui.add_dropdown("Page", tuple(pages))
        self._waiting = self.server.gui.add_markdown("", visible=False)
        self._open = ""
        self._closed: Page | None = None  # the page before, whose controls are hidden
        self.page: Page | None = None

    @property
    def address(self) -> str:
        """Address to type into a browser, on this machine if it is served to all or to itself."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"

    def choose(self, title: str) -> None:
        """Open a page with the next frame."""
        self._choice.value = title

    def advance(self) -> None:
        """Draw one frame of the chosen page. The first one of a page may take long, as it compiles."""
        if self._choice.value != self._open:
            self._change(self._choice.value)
        self.page.advance()

    def _change(self, title: str) -> None:
        if self._closed is not None:
            self._closed.remove()
        if self.page is not None:
            self.page.close()
        self._closed = self.page
        self._waiting.content = f"*Opening {title}. The first time its kernels are compiled, which takes a while.*"
        self._waiting.visible = True
        self._open, self.page = title, self._pages[title](self.server)
        self._waiting.visible = False

    def close(self) -> None:
        """Close the page and the server."""
        if self.page is not None:
            self.page.close()
        with quiet():
            self.server.stop()


def quiet() -> contextlib.AbstractContextManager:
    """Swallow the library's output, as the viewer prints the address in one line."""
    return contextlib.redirect_stdout(io.StringIO())
