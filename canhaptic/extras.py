"""Command by which a user installs an optional dependency."""

import json
import shlex
from importlib import metadata
from typing import Any

_NAME = "canhaptic"


def install_hint(extra: str) -> str:
    """Return the pip command that installs an extra from where this package itself was installed.

    That is the address of a checkout or a repository (PEP 610), else the name of the package.

    Args:
        extra: One of the optional dependencies in pyproject.toml.
    """
    return f"pip install {_requirement(extra, _origin())}"


def _requirement(extra: str, origin: dict[str, Any]) -> str:
    url = str(origin.get("url", ""))
    if "dir_info" in origin and url.startswith("file://"):
        editable = "-e " if origin["dir_info"].get("editable") else ""
        return editable + shlex.quote(f"{url.removeprefix('file://')}[{extra}]")
    if "vcs_info" in origin:
        version_control = origin["vcs_info"]
        url = f"{version_control['vcs']}+{url}@{version_control['commit_id']}"
    return shlex.quote(f"{_NAME}[{extra}] @ {url}" if url else f"{_NAME}[{extra}]")


def _origin() -> dict[str, Any]:
    """Return the address that the installer recorded (PEP 610); empty if it recorded none."""
    try:
        text = metadata.distribution(_NAME).read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        return {}
    try:
        found = json.loads(text or "{}")
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
