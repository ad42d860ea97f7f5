"""User code of a scene: environments, algorithms, effects and hands, and the process in which laws may run.

A scene names `file.py:Class` (or `file.py`, if it has one class), or a plug-in. A file runs only if the user allows it.
It must be a regular file in the folder of the scene itself, else in the current folder itself, after symbolic links are
resolved. It runs under a private module name; its folder is never added to the import path. A plug-in is an installed
package that names its classes as entry points (`canhaptic.environments`, ...); a scene can use no other class of it.
The hash of each file that ran is part of the configuration, so that a log identifies the code. Commands that run
nothing leave user code unread: they neither import it nor check its parameters.

In the process of the cycle, the lock of the interpreter would let slow environments and algorithms stall it. In a
process of their own (`CodeProcess`) they answer one hold later. The sample of each SYNC goes out, and the torques for
the hold after the next come back, each through one slot of shared memory with a sequence number, without pickling and
without waiting. The cycle treats them as torques requested by a program: its guard and its account continue if answers
are late or stop.
"""

import hashlib
import inspect
import json
import mmap
import os
import select
import struct
import subprocess
import sys
import threading
import traceback
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from pydantic_core import PydanticCustomError

from canhaptic.control.ports import Port
from canhaptic.cycle import Cycle
from canhaptic.drive.clock import WallClock
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import InputError, OwnCodeError, ParameterError, cause_of
from canhaptic.files import read_regular
from canhaptic.logs.ring import allocate
from canhaptic.logs.writer_process import isolated_program
from canhaptic.own_results import GIVEN, GIVEN_MARK, watch
from canhaptic.registry import installed, load, loaded, package_of
from canhaptic.scene.components import OWN_MODULE, READY, CodeUse, SceneContext
from canhaptic.scene.document import MarkedMapping
from canhaptic.scene.models import Scene
from canhaptic.scene.parts import build_axis_controller
from canhaptic.signals import Sample
from canhaptic.units import Parameters, shown

_RETURN_NUMBERS: Final[Mapping[str, tuple[str, ...]]] = {
    "environment": ("potential", "effort", "true_state", "admissible", "stored_energy", "state_of_energy", "relaxed"),
    "passivity algorithm": ("step", "hold"),
    "sensor": ("indicates",),
}
"""Kind -> methods whose results are checked; the plant adds the methods of hands and effects."""
_MARK: Final = ".py"  # of `file.py` and `file.py:Class`
_OF_FUNCTION: Final = {"class of": "canhaptic.scene.given:class_of"}
_LARGEST: Final = 1_000_000  # [bytes]
_OWN: Final = ("environment", "passivity algorithm", "effect", "hand", "sensor")
"""Kinds of parts that a scene can take from a file or a plug-in."""


def own_model(section: MarkedMapping, reading: SceneContext, model: type[Parameters], kind: str) -> object:
    """Return the parameters of a section whose `type` names a user-defined subclass.

    Args:
        section: Section of the scene.
        reading: Context of the validation.
        model: Built-in model of the section.
        kind: Kind of model, for messages and plug-ins.

    Raises:
        ValueError: The name is no text, or names no subclass of the model.
        PydanticCustomError: The code must not run, or fails.
    """
    name, code = section["type"], reading.code
    if not isinstance(name, str):
        raise ValueError(f"type: got {shown(name)}, expected FILE.py:Class")
    if code.is_left(name, kind):
        return model()
    try:
        own = code.find(name, kind)
    except ParameterError as error:
        raise PydanticCustomError(READY, "{text}", {"text": str(error)}) from error
    if not (isinstance(own, type) and issubclass(own, model)):
        seen = "which is unknown" if own is None else f"which is no {model.__name__}"
        known = " or ".join(("FILE.py:Class", *code.offered(kind)))
        raise ValueError(f"type: got {name!r}, {seen}; expected {known}, a subclass of {model.__name__}")
    return own.of_section(section.without("type"), reading)


def _is_file(reference: str) -> bool:
    return reference.partition(":")[0].endswith(_MARK)


