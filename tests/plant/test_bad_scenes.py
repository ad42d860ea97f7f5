import pytest

from canhaptic.errors import ParameterError
from canhaptic.registry import load
from canhaptic.sim.plant.effects import EFFECTS
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.plant_scenes import make_plant
from tests.plant.read_effect import read_effect

DRY = {"kinetic": 0.3, "static": 0.5}


@pytest.mark.parametrize("name", EFFECTS)
def test_every_entry_of_the_table_is_an_effect_of_that_name(name):
    effect = load(EFFECTS, name, "effect")
    assert effect.model_fields["type"].default == name
    assert effect.order in {None, 1, 2}
    assert effect.model_config["frozen"]


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        ({"type": "colomb_friction", **DRY}, "unknown effect 'colomb_friction'.*did you mean 'coulomb_friction'"),
        ({"type": "coulomb_friction", "kinetic": 0.5, "static": 0.3}, "static 0.3 is below kinetic 0.5"),
        ({"type": "coulomb_friction", "kinetic": 0.0, "static": 0.3}, "kinetic: got 0.0, expected 0 < kinetic"),
        ({"type": "hard_stop", "position": 0.1, "stiffness": -1e6}, "stiffness: got -1000000.0, expected 0 < stiff"),
        ({"type": "hard_stop", "position": 0.1, "stifness": 1e6}, "stifness"),
        ({"type": "hard_stop", "position": 0.1, "stiffness": 1e6, "side": "left"}, "side: got 'left'"),
        ({"type": "current_loop", "time_constant": 0.0}, "time_constant: got 0.0"),
        ({"type": "cogging", "amplitude": 0.1, "pitch": float("nan")}, "pitch: got nan"),
        ({"type": "thermal_derating", "torque_limit": 1, "copper_loss": 1, "thermal_resistance": 1, "time_constant": 1,
          "warm": 400.0, "hot": 350.0}, "hot 350.0 K is not above warm 400.0 K"),
    ],
)  # fmt: skip
def test_a_bad_effect_is_refused_with_the_value(effect, expected):
    with pytest.raises(ParameterError, match=expected):
        read_effect(effect)


@pytest.mark.parametrize(
    ("effects", "user", "expected"),
    [
        ([{"type": "tremor", "amplitude": 1e-3}], None, "tremor: got no hand"),
        ([{"type": "tremor", "amplitude": 1e-3}], UserParameters(push=1.0), "tremor: got no hand"),
        ([{"type": "grasp_change", "time": 1, "stiffness": 1, "damping": 1}], None, "grasp_change: got no hand"),
        ([{"type": "backlash", "gap": 1e-3}], None, "backlash: got no shaft_compliance"),
        (
            [{"type": "coulomb_friction", **DRY}, {"type": "stribeck_friction", **DRY, "stribeck_velocity": 1e-2}],
            None,
            "coulomb_friction and stribeck_friction, expected one friction model",
        ),
        ([{"type": "hard_stop", "position": 0.1, "stiffness": 1e6}] * 2, None, "one upper hard stop"),
    ],
)
def test_effects_that_need_or_exclude_others_are_refused(effects, user, expected):
    with pytest.raises(ParameterError, match=expected):
        make_plant(*effects, user=user)


def test_the_order_of_effects_in_a_scene_does_not_matter_where_one_needs_another():
    shaft = {"type": "shaft_compliance", "stiffness": 1e5, "load_mass": 0.1}
    gap = {"type": "backlash", "gap": 1e-3}
    assert make_plant(gap, shaft).state_names == make_plant(shaft, gap).state_names


def test_a_motion_without_a_hand_is_refused():
    with pytest.raises(ParameterError, match="motion without a hand"):
        UserParameters(motion=SinusoidMotion(amplitude=0.1, frequency=1.0))


@pytest.mark.parametrize(
    "values",
    [{"accuracy": {"substeps": 3}}, {"accuracy": {"substeps": 2048}}, {"accuracy": {"event_bits": 25}}, {"period": 0}],
)
def test_settings_outside_their_range_are_refused(values):
    with pytest.raises(ParameterError, match=r"substeps|event_bits|sample time"):
        make_plant(**values)


def test_units_follow_the_axis():
    assert read_effect({"type": "shaft_compliance", "stiffness": "5 N*m/rad", "load_mass": "20 g*m^2"}, "rad")
    with pytest.raises(ParameterError, match="does not fit"):
        read_effect({"type": "shaft_compliance", "stiffness": "5 N/m", "load_mass": 0.1}, "rad")
    assert read_effect({"type": "hard_stop", "position": "10 mm", "stiffness": "1 MN/m"}, "m").position == 0.01  # type: ignore[attr-defined]
