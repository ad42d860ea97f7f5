"""A person in an empty folder."""

from pathlib import Path

import pytest

from tests.journeys.person import Person


@pytest.fixture
def person(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Person:
    monkeypatch.chdir(tmp_path)
    return Person(tmp_path, capsys)
