"""The constraints file: every requirement pinned by version and hash, no index named, all that the tests need."""

import re
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "constraints.txt").read_text(encoding="utf-8")
PINS = {canonicalize_name(name): version for name, version in re.findall(r"(?m)^([A-Za-z0-9._-]+)==(\S+) \\$", TEXT)}


def test_every_line_is_a_pin_or_a_hash_of_one() -> None:
    for line in TEXT.splitlines():
        assert re.fullmatch(r"#.*|[A-Za-z0-9._-]+==\S+ \\|    --hash=sha256:[0-9a-f]{64}( \\)?", line), line
    assert len(PINS) > 30


def test_no_index_is_named() -> None:
    assert "://" not in TEXT
    assert "index" not in TEXT


def test_the_versions_satisfy_what_the_package_asks_for() -> None:
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for text in project["dependencies"]:
        requirement = Requirement(text)
        assert requirement.specifier.contains(PINS[canonicalize_name(requirement.name)]), text


def test_tests_and_tools_look_for_nothing_outside_the_repository() -> None:
    outside = re.compile(r"\b(ROOT|REPOSITORY)\.parent\b")
    paths = [*(ROOT / "tests").rglob("*.py"), *(ROOT / "tools").rglob("*.py")]
    assert not [path for path in paths if outside.search(path.read_text(encoding="utf-8")) and path != Path(__file__)]
