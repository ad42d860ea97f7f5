"""Makes README.md the first page of the site, and offers versions where there are several: a hook of mkdocs."""

import os
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

README = Path(__file__).resolve().parent.parent / "README.md"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Takes the choice of versions out of a site of one, whose pages would look for versions.json in vain."""
    if "MIKE_DOCS_VERSION" not in os.environ:  # set by `mike deploy`
        config.extra.pop("version", None)
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the page, whose links lead into docs/."""
    text = README.read_text(encoding="utf-8").replace("](docs/", "](")
    files.append(File.generated(config, "index.md", content=text))
    return files
