"""The tests of what lies between a controller and a hand are tested themselves: every slip must fail one of them.

Each module below has a specification that takes the module as an argument. The module as it is must meet it, and every
mutant of it must not.
"""

import importlib
import textwrap
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest

from canhaptic.canopen.objects import Controlword, StatusBit
from canhaptic.drive.profile import scaling
from canhaptic.drive.safety import limiter, link_policy
from canhaptic.drive.safety import power_states as cia402
from canhaptic.sim.drive.profile import state_machine
from tests.mutation import (
    specification_of_cia402,
    specification_of_limiter,
    specification_of_link_policy,
    specification_of_scaling,
    specification_of_state_machine,
)
from tests.mutation.mutator import load, mutants
from tools import mutant_server
from tools.mutants import EQUIVALENT, ROOT


class Subject(NamedTuple):
    """A module and its specification."""

    module: ModuleType
    judge: Callable[[ModuleType], None]
    fewest: int  # mutants; fewer would mean that the mutator has gone blind
    members: Mapping[str, type[Enum]] = {}
    names: Mapping[str, Sequence[str]] = {}


SUBJECTS = {
    "limiter": Subject(limiter, specification_of_limiter.judge, 110),
    "cia402": Subject(
        cia402,
        specification_of_cia402.judge,
        240,
        members={"PowerState": cia402.PowerState, "Controlword": Controlword},
    ),
    "link_policy": Subject(
        link_policy,
        specification_of_link_policy.judge,
        107,
        members={"StopReason": link_policy.StopReason},
        names={
            "max": ("min",),
            "TpdoLostError": ("HeartbeatLostError",),
            "BusFailedError": ("TpdoLostError",),
            "EmergencyError": ("DriveStateFaultError",),
            "DriveStateFaultError": ("StateLeftError",),
            "StateLeftError": ("NmtStateLeftError",),
            "PositionJumpError": ("TorqueNotFiniteError",),
            "ForceRangeError": ("ForceFrozenError",),
            "TorqueNotFiniteError": ("CycleFailedError",),
        },
    ),
    "state_machine": Subject(
        state_machine,
        specification_of_state_machine.judge,
        340,
        members={
            "_S": state_machine.DriveState,
            "DriveState": state_machine.DriveState,
            "_C": state_machine.PowerCommand,
            "PowerCommand": state_machine.PowerCommand,
            "StatusBit": StatusBit,
        },
    ),
    "scaling": Subject(
        scaling,
        specification_of_scaling.judge,
        85,
        names={"round": ("int",), "trunc": ("floor", "ceil"), "isfinite": ("isnan",)},
    ),
}


def survives(code: object, judge: Callable[[ModuleType], None]) -> bool:
    """Whether a mutant loads and meets the specification."""
    try:
        judge(load(code))  # type: ignore[arg-type]
    except (Exception, pytest.fail.Exception):
        return False
    return True


@pytest.mark.slow_but("cia402", "scaling")
@pytest.mark.parametrize("name", SUBJECTS)
def test_the_module_meets_its_specification_and_every_mutant_fails_it(name: str) -> None:
    subject = SUBJECTS[name]
    subject.judge(subject.module)
    path = Path(str(subject.module.__file__))
    every = {mutant.name: mutant.code for mutant in mutants(path, subject.members, subject.names)}
    assert len(every) >= subject.fewest
    survivors = {mutant for mutant, code in every.items() if survives(code, subject.judge)}
    start = f"{path.relative_to(ROOT).as_posix()}: "
    equivalent = {name.removeprefix(start) for name in EQUIVALENT if name.startswith(start)}
    assert survivors - equivalent == set(), "no test notices these"
    assert equivalent - every.keys() == set(), "these are no longer made"
    assert equivalent - survivors == set(), "these are noticed after all"


SAMPLE = '''
"""A docstring."""
LIMIT: int = 3
def limited(x: int | None = None) -> bool:
    """Another 1."""
    if not x < LIMIT and x & 4:
        raise ValueError(f"{x + 1}")
    return True
'''


