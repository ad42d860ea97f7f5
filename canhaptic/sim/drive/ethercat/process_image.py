"""The process data of a simulated EtherCAT drive: objects of the assigned PDOs to and from its image.

0x1C12 and 0x1C13 list the assigned PDOs, 0x1600 and 0x1A00 onwards map their objects (ETG.1000.6, 5.6.7). A list is
changed in PRE-OP, and only while its count is 0.
"""

import struct
from collections import deque
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Final

from canhaptic.canopen import objects
from canhaptic.canopen.objects import SdoAbort
from canhaptic.sim.drive.profile.object_store import Check, Entry, ObjectStore
from canhaptic.sim.drive.profile.servo import Servo

OUTPUTS: Final = 0x1C12
INPUTS: Final = 0x1C13
_MAPS: Final = {OUTPUTS: range(0x1600, 0x1800), INPUTS: range(0x1A00, 0x1C00)}
_ANY: Final = 1 << 63  # no integer of a PDO is beyond it
_LARGEST: Final = 128  # [bytes] of one image
_value_of: Final = attrgetter("value")


class ProcessImage:
    """Outputs and inputs of one drive.

    Args:
        store: Object store.
        servo: Power stage, which measures and follows the objects.
        pipeline: SYNC0s by which outputs act later than at the one that follows them.
        may_change: Returns whether the state permits changes of maps and assignments.

    Attributes:
        output_size: Length of the outputs that 0x1C12 assigns [bytes]; -1 where they cannot be used.
        input_size: Length of the inputs that 0x1C13 assigns [bytes]; -1 where they cannot be used.
    """

    def __init__(self, store: ObjectStore, servo: Servo, pipeline: int, may_change: Callable[[], bool]) -> None:
        self._store, self._servo, self._pipeline, self._may_change = store, servo, pipeline, may_change
        for assignment, maps in _MAPS.items():
            self._guard(assignment, partial(self._may_assign, maps))
            for index in maps:
                if store.find(index) is not None:
                    self._guard(index, partial(self._may_map, index))
        self.compile()

    def _guard(self, index: int, accepts: Callable[[int], bool]) -> None:
        """Check what is written to a list of PDOs or of objects."""
        count = self._store.find(index)
        if count is None:
            return
        slots: list[Entry] = []
        while (slot := self._store.find(index, len(slots) + 1)) is not None:
            slot.check = self._checks(accepts, count)
            slots.append(slot)

        def check_count(value: int) -> SdoAbort | None:
            if not self._may_change():
                return SdoAbort.DEVICE_STATE
            is_whole = value <= len(slots) and all(accepts(slot.number) for slot in slots[:value])
            return None if is_whole else SdoAbort.PDO_LENGTH

        count.check = check_count

    def _checks(self, accepts: Callable[[int], bool], count: Entry) -> Check:
        def check(value: int) -> SdoAbort | None:
            if not self._may_change():
                return SdoAbort.DEVICE_STATE
            if count.number:
                return SdoAbort.UNSUPPORTED_ACCESS
            return None if not value or accepts(value) else SdoAbort.NOT_MAPPABLE

        return check

    def _may_assign(self, maps: range, index: int) -> bool:
        return index in maps and self._store.find(index) is not None

    def _may_map(self, of: int, mapping: int) -> bool:
        if mapping >> 16 == 0:  # a gap
            return mapping & 0xFF > 0 and not mapping & 7
        entry = self._store.find(mapping >> 16, mapping >> 8 & 0xFF)
        if entry is None or not entry.code or 8 * entry.size != mapping & 0xFF:
            return False
        return entry.receivable if of in _MAPS[OUTPUTS] else entry.transmittable

    def compile(self) -> None:
        """Apply assignments and maps; forget outputs that have not acted yet."""
        outputs, self._unpack, self.output_size = self._assigned(OUTPUTS)
        inputs, self._pack, self.input_size = self._assigned(INPUTS)
        for entry in (*outputs, *inputs):
            if entry.value is None:
                entry.value = 0  # an image has no room for "no data"
        self._outputs, self._inputs = outputs, inputs
        # Too large a torque is for the drive's limiter, which shows it; any other value out of range is ignored.
        self._ranges = [(-_ANY, _ANY) if e.index == objects.TARGET_TORQUE else (e.low, e.high) for e in outputs]
        self._hooks = tuple(dict.fromkeys(e.changed for e in outputs if e.changed is not None))
        self._servo.measures_velocity = self._servo.velocity_entry in inputs
        self._later = deque[bytes | None]()

    def _assigned(self, assignment: int) -> tuple[tuple[Entry, ...], struct.Struct, int]:
        """Return the objects of an assignment, their codec and its length; -1 for maps that cannot be used."""
        code, entries, store = "<", list[Entry](), self._store
        for index in self._listed(assignment):
            for mapping in self._listed(index):
                if index not in _MAPS[assignment] or not self._may_map(index, mapping):
                    return (), struct.Struct("<"), -1
                entry = store.find(mapping >> 16, mapping >> 8 & 0xFF)
                if mapping >> 16 == 0 or entry is None:
                    code += f"{(mapping & 0xFF) // 8}x"
                else:
                    code += entry.code
                    entries.append(entry)
        image = struct.Struct(code)
        return (tuple(entries), image, image.size) if image.size <= _LARGEST else ((), struct.Struct("<"), -1)

    def _listed(self, index: int) -> list[int]:
        count = self._store.find(index)
        slots = [self._store.find(index, n + 1) for n in range(0 if count is None else count.number)]
        return [slot.number for slot in slots if slot is not None]

    def take(self, outputs: bytes | None) -> None:
        """Let outputs act, `pipeline` SYNC0s later; None: none came, and those before them act on."""
        if self._pipeline:
            self._later.append(outputs)
            outputs = self._later.popleft() if len(self._later) > self._pipeline else None
        if outputs is None:
            return
        for entry, value, (low, high) in zip(self._outputs, self._unpack.unpack(outputs), self._ranges, strict=True):
            if low <= value <= high:
                entry.value = value
        for hook in self._hooks:
            hook()

    def show(self) -> bytes:
        """Return the inputs with the present values."""
        return self._pack.pack(*map(_value_of, self._inputs))
