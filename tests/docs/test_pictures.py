"""Pictures of the pages that move."""

from tests.docs.documents import ROOT


def local_palettes(data: bytes) -> list[bool]:
    """Whether each frame of a GIF has colours of its own."""
    place, found = 13 + 3 * 2 ** ((data[10] & 7) + 1) * (data[10] >> 7), list[bool]()
    while data[place] != 0x3B:
        if data[place] == 0x2C:
            own = data[place + 9]
            found.append(own >= 0x80)
            place += 11 + 3 * 2 ** ((own & 7) + 1) * (own >> 7)
        else:
            place += 2
        while data[place]:
            place += data[place] + 1
        place += 1
    return found


def test_the_moving_picture_has_one_palette() -> None:
    frames = local_palettes((ROOT / "docs" / "images" / "touch.gif").read_bytes())
    assert len(frames) > 10
    assert not any(frames)
