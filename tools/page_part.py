"""Pages that are made from code, whole or between `<!-- NAME: begin -->` and `<!-- NAME: end -->`."""

import sys
from collections.abc import Callable
from pathlib import Path

from canhaptic.errors import InputError


def with_part(page: Path, name: str, part: str) -> str:
    """Returns the text of a page with one part of it made anew.

    Args:
        page: The file.
        name: Of the part.
        part: Its text, with a newline at its end.

    Raises:
        InputError: The page has no such part.
    """
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->\n"
    head, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, found_end, tail = rest.partition(end)
    if not found or not found_end:
        raise InputError(f"{page.name}: no part between {begin.strip()} and {end.strip()}; write both lines into it")
    return "".join([head, begin, part, end, tail])


def write_page(place: Path, page: Callable[[], str]) -> None:
    """Writes a page that is made from code; ends the process with the reason where it cannot be made."""
    try:
        place.write_text(page(), encoding="utf-8")
    except InputError as problem:
        sys.exit(str(problem))
    print(place)
