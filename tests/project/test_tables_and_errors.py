import inspect

import pytest

from canhaptic import errors
from canhaptic.errors import CanHapticError, LinkError, ParameterError, RigError, cause_of
from canhaptic.registry import load


def test_a_name_of_the_table_is_imported_on_demand() -> None:
    assert load({"decoder": "json:JSONDecoder"}, "decoder", "codec").__name__ == "JSONDecoder"


def test_an_unknown_name_offers_the_nearest_one() -> None:
    with pytest.raises(
        ParameterError, match=r"unknown wall 'sprin', expected one of: damper, spring; did you mean 'spri"
    ):
        load({"spring": "x:y", "damper": "x:y"}, "sprin", "wall")


def test_every_error_of_the_package_is_in_the_tree_and_has_an_exit_status() -> None:
    assert errors.__doc__ is not None
    for name, error in inspect.getmembers(errors, inspect.isclass):
        if issubclass(error, Exception) and not issubclass(error, Warning):
            assert issubclass(error, CanHapticError)
            assert name in errors.__doc__
            assert error.exit_status in {1, 2, 3}


def raised(program: str, name: str = "__main__", file: str = "/rig/mine.py") -> Exception:
    """The exception of a program that is executed as a file of a module."""
    try:
        exec(compile(program, file, "exec"), {"__name__": name})
    except Exception as error:
        above = error.__traceback__  # the frame of this test
        return error.with_traceback(above and above.tb_next)
    raise AssertionError(program)


def test_the_cause_of_a_foreign_error_is_one_bounded_line_with_its_place() -> None:
    assert cause_of(raised("\nraise ValueError('my bug')")) == "ValueError: my bug (mine.py:2)"
    assert cause_of(raised("import json\njson.loads('{')")).endswith("(mine.py:2)")  # not a line of the library
    assert cause_of(raised("raise ValueError('a\\nb\\x1b[2J')")) == r"ValueError: a\nb\x1b[2J (mine.py:1)"
    assert len(cause_of(raised("raise ValueError(5000 * 'x')"))) < 250
    assert cause_of(raised("raise ValueError('inside')", "canhaptic.cycle")) == "ValueError: inside"
    assert cause_of(ParameterError("ours, as it is")) == "ours, as it is"
    mute = "class Mute(Exception):\n    def __str__(self):\n        return 1 / 0\nraise Mute"
    assert cause_of(raised(mute)) == "Mute: an error without a readable message (mine.py:4)"


def test_rig_errors_carry_the_last_records() -> None:
    assert LinkError("lost", records=[1, 2]).records == (1, 2)
    assert isinstance(LinkError("lost"), TimeoutError)
    assert isinstance(LinkError("lost"), RigError)