class OwnCode:
    """User code that a scene names, and whether it may run.

    Args:
        folder: Folder of the scene.
        use: "run" where the user permitted the scene's files, by `--allow-code` or `allow_code=True`; "left" where
            nothing is built from the scene, files and plug-ins alike.

    Attributes:
        hashes: File as the scene names it, or plug-in -> SHA-256 of the code that ran.
        left: Names of the code left unread.
    """

    def __init__(self, folder: Path, use: CodeUse = "refused") -> None:
        self._folder = folder
        self._use = use
        self.hashes: dict[str, str] = {}
        self.left: list[str] = []

    def is_left(self, reference: str, kind: str) -> bool:
        """Whether a name refers to user code that is left unread; if so, add it to `left`."""
        is_program = _is_file(reference) or reference.startswith(GIVEN_MARK)
        if self._use != "left" or not (is_program or reference in installed(kind)):
            return False
        self.left.append(reference)
        return True

    def offered(self, kind: str) -> tuple[str, ...]:
        """Return the names of the plug-ins that a scene can name as such a part."""
        return tuple(installed(kind))

    def find(self, reference: str, kind: str) -> Any:
        """Return the user-defined class that a name refers to; None for any other name.

        Raises:
            ParameterError: Not allowed, not a file of the two folders, or the code fails.
        """
        if reference.startswith(GIVEN_MARK):
            return self._given(reference, kind)
        if _is_file(reference):
            return self.load(reference, kind)
        found = installed(kind).get(reference)
        return None if found is None else self._plug_in(found, kind)

    def _given(self, reference: str, kind: str) -> type:
        name, digest, *_ = reference.removeprefix(GIVEN_MARK).split(":")
        if reference not in GIVEN:
            text = f"{name}: is a class or function of a Python program, which another process does not have"
            raise ParameterError(f"{text}; put it into a file in the folder of the scene and name it FILE.py:{name}")
        own: type = GIVEN[reference].own
        self.hashes[reference] = digest
        watch(own, _RETURN_NUMBERS.get(kind, ()))
        return own

    def _plug_in(self, found: EntryPoint, kind: str) -> Any:
        chosen, source = loaded(found)
        self.hashes[f"{found.name} ({package_of(found)})"] = hashlib.sha256(source).hexdigest()
        chosen = _class_of(chosen, found.name, kind)
        if isinstance(chosen, type):
            watch(chosen, _RETURN_NUMBERS.get(kind, ()))
        return chosen

    def load(self, reference: str, kind: str) -> Any:
        """Return the class that `file.py:Class` or `file.py` names; the file is run once.

        Raises:
            ParameterError: Not allowed, not a file of the two folders, or the code fails.
        """
        name, _, attribute = reference.partition(":")
        if kind not in _OWN:
            *first, last = _OWN
            own = f"own code can be {', '.join(first)} or {last}"
            raise ParameterError(f"got {reference!r}, expected a built-in {kind}; {own}")
        if self._use != "run":
            text = f"names the program file {name!r}, which was not run; read it, and if you trust it repeat the"
            raise ParameterError(f"{text} command with --allow-code (from Python: allow_code=True)")
        path, content = self._read(name)
        digest = hashlib.sha256(content).hexdigest()
        chosen = _chosen(_module(path, digest, content), name, attribute, kind)
        self.hashes[name] = digest
        watch(chosen, _RETURN_NUMBERS.get(kind, ()))
        return chosen

    def _read(self, name: str) -> tuple[Path, bytes]:
        """Return path and content of a regular file in the scene's folder itself, else in the current one."""
        folders = self._folder.resolve(), Path.cwd().resolve()
        folder = next((folder for folder in folders if (folder / name).exists()), folders[-1])
        path = (folder / name).resolve()
        if path.parent != folder or path.suffix != _MARK:
            text = f"{name}: lies in {path.parent}, expected a .py file in the scene's folder {folders[0]}"
            raise ParameterError(f"{text}, or in the current one, {folders[-1]}")
        try:
            return path, read_regular(path, _LARGEST)
        except (OSError, ValueError) as error:
            text = f"{name}: cannot be read ({error}); it is looked for next to the scene and in the current folder"
            raise ParameterError(f"{text}: put it into the current folder, {folders[-1]}") from error


