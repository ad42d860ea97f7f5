"""What a release needs: metadata that agree, and files that their own schemas accept."""

import argparse
import importlib.util
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from canhaptic.cli.options import add_arguments

_METADATA = tomllib.loads(Path("pyproject.toml").read_text())
_PROJECT = _METADATA["project"]
_SCHEMAS = {
    "github-workflows": sorted(Path(".github/workflows").glob("*.yml")),
    "github-issue-forms": sorted(
        set(Path(".github/ISSUE_TEMPLATE").glob("*.yml")) - {Path(".github/ISSUE_TEMPLATE/config.yml")}
    ),
    "github-issue-config": [Path(".github/ISSUE_TEMPLATE/config.yml")],
    "citation-file-format": [Path("CITATION.cff")],
}


def test_the_citation_names_the_version_and_the_licence_of_the_package() -> None:
    """One of them is easily forgotten."""
    citation = yaml.safe_load(Path("CITATION.cff").read_text())
    assert citation["version"] == _PROJECT["version"]
    assert citation["license"] == _PROJECT["license"]
    assert citation["authors"] == _PROJECT["authors"]


def test_the_wheel_takes_every_folder_of_scenes_and_dictionaries_along() -> None:
    """A folder that is not named is left out without a word."""
    files = [file for folder in ("configs", "eds") for file in Path(folder).rglob("*")]
    kinds = {
        (file.parent.as_posix(), file.suffix) for file in files if file.suffix in (".yaml", ".csv", ".eds", ".xml")
    }
    expected: dict[str, list[str]] = {}
    for folder, suffix in sorted(kinds):
        expected.setdefault(f"share/canhaptic/{folder}", []).append(f"{folder}/*{suffix}")
    named = _METADATA["tool"]["setuptools"]["data-files"]
    assert {folder: sorted(files) for folder, files in named.items()} == expected


def test_the_workflow_tests_every_python_of_the_metadata() -> None:
    """And calls the command that everybody calls."""
    linux = yaml.safe_load(Path(".github/workflows/test.yml").read_text())["jobs"]["linux"]
    named = {line.rsplit(" ", 1)[1] for line in _PROJECT["classifiers"] if "Python :: 3." in line}
    assert set(linux["strategy"]["matrix"]["python"]) == named
    assert any(step.get("run", "").startswith("make test") for step in linux["steps"])


def test_every_action_is_pinned_by_commit_and_what_is_installed_by_version() -> None:
    for file in _SCHEMAS["github-workflows"]:
        text = file.read_text()
        used = re.findall(r"uses: (.*)", text)
        assert used
        assert [of for of in used if not re.fullmatch(r"\S+@[0-9a-f]{40} # v\d+\.\d+\.\d+", of)] == []
        assert "PINNED=" in text


def test_the_commands_of_the_workflows_have_options_that_exist() -> None:
    """They have never run, so that nothing else would notice."""
    jobs = [job for file in _SCHEMAS["github-workflows"] for job in yaml.safe_load(file.read_text())["jobs"].values()]
    lines = [line for job in jobs for step in job["steps"] for line in step.get("run", "").splitlines()]
    found = [shlex.split(line.rstrip("& ")) for line in lines if re.match(r"(\S*/)?canhaptic ", line)]
    assert len(found) > 6
    for _, command, *words in found:
        parser = argparse.ArgumentParser()
        add_arguments(command, parser)
        parser.parse_args(words)


def test_every_hook_before_a_commit_is_a_command_of_make_test() -> None:
    """A commit that the hooks let through does not fail there in the same command."""
    recipe = Path("Makefile").read_text().split("\ntest:")[1].split("\n\n")[0].replace("$(BIN)", ".venv/bin")
    (group,) = yaml.safe_load(Path(".pre-commit-config.yaml").read_text())["repos"]
    sources = re.search(r"(?m)^SOURCES := (.*)$", Path("Makefile").read_text())
    assert sources is not None
    for hook in group["hooks"]:
        assert hook["entry"] in recipe, hook["id"]
        if hook.get("pass_filenames", True):
            assert hook["files"] == f"^({'|'.join(sources[1].split())})/", hook["id"]


@pytest.mark.slow
@pytest.mark.parametrize("schema", _SCHEMAS)
def test_files_of_the_host_keep_their_schema(schema: str) -> None:
    """By the schemas that come with check-jsonschema; nothing is fetched."""
    pytest.importorskip("check_jsonschema", reason="needs the extra `release`")
    assert _SCHEMAS[schema]
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    done = subprocess.run([*command, *map(str, _SCHEMAS[schema])], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_the_hooks_are_valid() -> None:
    """By pre-commit itself."""
    pytest.importorskip("pre_commit", reason="needs the extra `release`")
    command = [sys.executable, "-m", "pre_commit", "validate-config", ".pre-commit-config.yaml"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_tool_that_make_starts_is_found_where_it_is_started() -> None:
    """A file that imports others of `tools` starts as a module; a file that is started itself mends its own path."""
    recipes = Path("Makefile").read_text()
    modules = re.findall(r"\$\(BIN\)/python -m (tools[.\w]+)", recipes)
    files = re.findall(r"\$\(BIN\)/python (tools/[\w/]+\.py)", recipes)
    assert len(modules) >= 6
    for name in modules:
        assert importlib.util.find_spec(name) is not None, name
    for name in files:
        text = Path(name).read_text()
        assert "from tools" not in text or "sys.path.insert" in text, name
