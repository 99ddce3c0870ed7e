# SPDX-License-Identifier: Apache-2.0
"""The web page: a server, the choice of a page, and the page that is open."""

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
    """One page: what it draws and its controls. It exists while it is open, and all browsers see the same one.

    All methods run in one thread, which may be another one than the server's: what a browser does is looked at in
    `advance`. Drags and clicks come there, too.
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
            self.build()
        look_from(server, *self.camera)

    def build(self) -> None:
        """Makes controls and drawing."""

    def frame(self) -> None:
        """Computes and draws what comes next, 60 times a second."""

    def dragged(self, drag: Drag) -> None:
        """Somebody drags something."""

    def clicked(self, click: Click) -> None:
        """Somebody clicks on something."""

    def button(self, label: str, pressed: Callable[[], None]) -> None:
        """A button; `pressed` runs before the next frame."""
        self.gui.add_button(label).on_click(lambda event: self._pressed.append(pressed))

    def buttons(self, labels: Sequence[str], pressed: Callable[[str], None]) -> None:
        """Buttons side by side; `pressed` is given the label before the next frame."""
        group = self.gui.add_button_group("", tuple(labels))
        group.on_click(lambda event: self._pressed.append(lambda label=event.target.value: pressed(label)))

    def advance(self) -> None:
        """What was pressed and dragged, then one frame."""
        while self._pressed:
            self._pressed.popleft()()
        while self._uses:
            use = self._uses.popleft()
            (self.dragged if isinstance(use, Drag) else self.clicked)(use)
        with self.server.atomic():  # so that what belongs together is seen together
            self.frame()

    def close(self) -> None:
        """Takes everything away, but for the hidden controls: see `remove`."""
        self.drawing.clear()
        self.folder.visible = False

    def remove(self) -> None:
        """Takes the hidden controls away, which must have been left alone for a while.

        A browser does all updates that it finds waiting after all removals, and complains of those that come too late.
        """
        self.folder.remove()


class Window:
    """Serves `pages` (class or other callable by title) at host and port; the first one is open at the beginning.

    Where the port is taken, the next free one is used: see `address`. `make_server` says who may come, as one of
    `allowed_hosts`.
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
        """What to type into a browser, on this machine where all or its own addresses are served."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"

    def choose(self, title: str) -> None:
        """Opens a page with the next frame."""
        self._choice.value = title

    def advance(self) -> None:
        """One frame of the page that is chosen. The first one of a page may take long, as it compiles."""
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
        """Ends the page and the server."""
        if self.page is not None:
            self.page.close()
        with quiet():
            self.server.stop()


def quiet() -> contextlib.AbstractContextManager:
    """Swallows what the library prints: we tell the address in one line."""
    return contextlib.redirect_stdout(io.StringIO())
