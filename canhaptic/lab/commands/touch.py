"""`canhaptic touch CONFIG`: a page on which the pointer moves the hand, at the same scene unprotected and protected."""

import argparse
from typing import TYPE_CHECKING, Final

from canhaptic.cli.options import scene_of
from canhaptic.cli.scope import serve_page
from canhaptic.files import scene_title
from canhaptic.lab.touch.two_sides import two_sides

if TYPE_CHECKING:
    from canhaptic.lab.touch.hand_process import TouchHand
    from canhaptic.lab.touch.touch_page import TouchPage
    from canhaptic.scene.models import Scene

_PERIOD: Final = 0.033  # [s] between two looks of a page


def execute(arguments: argparse.Namespace) -> int:
    """Serve the page until the process is interrupted; return 130 after SIGINT and 143 after SIGTERM.

    Raises:
        InputError: The scene cannot be touched, Bokeh is not installed, or the port is taken.
    """
    return serve(scene_of(arguments), arguments)


def serve(scene: "Scene", arguments: argparse.Namespace) -> int:
    """Serve the page of a loaded scene; arguments and result as of `execute`."""
    two_sides(scene, arguments.axis)
    visits = _Visits(scene, arguments)
    try:
        return serve_page(visits, arguments, f"touch {scene_title(scene.source)}")
    finally:
        visits.close()


class _Visits:
    """Assigns the simulated hand, of which there is one, to the latest visitor."""

    def __init__(self, scene: "Scene", arguments: argparse.Namespace) -> None:
        self._scene, self._arguments = scene, arguments
        self._hand: TouchHand | None = None
        self._page: TouchPage | None = None

    def __call__(self, document: object) -> None:
        """Fill the document of a visitor; the first visitor starts the drives."""
        from canhaptic.lab.touch.hand_process import TouchHand
        from canhaptic.lab.touch.touch_page import TouchPage

        if self._hand is None:
            self._hand = TouchHand(self._scene, self._arguments.axis, self._arguments.pace)
            self._hand.begin({})
        if self._page is not None:
            self._page.end("another page has taken the hand; reload this one to take it back")
        self._page = TouchPage(document, self._hand, _PERIOD)

    def close(self) -> None:
        """Stop the process of the hand."""
        if self._hand is not None:
            self._hand.close()