def _chosen(module: ModuleType, name: str, attribute: str, kind: str) -> type:
    """Return the class of a file, or the class made for its function; without `attribute` the only class."""
    own = {key: of for key, of in vars(module).items() if getattr(of, "__module__", "") == module.__name__}
    classes = [key for key, of in own.items() if isinstance(of, type) and not key.startswith("_")]
    attribute = attribute or (classes[0] if len(classes) == 1 else "")
    chosen = own.get(attribute)
    chosen = _class_of(chosen, name, kind)
    if not isinstance(chosen, type):
        seen = f"has no class {attribute!r}" if attribute else f"has {len(classes)} classes, name one as in {name}:NAME"
        raise ParameterError(f"{name}: {seen}, expected one of: {', '.join(own) or 'none'}")
    return chosen


def _class_of(chosen: Any, name: str, kind: str) -> Any:
    """Return the class that is made for a function; anything else as it is."""
    try:
        return load(_OF_FUNCTION, "class of", "reader")(chosen, kind) if inspect.isfunction(chosen) else chosen
    except TypeError as error:
        raise ParameterError(f"{name}: {error}") from error


def require_same_code(ran: Mapping[str, str], recorded: Mapping[str, str], where: str) -> None:
    """Refuse user code that differs from the recorded code.

    Args:
        ran: `OwnCode.hashes` of the code that would run now.
        recorded: Hashes of the recorded run.
        where: Name of the record, for the message.

    Raises:
        InputError: A file or a plug-in differs or is missing.
    """
    for name in {**recorded, **ran}:
        now, then = ran.get(name, "nothing"), recorded.get(name, "nothing")
        if now != then:
            text = f"{name}: is not the code of {where}: SHA-256 {now[:12]} now, {then[:12]} there"
            raise InputError(f"{text}; put that version back")


