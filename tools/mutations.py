"""Changes to files as a slip, a bad sector or an enemy makes them, drawn from a `random.Random`."""

import copy
import random
from typing import Any, Final

import yaml

HOSTILE: Final[tuple[Any, ...]] = (
    *(None, True, False, 0, -1, 1, 2, 255, 1 << 31, 1 << 64, -(1 << 63), 10**400, 0.5, -0.0, 1e-320, 1e308, -1e308),
    *(float("nan"), float("inf"), float("-inf"), "", " ", "nan", "1e400 m", "-5 N/m", "10 mm", "5 V", "0x1016", "4096"),
    *(
        "[/red]x[b]",
        "\x1b[31m",
        "a\nb",
        "a/b",
        "..",
        "\u202e",
        "\0",
        "x" * 5000,
        "type.py:Wall",
        "{",
        "auto",
        "guarded",
    ),
    *([], {}, [[]], [0] * 300, {"type": "wall"}, {"algorithm": "guarded"}, {"": ""}, {1: 2}),
)


def mutated_scene(chance: random.Random, text: str) -> bytes:
    """Returns a scene with one to three values, keys or bytes changed."""
    if chance.random() < 0.25:
        return mutated_bytes(chance, text.encode(), most=3)
    document = yaml.safe_load(text)
    for _ in range(chance.choice([1, 1, 1, 2, 3])):
        _change(chance, document)
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True).encode("utf-8", "surrogateescape")


def _places(item: Any) -> list[tuple[Any, Any]]:
    """Returns every (container, key) of a document."""
    pairs = item.items() if isinstance(item, dict) else enumerate(item) if isinstance(item, list) else ()
    return [place for key, value in pairs for place in ((item, key), *_places(value))]


def _change(chance: random.Random, document: Any) -> None:
    places = _places(document)
    if not places:
        return
    container, key = chance.choice(places)
    how = chance.random()
    value = container[key]
    if how < 0.1:
        del container[key]
    elif how < 0.2 and isinstance(container, dict):
        container[chance.choice(["lead", "type", "x", "\u202e", "[b]", "node_id", 7])] = container.pop(key)
    elif how < 0.3:
        other, name = chance.choice(places)
        if not _places(value):  # no document inside itself
            other[name] = value
    elif how < 0.5 and isinstance(value, int | float) and not isinstance(value, bool):
        container[key] = value * chance.choice([-1, 0.1, 10, 1e3, 1e6, 1e-6, 1e12])
    elif how < 0.6 and isinstance(value, str):
        at = chance.randint(0, len(value))
        container[key] = value[:at] + chance.choice(["e9", "-", "0", " ", "m", "\x1b", "%", "/"]) + value[at:]
    else:
        container[key] = copy.deepcopy(chance.choice(HOSTILE))  # one of its own: it may be changed in turn


def mutated_dictionary(chance: random.Random, text: str) -> bytes:
    """Returns an EDS with one to four lines changed, or some bytes."""
    if chance.random() < 0.15:
        return mutated_bytes(chance, text.encode(), most=6)
    lines = text.splitlines()
    values: tuple[str, ...] = (
        "",
        "0",
        "1",
        "7",
        "-1",
        "0x7FFFFFFF",
        "0xFFFFFFFF",
        "1e9",
        "$NODEID",
        "$NODEID+0x200",
        "ro",
        "wo",
        "rw",
    )
    values += ("const", "x" * 300, "0x0008", "0x0005", "\x1b[31m", "0x", "999999999999999999999")
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(lines))
        name, equals, _value = lines[at].partition("=")
        how = chance.random()
        if how < 0.15:
            del lines[at : at + chance.choice([1, 1, 8])]
        elif how < 0.25:
            lines.insert(at, chance.choice(lines))
        elif equals:
            lines[at] = f"{name}={chance.choice(values)}"
        else:
            lines[at] = lines[at][: chance.randint(0, len(lines[at]))] + chance.choice(["", "]", "sub1", "[", "0"])
    return "\n".join(lines).encode("utf-8", "surrogateescape")


def mutated_bytes(chance: random.Random, content: bytes, most: int = 12) -> bytes:
    """Returns bytes of which some are changed, lost, doubled or zero."""
    data = bytearray(content)
    how = chance.random()
    if how < 0.1:
        return bytes(data[: chance.randrange(len(data))])
    if how < 0.2:
        start, length = chance.randrange(len(data)), chance.choice([1, 16, 512, 4096])
        block = data[start : start + length]
        data[start : start + length] = chance.choice([bytes(len(block)), b"", bytes(block) * 2])
        return bytes(data)
    for _ in range(chance.randint(1, most)):
        data[chance.randrange(len(data))] = chance.choice([0, 0x20, 0x0A, 0x7F, 0xFF, chance.randrange(256)])
    return bytes(data)


_SIGNATURES: Final = (b"GCOL", b"TREE", b"SNOD", b"HEAP", b"OHDR", b"OCHK", b"FADB", b"EAHD", b"EASB", b"\x89HDF")


def mutated_hdf5(chance: random.Random, content: bytes) -> bytes:
    """Returns an HDF5 file with any bytes changed, or some of the library's own tables, a small part of it."""
    if chance.random() < 0.4:
        return mutated_bytes(chance, content)
    data = bytearray(content)
    tables = [at for name in _SIGNATURES for at in _all(data, name)]
    for _ in range(chance.randint(1, 3)):
        at = min(len(data) - 1, chance.choice(tables) + chance.randrange(512))
        data[at] = chance.choice([0, 1, 0x7F, 0x80, 0xFF, data[at] ^ 1 << chance.randrange(8)])
    return bytes(data)


def _all(data: bytes | bytearray, wanted: bytes) -> list[int]:
    found, at = [], data.find(wanted)
    while at >= 0:
        found.append(at)
        at = data.find(wanted, at + 1)
    return found


def mutated_frames(chance: random.Random, content: bytes) -> bytes:
    """Returns candump text with one to three lines changed, most of them still frames, or with any bytes changed."""
    if chance.random() < 0.2:
        return mutated_bytes(chance, content)
    lines = content.splitlines(keepends=True)
    for _ in range(chance.randint(1, 3)):
        at, how = chance.randrange(len(lines)), chance.random()
        line = bytearray(lines[at])
        if how < 0.15:
            del lines[at]
        elif how < 0.25:
            lines.insert(chance.randrange(len(lines)), lines[at])
        elif how < 0.35:
            lines[at] = bytes(line).replace(b"vcan0", chance.choice([b"vcan1", b"", b"\x1b[31m", b"x" * 300]))
        elif how < 0.45:
            lines[at] = bytes(line[:-3]) + chance.choice(
                [b" R\n", b" T\n", b"\n", b"", b"00 T\n", b"FFFFFFFFFFFFFFFFFF\n"]
            )
        else:
            digits = [place for place, byte in enumerate(line) if chr(byte) in "0123456789ABCDEF"]
            line[chance.choice(digits)] = chance.choice(b"0123456789ABCDEF")
            lines[at] = bytes(line)
    return b"".join(lines)
