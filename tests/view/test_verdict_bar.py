"""The bar of a page says of every sum whether it was passive, and names the word of a port where that says more."""

import pytest

from canhaptic.view.html_page import verdict_bar


@pytest.mark.parametrize(("word", "shown"), [("yes", "yes"), ("in doubt", "in doubt"), ("no", "NO")])
@pytest.mark.parametrize(("key", "where"), [("passive", "at the motor"), ("passive_at_sensor", "at the sensor")])
def test_a_side_of_touch_has_a_sum_and_no_word_of_its_own(key: str, where: str, word: str, shown: str) -> None:
    bar = verdict_bar({"handle": {key: word}})  # type: ignore[misc]
    assert bar.count("<span") == 1
    assert f">handle: passive {where}: {shown}<" in bar


def test_an_active_motor_behind_an_uncertain_handle_is_a_no_with_the_reason_of_the_doubt() -> None:
    port = {"passive": "no", "passive_at_handle": "in doubt", "verdict": "no", "active_since": 0.5,
            "why": "the device may have dissipated more"}  # fmt: skip
    headline, motor, handle = verdict_bar({"knob": port}).split("</span>")[:-1]  # type: ignore[dict-item]
    assert headline.endswith(">knob: passive: NO, for certain from 0.5 s on")
    assert motor.endswith(">knob: passive at the motor: NO")
    assert handle.endswith(">knob: passive at the handle: in doubt: the device may have dissipated more")
