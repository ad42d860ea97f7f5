"""What a file is that was given as a dictionary and is none, and what to do instead."""

import re
from typing import Final

_TO_EDS: Final = (
    "expected an EDS or DCF (CiA 306); export one from the vendor's tool, or from an editor (CANopenEditor)"
)
_ASK: Final = "ask the vendor for the EDS, which is a text file of its own"
_MAGICS: Final = {
    b"PK\x03\x04": "is a ZIP archive; unpack it and give the .eds or .dcf in it",
    b"%PDF": f"is a PDF document; {_ASK}",
    b"\xd0\xcf\x11\xe0": f"is an Office document; {_ASK}",
}
_TEXTS: Final = {  # pattern of the first element or the first letters, small
    r"<html|<!doctype html|<head|<body": "is a web page (HTML), not the file; download that (on GitHub: Raw)",
    r"<ethercat": "is an ESI: it describes an EtherCAT drive, which a scene names by `esi` on a bus of "
    "type: ethercat (see configs/ethercat.yaml); on CAN, give the EDS of the drive's CANopen version",
    r"<(?:[\w.-]+:)?iso15745|<canopenproject": f"is an XDD or XDC (CiA 311), {_TO_EDS}",
    r"<(?s:.*)<parameters?\b(?s:.*)symbolname=": f"is an EPF, {_TO_EDS}",
    r"<": f"is XML, {_TO_EDS}",
    r"[{\[]\s*[\"{\[}\]]": f"is JSON, {_TO_EDS}",
    r'version\s+"|(?s:.*\n)?bo_\s': f"is a DBC: signals, not objects; {_ASK}",
    r"version https://git-lfs": "is a pointer of Git LFS, not the file; fetch it with git lfs pull, or download it",
}
_BEFORE: Final = re.compile(r"(?:\s|<\?.*?\?>|<!--.*?-->|<!doctype(?! html)[^>\[]*(?:\[[^\]]*\])?>)*", re.DOTALL)
_LOOKED_AT: Final = 200_000  # letters


def other_kind_of_bytes(content: bytes) -> str | None:
    """Return what a binary file is and what to do; None where it may be text."""
    return next((text for magic, text in _MAGICS.items() if content.startswith(magic)), None)


def other_kind(text: str) -> str | None:
    """Return what a text without objects is and what to do; None where it may be an EDS or DCF."""
    head = text[:_LOOKED_AT].lower().lstrip("\ufeff")
    head = head[_BEFORE.match(head).end() :] or head.lstrip()  # type: ignore[union-attr]
    return next((what for pattern, what in _TEXTS.items() if re.match(pattern, head)), None)
