"""YAML text to marked values."""

import math

import pytest

from canhaptic.errors import SceneError
from canhaptic.scene import document
from canhaptic.scene.document import _MAX_NODES, Diagnostics, MarkedMapping, compose, parse_yaml


def read(text: str) -> object:
    faults = Diagnostics()
    value = parse_yaml(text, "s.yaml", faults)
    faults.raise_if_any()
    return value


def fault_of(text: str) -> str:
    with pytest.raises(SceneError) as caught:
        read(text)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("1E6", 1e6),
        ("-2.5e+3", -2500.0),
        (".5", 0.5),
        ("7.", 7.0),
        ("1_000_000", 1_000_000),
        ("0x6076", 0x6076),
        ("0o17", 15),
        ("017", 17),
        ("1:30", "1:30"),
        ("on", "on"),
        ("no", "no"),
        ("2024-01-01", "2024-01-01"),
        ("true", True),
        ("~", None),
        ("", None),
        ("-.inf", -math.inf),
        ("100 N/m", "100 N/m"),
        ("'5'", "5"),
        ("e5", "e5"),
        ("-", [None]),
        ("+", "+"),
        (".", "."),
    ],
)
def test_scalars_follow_yaml_1_2(text: str, value: object) -> None:
    result = read(f"a: {text}" if text != "-" else "-")
    seen = result["a"] if isinstance(result, dict) else result
    assert seen == value
    assert type(seen) is type(value) or isinstance(seen, list)


def test_not_a_number_is_read_as_such() -> None:
    result = read("a: .nan")
    assert isinstance(result, dict)
    assert math.isnan(result["a"])


def test_every_key_and_value_knows_its_line_and_column() -> None:
    result = read("a:\n  bb: 1\n  c: [10,\n      20]\n")
    assert isinstance(result, MarkedMapping)
    inner = result["a"]
    assert inner.keys_at["bb"].where == "s.yaml:2:3"
    assert inner.values_at["bb"].where == "s.yaml:2:7"
    assert inner["c"].values_at[1].where == "s.yaml:4:7"
    assert inner["c"].values_at[1].path == ("a", "c", "1")
    assert inner.value_at("missing").where == "s.yaml:2:3"


def test_keys_are_kept_as_written() -> None:
    result = read("0x6076: 1\n6091.1: 2\non: 3\n1e3: 4")
    assert isinstance(result, dict)
    assert list(result) == ["0x6076", "6091.1", "on", "1e3"]


def test_a_key_given_twice_is_a_fault_that_names_both_places() -> None:
    text = fault_of("a: 1\nb:\n  c: 1\n  c: 2\na: 3\n")
    assert text.splitlines() == [
        "s.yaml:4:3: b.c: key 'c' is given twice, first in line 3; keep one",
        "s.yaml:5:1: a: key 'a' is given twice, first in line 1; keep one",
    ]


def test_merge_keys_give_defaults_that_written_keys_override() -> None:
    result = read("base: &b {x: 1, y: 2}\nuse:\n  <<: *b\n  y: 3\n")
    assert isinstance(result, dict)
    assert result["use"] == {"x": 1, "y": 3}
    assert result["use"].values_at["x"].path == ("use", "x")
    assert "merges mappings only" in fault_of("<<: 5")


@pytest.mark.slow_for("text12*")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: b: c", "s.yaml:1:5: not valid YAML: mapping values are not allowed here"),
        ("a: [1", "s.yaml:1:6: not valid YAML: expected ',' or ']'"),
        ("\ta: 1", "s.yaml:1:1: not valid YAML: found character '\\t'"),
        ("a: \x00", "not valid YAML"),
        ("a: *u", "s.yaml:1:4: not valid YAML: found undefined alias"),
        ("a: 1\n---\nb: 1", "another document"),
        ("a: !!python/object:os.system {}", "tag 'tag:yaml.org,2002:python/object:os.system' is not supported"),
        ("a: !!timestamp 2001-99-99", "not a plain value"),
        ("a: !!int abc", "not a plain value"),
        ("a: " + "9" * 5000, "not a plain value"),
        ("a: &x [*x]", "contains itself"),
        ("? [a]\n: b", "a key must be a plain word or number"),
        ("[" * 1500, "nested too deeply"),
    ],
)
def test_what_is_not_plain_data_is_one_clear_fault(text: str, message: str) -> None:
    assert message in fault_of(text)


def test_an_alias_bomb_is_refused_quickly() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    assert f"more than {_MAX_NODES} values" in fault_of("\n".join(lines))


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        "a: 1\nb:\n- {c: [x, 'y''s', \"z\\t\"]}\n- &n\n  d: |\n   more\n   lines\ne: *n\n",
        "{a: , b: 1}",  # libyaml places the missing value elsewhere
        "a: x\t\n",  # and takes each of these
        "\ufeffa: 1\n",
        "a: >-#\n",
        "a: {b?c: 1}\n",
        "a: !x!y\n",
        "%YAML 1.2#\n---\na: 1\n",
        "a: [1, 2\nb: 3\n",
        "a: \ud800\n",
        "[" * 1_000 + "]" * 1_000,
        "- " * 1_000,
    ],
)
def test_libyaml_reads_what_the_parser_in_python_reads_with_the_same_faults_and_places(text: str, monkeypatch) -> None:
    def seen() -> tuple[object, ...]:
        compose.cache_clear()
        faults = Diagnostics()
        value = parse_yaml(text, "s.yaml", faults)
        return value, list(faults._lines), getattr(value, "values_at", None)

    by_libyaml = seen()
    monkeypatch.setattr(document, "_C_LOADER", None)
    assert seen() == by_libyaml
