"""The gallery: every command of it works, every picture of it is there, and the page says both."""

import shlex
from pathlib import Path

import pytest

from canhaptic.errors import InputError
from tests.docs.documents import ROOT, blocks
from tools.gallery import GALLERY, IMAGES, LARGEST, PAGE, Entry, make, page, prepare, reduce

PNG = b"\x89PNG\r\n\x1a\n"


def test_the_page_of_the_gallery_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run: python -m tools.gallery --page"


def test_the_page_prints_the_commands_that_make_the_pictures() -> None:
    printed = [words for block in blocks(PAGE) for words in block.commands]
    assert printed == [shlex.split(command) for entry in GALLERY for command in entry.commands]
    assert {words[0] for words in printed} == {"canhaptic"}


def test_every_picture_is_there_and_small_and_none_is_left_over() -> None:
    pictures = sorted(IMAGES.iterdir())
    assert [picture.name for picture in pictures] == sorted(entry.picture for entry in GALLERY)
    assert all(picture.read_bytes().startswith(PNG) for picture in pictures)
    sizes = [picture.stat().st_size for picture in pictures]
    assert 5_000 < min(sizes) <= max(sizes) <= LARGEST
    assert sum(sizes) < 2_500_000


@pytest.mark.slow
@pytest.mark.campaign_but("demo", "two_handles", "accuracy", "map")
@pytest.mark.parametrize("entry", GALLERY, ids=lambda entry: Path(entry.picture).stem)
def test_every_command_of_the_gallery_makes_its_picture(entry: Entry, tmp_path: Path) -> None:
    prepare(tmp_path)
    picture = make(entry, tmp_path, brief=True)
    assert picture.read_bytes().startswith(PNG)
    reduce(picture, tmp_path / "reduced.png")
    assert (tmp_path / "reduced.png").stat().st_size < picture.stat().st_size


@pytest.mark.slow
def test_a_command_that_fails_is_named_with_its_error(tmp_path: Path) -> None:
    prepare(tmp_path)
    wrong = Entry("", "", ("canhaptic run configs/no_such.yaml --png none.png",), ("",))
    with pytest.raises(InputError, match=r"run configs/no_such\.yaml .*exit status 2: .*no_such\.yaml"):
        make(wrong, tmp_path)


def test_scenes_of_the_gallery_are_shipped() -> None:
    named = {word for entry in GALLERY for command in entry.commands for word in shlex.split(command)}
    scenes = {word for word in named if word.endswith(".yaml")}
    assert len(scenes) > 10
    assert all((ROOT / scene).is_file() for scene in scenes)
