import inspect

import pytest

from canhaptic import errors
from canhaptic.errors import CanHapticError, LinkError, ParameterError, RigError, SceneError, StartError
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


def test_rig_errors_carry_the_last_records() -> None:
    assert LinkError("lost", records=[1, 2]).records == (1, 2)
    assert isinstance(LinkError("lost"), TimeoutError)
    assert isinstance(LinkError("lost"), RigError)


def test_a_start_error_names_drive_step_value_expectation_and_remedy() -> None:
    error = StartError("x", "mode of operation", "8", "10", "choose a drive with cst")
    assert str(error) == "x: mode of operation: got 8, expected 10; choose a drive with cst"


def test_a_scene_error_lists_every_fault() -> None:
    assert SceneError(["a:1:1: x", "a:2:1: y"]).faults == ("a:1:1: x", "a:2:1: y")
