"""python-can's interfaces: the worked examples, the options that each takes, and one clear error when none opens."""

import inspect
import tomllib
from pathlib import Path
from typing import Any

import can
import pytest
from can.interfaces import BACKENDS

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.errors import CanHapticError, InputError, LinkError
from canhaptic.host.interfaces import _REMEDIES, _accepted_options, interface_faults, opening_error
from canhaptic.scene.load import load_scene
from tests.scene.scene_text import REPOSITORY, faults

EXAMPLES = sorted((REPOSITORY / "configs" / "interfaces").glob("*.yaml"))
BACKEND_OF = {"candlelight": "gs_usb"}


def bus(**values: Any) -> CanBusParameters:
    return CanBusParameters(rate=1000.0, **values)


def test_there_is_an_example_for_every_interface_of_the_list() -> None:
    names = {"socketcan", "pcan", "kvaser", "slcan", "candlelight", "ixxat", "vector"}
    assert {path.stem for path in EXAMPLES} == names


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_is_a_whole_scene_whose_options_its_backend_takes(path: Path) -> None:
    scene = load_scene(path)
    assert scene.bus.interface == BACKEND_OF.get(path.stem, path.stem)
    assert scene.bus.channel is not None
    assert not scene.simulated
    assert interface_faults(scene.bus) == []
    accepted = _accepted_options(scene.bus.interface)
    assert accepted is not None
    assert scene.bus.options.keys() <= accepted


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(BACKENDS))
def test_the_options_read_from_the_source_are_those_of_the_signature(name: str) -> None:
    """Against `inspect`, for every backend that this machine can import."""
    module, class_name = BACKENDS[name]
    try:
        backend = getattr(__import__(module, fromlist=[class_name]), class_name)
    except (ImportError, AttributeError) as error:
        pytest.skip(f"{name} cannot be imported here: {error}")
    named = {
        parameter.name
        for parameter in inspect.signature(backend.__init__).parameters.values()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    }
    accepted = _accepted_options(name)
    assert accepted is not None
    assert {n for n in named if not n.startswith("_")} - {"self", "channel", "bitrate"} <= accepted


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("kvaser", {"accept_virtual", "exclusive", "driver_mode", "single_handle", "receive_own_messages"}),
        ("pcan", {"auto_reset", "state", "device_id", "f_clock", "tseg1"}),
        ("ixxat", {"unique_hardware_id", "extended", "rx_fifo_size"}),
        ("vector", {"app_name", "serial", "rx_queue_size"}),
        ("gs_usb", {"index", "bus", "address"}),
        ("slcan", {"tty_baudrate", "sleep_after_open", "timeout", "rtscts"}),
        ("socketcan", {"receive_own_messages", "local_loopback", "can_filters"}),
    ],
)
def test_options_hidden_in_keyword_arguments_are_found_without_the_driver(name: str, options: set[str]) -> None:
    accepted = _accepted_options(name)
    assert accepted is not None
    assert options <= accepted
    assert not accepted & {"self", "kwargs", "bitrate", "channel"}


def test_an_option_that_would_vanish_is_a_fault_with_its_place(tmp_path: Path) -> None:
    wrong = "bus: {interface: kvaser, channel: 0, rate: 1 kHz, options: {exclusiv: true}}"
    [fault] = faults(tmp_path, ("bus: {interface: virtual, rate: 1 kHz, rpdo: event}", wrong))
    assert fault.startswith("scene.yaml:2:")
    assert "bus.options: kvaser takes no option 'exclusiv'" in fault
    assert "did you mean 'exclusive'?" in fault


def test_a_key_of_the_bus_does_not_belong_into_its_options() -> None:
    assert interface_faults(bus(interface="pcan", options={"bitrate": 500_000})) == [
        ("options", "bitrate is a key of bus itself; give it there")
    ]


def test_an_unknown_interface_is_refused_with_the_nearest() -> None:
    [(key, message)] = interface_faults(bus(interface="socketcna"))
    assert key == "interface"
    assert "did you mean 'socketcan'?" in message
    [(_, message)] = interface_faults(bus(interface="can0"))
    assert message.endswith("; for Linux's can0 set interface: socketcan and channel: can0")


@pytest.mark.slow_but("pcan", "socketcan", "slcan", "ixxat")
@pytest.mark.parametrize("name", sorted(set(BACKENDS) - {"virtual", "udp_multicast"}))
def test_an_interface_without_driver_or_device_gives_one_error_of_ours(name: str) -> None:
    from canhaptic.drive.can.door import open_bus

    with pytest.raises(CanHapticError) as caught:
        open_bus(bus(interface=name), "nowhere0")
    message = str(caught.value)
    assert message.startswith(f"bus {name!r}, channel 'nowhere0': ")
    assert "\n" not in message
    remedies = tomllib.loads(_REMEDIES.read_text())
    if name in remedies:
        assert remedies[name].format(channel="nowhere0", bitrate=1_000_000) in message


@pytest.mark.parametrize(
    ("error", "kind", "words"),
    [
        (NameError("name 'canOpen' is not defined"), InputError, "its driver library is missing: name 'canOpen'"),
        (can.CanInterfaceNotImplementedError("no module"), InputError, "python-can cannot use it (no module)"),
        (TypeError("missing 'host'"), InputError, "correct bus.channel and bus.options"),
        (can.CanInitializationError("no device\nfound"), LinkError, "cannot be opened (no device found)"),
        (PermissionError(13, "Permission denied"), LinkError, "Permission denied"),
        (RuntimeError(), InputError, "python-can cannot use it (RuntimeError)"),
    ],
)
def test_each_kind_of_failure_is_told_apart(error: Exception, kind: type[CanHapticError], words: str) -> None:
    answer = opening_error(bus(interface="kvaser"), 0, error)
    assert type(answer) is kind
    assert words in str(answer)
    assert "install Kvaser's driver" in str(answer)
