"""The bar of a page says of every sum whether it was passive, and names the word of a port where that says more."""

import pytest

from canhaptic.view.html_page import verdict_bar


@pytest.mark.parametrize(("word", "shown"), [("yes", "yes"), ("in doubt", "in doubt"), ("no", "NO")])
@pytest.mark.parametrize(("key", "where"), [("passive", "at the motor"), ("passive_at_sensor", "at the sensor")])
def test_a_side_of_touch_has_a_sum_and_no_word_of_its_own(key: str, where: str, word: str, shown: str) -> None:
    bar = verdict_bar({"handle": {key: word}})  # type: ignore[misc]
    assert bar.count("<span") == 1
    assert f">handle: passive {where}: {shown}<" in bar
