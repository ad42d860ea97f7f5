"""The simulated drive's SDO server against an independent client: canopen's own, byte for byte, any length."""

from pathlib import Path

import pytest
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.canopen.eds import read_dictionary
from canhaptic.sim.drive.can.sdo_server import SdoServer
from canhaptic.sim.drive.profile.object_store import ObjectStore

TEXT = """\
[2000]
ParameterName=Recorder
ObjectType=0x2
DataType=0x000F
AccessType=rw
[2001]
ParameterName=Number
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=7
"""


class DirectClient(SdoClient):
    """canopen's client with the server at the other end of a function call."""

    def __init__(self, server: SdoServer) -> None:
        super().__init__(0x605, 0x585, ObjectDictionary())
        self.server = server
        self.requests: list[bytes] = []

    def send_request(self, request: bytes) -> None:
        self.requests.append(bytes(request))
        answer = self.server.answer(bytes(request))
        if answer is not None:
            self.responses.put(answer)


@pytest.fixture(scope="module")
def dictionary(tmp_path_factory: pytest.TempPathFactory) -> ObjectDictionary:
    path: Path = tmp_path_factory.mktemp("eds") / "recorder.eds"
    path.write_text(TEXT)
    return read_dictionary(path, 5)


def client(dictionary: ObjectDictionary, indicates_size: bool = True) -> DirectClient:
    return DirectClient(SdoServer(ObjectStore(dictionary, {}), indicates_size))


@given(st.binary(min_size=1, max_size=300), st.booleans())
def test_any_bytes_that_are_written_are_read_again(
    dictionary: ObjectDictionary, content: bytes, indicates_size: bool
) -> None:
    tried = client(dictionary, indicates_size)
    tried.download(0x2000, 0, content, force_segment=True)
    if indicates_size or len(content) > 4:
        assert tried.upload(0x2000, 0) == content
    else:  # an expedited answer without its length: what lies behind cannot be distinguished from the value
        assert tried.upload(0x2000, 0) == content.ljust(4, b"\0")


@pytest.mark.parametrize("length", [1, 4, 5, 6, 7, 8, 13, 14, 15, 21])
def test_the_last_segment_is_marked_at_every_length_around_its_size(dictionary: ObjectDictionary, length: int) -> None:
    tried = client(dictionary)
    content = bytes(range(1, length + 1))
    tried.download(0x2000, 0, content, force_segment=True)
    assert tried.upload(0x2000, 0) == content
    uploads = [request for request in tried.requests if request[0] & 0xE0 == 0x60]
    assert len(uploads) == (0 if length <= 4 else -(-length // 7))


@pytest.mark.parametrize(("mode", "first"), [("rb", 0xA4), ("wb", 0xC6)])
def test_a_block_transfer_is_refused_and_the_next_transfer_works(
    dictionary: ObjectDictionary, mode: str, first: int
) -> None:
    tried = client(dictionary)
    with pytest.raises(SdoAbortedError) as caught:
        tried.open(0x2000, 0, mode, size=100, block_transfer=True)
    assert caught.value.code == 0x05040001  # client or server command specifier not valid or unknown
    assert tried.requests[0][0] & 0xE0 == first & 0xE0
    assert tried.upload(0x2001, 0) == bytes([7, 0, 0, 0])


def test_a_block_client_that_goes_on_all_the_same_is_aborted_each_time(dictionary: ObjectDictionary) -> None:
    server = SdoServer(ObjectStore(dictionary, {}))
    for request in ("a4 00 20 00 7f 00 00 00", "a3 00 00 00 00 00 00 00", "a1 00 00 00 00 00 00 00"):
        answer = server.answer(bytes.fromhex(request))
        assert answer is not None
        assert answer[0] == 0x80
        assert int.from_bytes(answer[4:], "little") == 0x05040001
