"""Coverage-guided fuzzing of one reader: `python -m tools.fuzz TARGET [-runs=N]` (needs atheris, Linux or macOS).

For any bytes: a result or an error of the package, nothing else. The everyday tests do the same with hypothesis,
without looking at coverage.
"""

import importlib
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from canhaptic.errors import CanHapticError

_FOLDER: Final = Path(tempfile.gettempdir())
Target = Callable[[bytes], None]


def dictionary() -> Target:
    """EDS and DCF."""
    from canhaptic.canopen.eds import read_dictionary

    path = _FOLDER / "fuzzed.eds"

    def read(data: bytes) -> None:
        path.write_bytes(data)
        read_dictionary(path, 1 + len(data) % 127)

    return read


def scene() -> Target:
    """A scene file."""
    from canhaptic.scene.load import scene_from_text

    def read(data: bytes) -> None:
        scene_from_text(data.decode("utf-8", "replace"), "fuzzed.yaml")

    return read


def bus_log() -> Target:
    """Candump text, and what its frames say."""
    from canhaptic.logs.bus_reader import read_bus_log
    from canhaptic.logs.decoder import BusDecoder

    path = _FOLDER / "fuzzed.log"

    def read(data: bytes) -> None:
        path.write_bytes(data or b"\n")
        decoder = BusDecoder()
        for frame in read_bus_log(path):
            decoder.decode(frame.can_id, frame.data)

    return read


def sdo_client() -> Target:
    """Answers to an upload and to a download, 8 bytes each."""
    from canhaptic.drive.can import sdo
    from canhaptic.drive.can.sdo import ProtocolError

    def answer(data: bytes) -> None:
        for transfer in (sdo.upload(0x1008, 0), sdo.download(0x1008, 0, bytes(20))):
            next(transfer)
            with suppress(ProtocolError, StopIteration):
                for start in range(0, len(data) - 7, 8):
                    transfer.send(data[start : start + 8])

    return answer


def sdo_server() -> Target:
    """Requests to the simulated drive, 8 bytes each."""
    from canhaptic.canopen.eds import read_dictionary
    from canhaptic.sim.drive.can.sdo_server import SdoServer
    from canhaptic.sim.drive.profile.object_store import ObjectStore

    read = read_dictionary(Path(__file__).parents[1] / "eds" / "cia402_servo.eds", 5)

    def ask(data: bytes) -> None:
        server = SdoServer(ObjectStore(read, {}))
        for start in range(0, len(data), 8):
            server.answer(data[start : start + 8])

    return ask


TARGETS: Final = {
    "dictionary": dictionary,
    "scene": scene,
    "bus_log": bus_log,
    "sdo_client": sdo_client,
    "sdo_server": sdo_server,
}


def main() -> int:
    """Fuzzes until it is stopped; atheris itself ends the process, with 0 when nothing was found."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in TARGETS:
        sys.stderr.write(f"fuzz: got {name!r}, expected one of: {', '.join(TARGETS)}\n")
        return 2
    atheris = importlib.import_module("atheris")
    with atheris.instrument_imports(include=["canhaptic"]):
        target = TARGETS[name]()

    def run(data: bytes) -> None:
        with suppress(CanHapticError):
            target(data)

    atheris.Setup([sys.argv[0], *sys.argv[2:]], run)
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
