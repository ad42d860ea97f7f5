"""The drive built from our own trait dictionaries, and from the vendors': literal frames up to torque on the motor."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.sim_drive.drive_on_bus import TRAITS, Rig


class Bring(NamedTuple):
    """How a dictionary is brought to torque: PDO numbers, whether their maps are written, and what it lacks."""

    name: str
    rpdo: int = 0
    tpdos: Sequence[tuple[int, Sequence[int]]] = ((0, (0x60410010, 0x60640020, 0x60740010)),)
    writes_rpdo_map: bool = True
    objects: Sequence[int] = ()
    lacks: Sequence[int] = ()


FIXED = ((0x02, ()), (0x04, ()))  # TPDO 3: statusword, position; TPDO 5: statusword, torque actual
TRAIT_FILES = [
    Bring("fixed_maps.eds", 4, FIXED, False, (0x6502,), (0x6072, 0x6074, 0x6076, 0x1005, 0x1014)),
    Bring("fixed_maps.eds", 4, ((0x19, (0x60410010, 0x60640020, 0x60770010)),), False, (0x6502,)),
    Bring("array_maps.eds", lacks=(0x6072,)),
    Bring("empty_entries.eds", objects=(0x6502, 0x1000)),
]
VENDOR_FILES = [
    Bring("elmo_gold.dcf", objects=(0x6502,)),
    Bring("kollmorgen_rgm.eds", 4, FIXED, False, (0x6502,), (0x6072, 0x6074, 0x6076)),
    Bring("kollmorgen_rgm.eds", 4, ((0x19, (0x60410010, 0x60640020, 0x60770010)),), False, (0x6502,)),
    Bring("zeroerr_erob.eds", lacks=(0x6072,)),
    Bring("maxon_epos4.dcf", 0, ((0, (0x60410010, 0x60640020, 0x60770010)),), lacks=(0x6072, 0x6074)),
]
VALUES = {0x6502: 0x200, 0x1000: 0x20192}


def bring_up(path: Path, how: Bring) -> None:
    rig = Rig(path, objects={index: VALUES[index] for index in how.objects})
    with rig:
        assert rig.read(0x1000)[:5] == "92 01"
        for index in how.lacks:
            assert rig.read(index) == "06020000"
        assert rig.write(0x6060, 0, 10, 1) == "ok"
        assert rig.read(0x6061)[:2] == "0a"
        map_rpdo(rig, how)
        cob_ids = {0x191 + 0x10 * i: map_tpdo(rig, 0x191 + 0x10 * i, *tpdo) for i, tpdo in enumerate(how.tpdos)}
        rig.send(0x000, "01 05")
        for controlword in ("0600", "0700", "0f00"):
            rig.send(0x211, controlword + "0000")
            rig.sync()
        assert rig.drive.state is DriveState.OPERATION_ENABLED
        rig.send(0x211, "0f00" + "6400")
        rig.sync()
        frames = dict(rig.sync())
        assert {cob_id: len(bytes.fromhex(frames[cob_id])) for cob_id in cob_ids} == cob_ids
        assert rig.drive.torque == pytest.approx(0.1, rel=1e-12)
        assert rig.motor.velocity == pytest.approx(0.1e-3, rel=1e-12)
        assert any(frame.endswith("64 00") for frame in frames.values())


def map_rpdo(rig: Rig, how: Bring) -> None:
    communication, mapping = 0x1400 + how.rpdo, 0x1600 + how.rpdo
    rig.write(communication, 1, 0x8000_0211, 4)
    assert rig.write(communication, 2, 1, 1) == "ok"
    if how.writes_rpdo_map:
        assert rig.write(mapping, 0, 0, 1) == "ok"
        assert rig.write(mapping, 1, 0x60400010, 4) == "ok"
        assert rig.write(mapping, 2, 0x60710010, 4) == "ok"
        assert rig.write(mapping, 0, 2, 1) == "ok"
    else:
        assert rig.write(mapping, 1, 0x60710010, 4) == "06010002"  # fixed: read only
    assert rig.read(mapping, 1) == "10 00 40 60"
    assert rig.read(mapping, 2) == "10 00 71 60"
    assert rig.write(communication, 1, 0x211, 4) == "ok"


def map_tpdo(rig: Rig, cob_id: int, number: int, entries: Sequence[int]) -> int:
    """Maps (or selects) a TPDO; returns the length of its frame."""
    communication, mapping = 0x1800 + number, 0x1A00 + number
    rig.write(communication, 1, 0x8000_0000 + cob_id, 4)
    assert rig.write(communication, 2, 1, 1) == "ok"
    if entries:
        assert rig.write(mapping, 0, 0, 1) == "ok"
        for i, entry in enumerate(entries, 1):
            assert rig.write(mapping, i, entry, 4) == "ok"
        assert rig.write(mapping, 0, len(entries), 1) == "ok"
    count = int(rig.read(mapping, 0)[:2], 16)
    bits = sum(bytes.fromhex(rig.read(mapping, i))[0] for i in range(1, count + 1))
    assert rig.write(communication, 1, cob_id, 4) == "ok"
    return bits // 8


@pytest.mark.parametrize("how", TRAIT_FILES, ids=[f"{how.name}-{how.tpdos[0][0]}" for how in TRAIT_FILES])
def test_trait_dictionaries_come_up_to_torque(how: Bring) -> None:
    bring_up(TRAITS / how.name, how)


@pytest.mark.parametrize("how", VENDOR_FILES, ids=[f"{how.name}-{how.tpdos[0][0]}" for how in VENDOR_FILES])
def test_vendor_dictionaries_come_up_to_torque(vendor_eds: Path, how: Bring) -> None:
    bring_up(vendor_eds / how.name, how)


@pytest.mark.parametrize("name", ["no_cyclic_torque.eds", "no_target_torque.eds"])
def test_dictionaries_without_cyclic_torque_refuse_the_mode(name: str) -> None:
    with Rig(TRAITS / name) as rig:
        assert rig.write(0x6060, 0, 10, 1) == "06090030"


@pytest.mark.parametrize("name", ["elmo_simpliq.dcf", "maxon_epos2.eds", "schunk_prl.dcf"])
def test_vendor_dictionaries_without_cyclic_torque_refuse_the_mode(vendor_eds: Path, name: str) -> None:
    with Rig(vendor_eds / name) as rig:
        assert rig.write(0x6060, 0, 10, 1) in {"06090030", "06090031"}


@pytest.mark.parametrize("name", ["fixed_maps.eds", "array_maps.eds", "empty_entries.eds", "no_cyclic_torque.eds"])
def test_rated_torque_is_never_assumed(name: str) -> None:
    with pytest.raises(ParameterError, match="0x6076"):
        Rig(TRAITS / name, rated_torque=None)


def test_supported_modes_without_value_are_no_modes_and_no_data() -> None:
    with Rig(TRAITS / "fixed_maps.eds") as rig:
        assert rig.read(0x6502) == "08000024"
        assert rig.write(0x6060, 0, 10, 1) == "06090030"


def test_emcy_works_without_its_object() -> None:
    with Rig(TRAITS / "fixed_maps.eds") as rig:
        rig.drive.inject_fault(0x2310)
        assert rig.run() == [(0x085, "10 23 03 00 00 00 00 00")]
        assert rig.read(0x603F) == "06020000"