def test_the_mutator_makes_every_slip_once_and_leaves_text_alone(tmp_path: Path) -> None:
    path = tmp_path / "sample.py"
    path.write_text(SAMPLE)
    condition = "limited: if not x < LIMIT and x & 4:"
    assert sorted(mutant.name for mutant in mutants(path, {})) == sorted(
        [
            *(f"module: LIMIT: int = 3 => LIMIT: int = {other}" for other in (4, 2, 1, 7, 11, 19, 35, 67, 131)),
            "module: def limited(x: int | None=None) -> bool: => def limited(x: int | None=...) -> bool:",
            f"{condition} => if not x < LIMIT or x & 4:",
            f"{condition} => if +(x < LIMIT) and x & 4:",
            f"{condition} => if not x <= LIMIT and x & 4:",
            f"{condition} => if not x > LIMIT and x & 4:",
            f"{condition} => if not x < LIMIT and x | 4:",
            f"{condition} => if not x < LIMIT and x ^ 4:",
            *(f"{condition} => if not x < LIMIT and x & {other}:" for other in (6, 0, 12, 20, 36, 68, 132)),
            *(f"{condition} => if not x < LIMIT and x & {other}:" for other in (5, 3)),
            f"{condition} => if not (not x < LIMIT and x & 4):",
            "limited: raise ValueError(f'{x + 1}') => left out",
            "limited: return True => return False",
            "limited: return True => return None",
        ]
    )


@pytest.mark.parametrize(
    ("text", "is_same"),
    [
        ("x = a if a > b else b", True),
        ("x = a - b if a > b else 0.0", True),
        ("x = a - b if a > b else 1.0", False),
        ("x = a * c if a >= 0.0 else 0.0", True),
        ("x = a + c if a >= 0.0 else 0.0", False),
        ("if a < b: a = b", True),
        ("if a < b: c = b", False),
        ("if a > 0.0: c += a * d", True),
        ("if a > 0.0: c += a + d", False),
        ("if a > 0.0 and d: c += a * d", True),
        ("if a > b:\n  c += a - b\n  d -= c * (b - a)", True),
        ("if a > b:\n  c += a - b\n  d = c", False),
        ("if a > b: c = a\nelse: c = b", True),
        ("if a > b: c = a\nelse: d = b", False),
        ("if a > b: raise ValueError", False),
        ("if a > 1: return a * c\nreturn c", True),
        ("if a > 1: return a * c\nreturn c + 1", False),
        ("if sign > 0.0: c = a", True),
    ],
)
def test_no_mutant_is_made_of_a_comparison_whose_two_ways_meet(tmp_path: Path, text: str, is_same: bool) -> None:
    """It turns an order round and, where equal numbers matter, puts them on the other side."""
    path = tmp_path / "sample.py"
    path.write_text("def f(a, b, c, d, sign):\n" + textwrap.indent(text, "  "))
    order = next(word for word in text.split() if word[0] in "<>")
    edge = order[0] if "=" in order else f"{order}="
    found = [mutant.name.partition(" => ")[2] for mutant in mutants(path, {})]
    assert any(f" {edge} " in name for name in found) is not is_same
    assert any((" < " if order[0] == ">" else " > ") in name.replace("=", " ") for name in found)


MODULE = """
STEP = 1
def count(x):
    return x + STEP
class Counter:
    @property
    def one(self):
        return count(0)
    @staticmethod
    def two():
        return count(1)
"""


def test_a_mutant_of_a_function_takes_effect_where_it_was_imported_to_and_others_are_left_to_an_import(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "swapped_module.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("swapped_module")
    count, counter = module.count, module.Counter()
    for scope, old, new, figures in [
        ("count", "x + STEP", "x - STEP", (4, -1, 0)),
        ("Counter.one", "count(0)", "count(7)", (4, 6, 0)),
        ("Counter.two", "count(1)", "count(9)", (4, 6, 8)),
    ]:
        assert mutant_server.swap("swapped_module.py", scope, MODULE.replace(old, new))
        assert (count(5), counter.one, counter.two()) == figures
    for scope in ("module", "Counter", "absent"):
        assert not mutant_server.swap("swapped_module.py", scope, MODULE.replace("STEP = 1", "STEP = 2"))
    assert module.STEP == 1
