"""What `--vary` says, and the scenes that follow from it."""

import numpy as np
import pytest

from canhaptic.errors import InputError
from canhaptic.lab.studies.vary import CONTROLLER, make_points, parse_vary, scene_seeds


def test_a_range_has_its_ends_exactly_and_equal_steps():
    varied = parse_vary("environment.stiffness=1e2:1e6:log:5")
    assert varied.values == pytest.approx((1e2, 1e3, 1e4, 1e5, 1e6), rel=1e-14)
    assert (varied.values[0], varied.values[-1]) == (1e2, 1e6)
    assert parse_vary("environment.damping=0:10:3").values == (0.0, 5.0, 10.0)
    assert parse_vary("environment.damping=0:10:lin:3").values == (0.0, 5.0, 10.0)


def test_units_become_si_and_stay_with_what_the_scene_checks():
    varied = parse_vary("bus.rate=100,0.5 kHz,1 kHz")
    assert varied.values == (100.0, 500.0, 1000.0)
    assert varied.yaml(500.0) == "500"
    assert varied.yaml(500.0, with_unit=True) == '"0.5 kHz"'
    assert parse_vary("a.b=10 N/mm:20 N/mm:2").values == (1e4, 2e4)


def test_values_of_any_type_and_values_with_commas_inside():
    assert parse_vary("bus.rpdo=event,synchronous").values == ("event", "synchronous")
    varied = parse_vary("environment={type: wall, k: 1},{type: field, b: 2}")
    assert varied.values == ("{type: wall, k: 1}", "{type: field, b: 2}")
    assert parse_vary("axes.0.watchdog=true,false").values == ("true", "false")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stiffness", "no KEY=VALUES"),
        ("a=", "no KEY=VALUES"),
        ("a=1:2:log:x", "number of values"),
        ("a=1:2", "no number of values"),
        ("a=1:2:log", "add :N"),
        ("a=0:1:log:3", "begins above 0"),
        ("a=5:1:3", "the lower one first"),
        ("a=1:1:3", "the lower one first"),
        ("a=1:2:1", "expected 2 to"),
        ("a=1:2:99999999", "expected 2 to"),
        ("a=1:2:3:4", "cannot read the range"),
        ("a=1,,2", "empty value"),
        ("a=1 m:2 mm:4", "one unit"),
        ("a=1 N,2 m", "one dimension"),
        ("a=1e999:2:3", "finite"),
        ("a={x: 1", "not valid YAML"),
    ],
)
def test_what_cannot_be_read_is_named(text, message):
    with pytest.raises(InputError, match=message):
        make_points([parse_vary(text)])


def test_a_grid_has_every_combination_once_with_the_last_key_fastest():
    points = make_points([parse_vary("a=1,2"), parse_vary("b=x,y,z")], ["unprotected", "guarded"])
    columns = points.columns(0, len(points))
    rows = list(zip(columns[CONTROLLER], columns["a"].tolist(), columns["b"], strict=True))
    assert rows == [(c, a, b) for c in ("unprotected", "guarded") for a in (1.0, 2.0) for b in "xyz"]


def test_seeds_differ_from_scene_to_scene_and_follow_from_the_index_alone():
    seeds = scene_seeds(7, np.arange(2000)).tolist()
    assert len(set(seeds)) > 1995
    assert all(0 <= seed <= 1_000_000_000 for seed in seeds)
    assert scene_seeds(7, np.array([3])).tolist() == [seeds[3]] != scene_seeds(8, np.array([3])).tolist()


@pytest.mark.parametrize(
    ("varied", "options", "message"),
    [
        ([], {}, "nothing varies"),
        (["a=1,2", "a=3,4"], {}, "given twice"),
        (["a=0:1:100000", "b=0:1:100000"], {}, "at most"),
    ],
)
def test_points_that_make_no_sweep_are_refused(varied, options, message):
    with pytest.raises(InputError, match=message):
        make_points([parse_vary(one) for one in varied], **options)
