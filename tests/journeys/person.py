"""A person at a terminal: types commands in a folder of their own, and reads what they print."""

import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main

REPOSITORY = Path(__file__).resolve().parents[2]
CONFIGS, EDS = REPOSITORY / "configs", REPOSITORY / "eds"
FIT = ("elmo_gold.dcf", "kollmorgen_rgm.eds", "maxon_epos4.dcf", "zeroerr_erob.eds")
UNFIT = ("elmo_simpliq.dcf", "maxon_epos2.eds", "schunk_prl.dcf")
OURS = tuple(sorted(path.name for path in EDS.glob("*.eds")))


def dictionary(name: str, request: pytest.FixtureRequest) -> str:
    """The path of a dictionary; skips, visibly, where it is a vendor's and their folder is not named."""
    folder = request.getfixturevalue("vendor_eds") if name in (*FIT, *UNFIT) else EDS
    return str(folder / name)


class Person:
    """Runs commands in a folder; a status that is not the expected one fails the test with what was printed."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self._capsys = capsys
        self.errors = ""

    def types(self, *words: str, status: int | None = 0) -> str:
        """Runs one command, with any status for None; returns standard output and keeps what went to standard error."""
        self._capsys.readouterr()
        found = main(list(words))
        out, self.errors = self._capsys.readouterr()
        assert status in (found, None), f"{' '.join(words)}: status {found}\n{self.errors}\n{out[:2000]}"
        assert "Traceback" not in self.errors
        return out

    def runs(self, *words: str, status: int = 0) -> dict[str, Any]:
        """Runs a scene as fast as the machine allows; returns its result."""
        result: dict[str, Any] = json.loads(self.types("run", *words, "--pace", "free", "--json", status=status))
        return result

    def runs_one(self, *words: str, status: int = 0) -> dict[str, Any]:
        """The same for a scene of one port; returns the account of the port."""
        [port] = self.runs(*words, status=status)["ports"].values()
        return dict(port)


def shown(result: dict[str, Any]) -> set[str]:
    """The words that are shown of the ports with an account."""
    return {port["verdict"] for port in result["ports"].values() if "verdict" in port}