@cache
def _module(path: Path, digest: str, content: bytes) -> ModuleType:
    """Run a file as a module, once for the same content, and return the module."""
    name = f"{OWN_MODULE}{digest[:16]}"
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # pydantic looks up annotations there
    try:
        exec(compile(content, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:  # a file that ends the process would end the command without a word
        del sys.modules[name]
        line = error.lineno or 1 if isinstance(error, SyntaxError) else _line_in(error, path)
        raise ParameterError(f"{path.name}:{line}: {type(error).__name__}: {error}") from error
    return module


def _line_in(error: BaseException, path: Path) -> int:
    """Return the last line of the file that was running when it raised."""
    lines = [line for frame, line in traceback.walk_tb(error.__traceback__) if frame.f_code.co_filename == str(path)]
    return lines[-1] if lines else 0


# --- in a process of its own ------------------------------------------------------------------------------------------

_BUILD: Final = {"scene": "canhaptic.scene.load:scene_from_text"}
_START: Final = 30.0  # [s] that the start of the process may take
_FREE_WAIT: Final = 10.0  # [s] for an answer at free pace, the only one that may be late there
_GOING: Final = 1.0  # [s] from the end of its pipe to its own
_PRINTED: Final = 1_000_000  # characters that the code may print
_SLOT: Final = 8192  # [bytes] from one slot to the next; the third has the text of an error
_LOOKS: Final = 20  # in a sample time, for a sample that is late
_TRIES: Final = 3  # of reading a slot that is being written


def apart(scene: Scene) -> Scene:
    """Return the scene with its user code in a separate process; unchanged if the code runs in the cycle.

    The torques of that process are limited by the certificates of `guarded`, if that is the algorithm. In a simulation
    the code runs in the cycle unless `code_runs_in` says otherwise.
    """
    where = scene.run.code_runs_in or ("cycle" if scene.simulated else "process")
    guards = ("certificates" if axis.passivity.name == "guarded" else "none" for axis in scene.axes)
    axes = tuple(replace(a, guard=guard) if a.is_own else a for a, guard in zip(scene.axes, guards, strict=True))
    if where == "cycle" or scene.run.guard is not None or axes == scene.axes:
        return scene
    if given := next((name for name in scene.own_code if name.startswith(GIVEN_MARK)), ""):
        text = f"{given.split(':')[1]} is a class or function of this program, which no other process has"
        raise InputError(f"{scene.source}: code_runs_in: process: {text}; put it into a file, or run it in the cycle")
    if not scene.text:
        raise InputError(f"{scene.source}: code_runs_in: process: needs a scene file; a mapping runs it in the cycle")
    return replace(scene, axes=axes, run=scene.run.model_copy(update={"code_runs_in": "process"}))


def require_law(scene: Scene) -> None:
    """Refuse `code_runs_in: process` for a scene whose user code is hands and effects only.

    Raises:
        InputError: No axis has a user-defined environment or algorithm.
    """
    if scene.run.code_runs_in == "process" and scene.simulated and not any(axis.is_own for axis in scene.axes):
        raise InputError(
            f"{scene.source}: code_runs_in: process: got {', '.join(scene.own_code)}, a hand or an effect, expected "
            "code of an environment or algorithm; hands and effects are part of the simulated drive: leave the key "
            "out, or run that drive in a process of its own (canhaptic drive)"
        )


class LaterLaw:
    """User-defined environments and algorithms of a scene, run in a separate process: one hold of delay is added.

    Attributes:
        places: Indices of their axes in the scene.
    """

    def __init__(self, scene: Scene) -> None:
        self.places = [place for place, axis in enumerate(scene.axes) if axis.is_own]
        axes = [scene.axes[place] for place in self.places]
        later = [axis.loop.model_copy(update={"delay": axis.loop.delay + 1}) for axis in axes]
        self._controllers: list[Any] = [
            build_axis_controller(replace(axis, guard="", loop=loop)) for axis, loop in zip(axes, later, strict=True)
        ]
        self._torques = [0.0] * len(axes)

    def step(self, periods: int, missed: int, reports: Sequence[float]) -> list[float]:
        """Return the torque of each axis for the hold after the next [N or N*m].

        Args:
            periods: Sample times since the previous SYNC.
            missed: Number of SYNCs since the last step whose samples did not arrive.
            reports: Position, applied torque and freshness (1 or 0) of each axis in turn.
        """
        for number, controller in enumerate(self._controllers):
            for _ in range(missed):
                controller.sample_lost()
            if periods > 1 and hasattr(controller, "note_skipped_syncs"):
                controller.note_skipped_syncs(float(periods))
            position, torque, fresh = reports[3 * number : 3 * number + 3]
            balance = controller.step(position, torque) if fresh else controller.sample_lost()
            self._torques[number] = balance.torque
        return self._torques


def ask_in_cycle(scene: Scene, cycle: Cycle) -> None:
    """Run user code in the cycle itself, with the delay of a process, for replays."""
    law, controllers = LaterLaw(scene), askers(scene, cycle.ports)
    due = [0.0] * len(controllers)

    def turn(samples: Sequence[Sample]) -> None:
        for controller, torque in zip(controllers, due, strict=True):
            controller.ask(torque)
        due[:] = law.step(cycle.rig.periods, 0, reports_of(samples, law.places))

    cycle.turn = turn


def askers(scene: Scene, ports: Sequence[Port]) -> list[Any]:
    """Return the controllers outside groups that request their torques from user code."""
    return [port.controller for port in ports if scene.axes[port.axes[0]].is_own]


def reports_of(samples: Sequence[Sample], places: Sequence[int]) -> list[float]:
    """Return position, torque applied and freshness of some axes, concatenated."""
    return [value for place in places for value in (samples[place][1], samples[place][2], samples[place][4])]


class _Slot:
    """One record in shared memory under a sequence number, which is odd during a write, so that neither side waits.

    Args:
        memory: Shared memory.
        start: Offset of the slot in the memory [bytes].
        values: Count of the numbers that follow index and periods in a record.
    """

    def __init__(self, memory: mmap.mmap, start: int, values: int) -> None:
        self._memory, self._start = memory, start + 8
        self._cell, self._sequence = memoryview(memory)[start : start + 8].cast("Q"), 0
        self._record = struct.Struct(f"=qq{values}dq")  # the index at both ends

    def write(self, index: int, periods: int, values: Sequence[float]) -> None:
        """Replace the record."""
        self._sequence += 2
        self._cell[0] = self._sequence - 1
        self._record.pack_into(self._memory, self._start, index, periods, *values, index)
        self._cell[0] = self._sequence

    def read(self) -> tuple[Any, ...] | None:
        """Return (index, periods, values ..., index); None before the first write and during a write."""
        for _ in range(_TRIES):
            before = self._cell[0]
            record = self._record.unpack_from(self._memory, self._start)
            if before and not before & 1 and before == self._cell[0] and record[0] == record[-1]:
                return record
        return None

    @property
    def sequence(self) -> int:
        """Number that grows by two with every record."""
        return self._cell[0]

    def let_go(self) -> None:
        """Release the memory so that it can be unmapped."""
        self._cell.release()


class CodeProcess:
    """User code of a scene in a separate process: each sample goes out, and its torques come back one hold later.

    A hold without an answer gets zero torque and is counted.

    Args:
        scene: Scene from `apart`.
        cycle: Cycle that requests the torques.
        pace: Pace of the run; at free pace the cycle waits for each answer.

    Attributes:
        late: Number of holds without an answer.
        longest: Largest number of consecutive holds without an answer.

    Raises:
        InputError: The code did not become ready.
    """

    def __init__(self, scene: Scene, cycle: Cycle, pace: str) -> None:
        self._rig, self._waits, self._most = cycle.rig, pace == "free", scene.run.late_holds
        self._names = ", ".join(scene.own_code)
        self._places = [place for place, axis in enumerate(scene.axes) if axis.is_own]
        self._controllers = askers(scene, cycle.ports)
        self.late = self.longest = self._in_a_row = 0
        self._asked = -1  # index of the sample whose answer is due
        with ExitStack() as stack:
            shared = allocate(3 * _SLOT)
            stack.callback(os.close, shared)
            self._memory = mmap.mmap(shared, 3 * _SLOT)
            self._samples = _Slot(self._memory, 0, 3 * len(self._places))
            self._answers = _Slot(self._memory, _SLOT, len(self._places))
            ends, answers = os.pipe(), os.pipe()
            self._wake, self._answered = ends[1], answers[0]
            os.set_blocking(self._wake, False)
            self._process = _spawned(scene, shared, ends[0], answers[1], pace)
            for descriptor in (ends[0], answers[1]):
                os.close(descriptor)
            if not self._await_answer(_START):
                program, what = self._failure()
                self.close()
                reason = what or f"was not ready within {_START:g} s"
                raise InputError(f"{program or self._names}: in a process of its own: {reason}; correct the program")

    def turn(self, samples: Sequence[Sample]) -> None:
        """Request the torques that answer the previous sample, and send this sample.

        Raises:
            OwnCodeError: The code raised, or did not return a number.
            OwnCodeLateError: Too many holds in a row without an answer.
        """
        if self._waits and self._asked >= 0:
            self._await_answer(_FREE_WAIT)
        answer = self._answers.read()
        in_time = answer is not None and answer[0] == self._asked
        for number, controller in enumerate(self._controllers):
            controller.ask(answer[2 + number] if in_time and answer is not None else 0.0)
        index = samples[0].sync_index
        if self._asked >= 0:
            self._count(in_time, index)
        self._asked = index
        self._samples.write(index, self._rig.periods, reports_of(samples, self._places))
        if self._waits:  # at real pace it looks by itself: to wake another process takes the cycle up to 150 us
            with suppress(BlockingIOError, BrokenPipeError):
                os.write(self._wake, b"\0")

    def _count(self, in_time: bool, index: int) -> None:
        if in_time:
            self._in_a_row = 0
            return
        self.late += 1
        self._in_a_row += 1
        self.longest = max(self.longest, self._in_a_row)
        program, what = self._failure()
        if what:
            raise OwnCodeError(program, what, f"at SYNC {index}")
        if self._in_a_row >= self._most or self._waits:
            code = self._process.poll()
            how = "" if code is None else f"; its process {f'was ended by signal {-code}' if code < 0 else 'has ended'}"
            raise self._rig.end(StopReason.OWN_CODE_LATE, f"{self._names}: {self._in_a_row} holds in a row{how}")

    def _failure(self) -> tuple[str, str]:
        """Return which program failed and why; two empty texts while it runs."""
        size = int.from_bytes(self._memory[2 * _SLOT : 2 * _SLOT + 8], "little")
        text = self._memory[2 * _SLOT + 8 : 2 * _SLOT + 8 + size].decode("utf-8", "replace")
        program, _, what = text.partition("\n")
        return program, what

    def _await_answer(self, seconds: float) -> bool:
        """Wait for an answer; return whether one came in time."""
        if not select.select([self._answered], [], [], seconds)[0]:
            return False
        if os.read(self._answered, 1):
            return True
        with suppress(subprocess.TimeoutExpired):  # it has gone, and will soon say how
            self._process.wait(_GOING)
        return False

    def close(self) -> None:
        """End the process; a second call does nothing."""
        if self._memory.closed:
            return
        self._process.kill()
        with suppress(BrokenPipeError):
            self._process.communicate()  # and closes the pipe by which it would see that the cycle is gone
        for descriptor in (self._wake, self._answered):
            os.close(descriptor)
        for slot in (self._samples, self._answers):
            slot.let_go()
        self._memory.close()


def _spawned(scene: Scene, shared: int, wake: int, answers: int, pace: str) -> "subprocess.Popen[str]":
    """Start the process and return it; it ends with this one."""
    job = {
        "text": scene.text, "source": scene.source, "overrides": scene.overrides, "path": sys.path,
        "own_code": dict(scene.own_code), "pace": pace,
        "spin": scene.bus.spin_margin, "period": scene.bus.sample_time_ns,
    }  # fmt: skip
    descriptors = (shared, wake, answers)
    process = isolated_program("canhaptic.scene.own_code", descriptors, descriptors)
    if process.stdin is not None:
        with suppress(BrokenPipeError):  # it has ended already
            process.stdin.write(json.dumps(job) + "\n")
            process.stdin.flush()
    return process


class _Printed:
    """Standard output of user code, cut after a limited number of characters."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._left = stream, _PRINTED

    def write(self, text: str) -> int:
        """Print a text up to the limit."""
        if self._left > 0:
            self._stream.write(text[: self._left])
            self._left -= len(text)
            if self._left <= 0:
                self._stream.write("\ncanhaptic: own code has printed too much; the rest is left out\n")
        return len(text)

    def flush(self) -> None:
        """Print the pending text."""
        self._stream.flush()


def main() -> None:
    """Run the user code in this process until the process of the cycle ends."""
    import resource  # not on Windows

    shared, wake, answers = map(int, sys.argv[1:])
    memory = mmap.mmap(shared, 3 * _SLOT)
    job = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_the_cycle, daemon=True).start()
    most = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))  # what leaks is a MemoryError here, and none of the cycle's
    sys.path[:] = job["path"]
    sys.stdout, sys.stderr = _Printed(sys.stdout), _Printed(sys.stderr)
    try:
        scene = load(_BUILD, "scene", "reader")(job["text"], job["source"], job["overrides"], allow_code=True)
        require_same_code(scene.own_code, job["own_code"], "the cycle")  # a file may be replaced in between
        law = LaterLaw(scene)
        os.write(answers, b"\0")
        _answer(law, memory, wake, answers, job)
    except BaseException as error:  # own code may raise anything
        program, what = ", ".join(job["own_code"]), cause_of(error)
        if isinstance(error, OwnCodeError):
            program, what = error.program, error.what
        text = f"{program}\n{what.removeprefix(f'{program}: ')}".encode()[:1000]  # the cycle adds the remedy
        memory[2 * _SLOT + 8 : 2 * _SLOT + 8 + len(text)] = text
        memory[2 * _SLOT : 2 * _SLOT + 8] = len(text).to_bytes(8, "little")
        os._exit(1)


def _end_with_the_cycle() -> None:
    while sys.stdin.read(1):
        pass
    os._exit(0)


def _answer(law: LaterLaw, memory: mmap.mmap, wake: int, answers: int, job: Mapping[str, Any]) -> None:
    """Answer each sample until the process of the cycle has ended."""
    count = len(law.places)
    samples, answered = _Slot(memory, 0, 3 * count), _Slot(memory, _SLOT, count)
    clock, seen, due, index = WallClock(spin_margin=0.0), 0, 0, -1
    is_free, period = job["pace"] == "free", job["period"]
    margin = _margin(job["spin"], period)
    while True:
        while samples.sequence == seen:
            now = clock.now()
            if is_free:
                if not os.read(wake, 4096):
                    return
            elif now < due - margin:
                clock.wait_until(due - margin)
            elif now > due + 2 * margin:  # the sample is late, or the run pauses: look less often
                clock.wait_until(now + period // _LOOKS)
        record = samples.read()
        if record is None or record[0] == index:
            continue
        seen, due = samples.sequence, clock.now() + period
        torques = law.step(record[1], max(0, record[0] - index - 1), record[2:-1])
        index = record[0]
        answered.write(index, 1, torques)
        if is_free:
            os.write(answers, b"\0")


def _margin(spin: float, period: int) -> int:
    """Return how long before a sample to begin to spin [ns]: 0 if no processor would be left for the cycle."""
    many = hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) > 1
    return min(round(spin * 1e9), period // 4) if many else 0
