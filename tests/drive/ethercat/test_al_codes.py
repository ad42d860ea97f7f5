"""What a drive's refusal says, and what to do about it."""

import pytest

from canhaptic.drive.ethercat.segment import AlError, AlState, al_remedy, al_text, state_name


@pytest.mark.parametrize(
    ("code", "said", "remedy"),
    [
        (0x0011, "invalid requested state", "off and on"),
        (0x0016, "mailbox", "compare SII and ESI"),
        (0x0019, "outputs", "zero outputs"),
        (0x001A, "SYNC0", "lower bus.rate"),
        (0x001B, "watchdog", "bus.watchdog"),
        (0x001D, "0x1C12", "one RxPDO"),
        (0x001E, "0x1C13", "one TxPDO"),
        (0x002D, "SYNC0", "assign_activate"),
        (0x0035, "cycle", "rate"),
    ],
)
def test_a_refusal_says_the_code_its_meaning_and_the_remedy(code: int, said: str, remedy: str) -> None:
    error = AlError(2, AlState.SAFE_OP, 0x12, code)
    text = str(error)
    assert text.startswith(f"drive 2: got AL status 0x12 (PRE_OP), code {code:#06x}")
    assert said in text
    assert remedy in text
    assert "expected SAFE_OP" in text


def test_a_drive_that_stays_in_its_state_without_an_error_is_said_to_wait() -> None:
    text = str(AlError(0, AlState.OP, 0x04, 0))
    assert "waits for something that it does not name" in text
    assert "code" not in text


def test_codes_that_no_table_has_are_still_answered() -> None:
    assert al_text(0x8123) == "code of the vendor"
    assert "manual" in al_remedy(0x8123)
    assert state_name(0x0C) == "0xc"
