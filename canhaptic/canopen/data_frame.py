"""CAN data frame with an 11-bit identifier, the only kind that master and simulated drives send."""

import can


class DataFrame(can.Message):
    """A python-can message whose constant fields are class attributes, so that creating one takes less time.

    The sender fills all five slots, sends the frame once, and never changes it; a bus within the process need not copy
    it.
    """

    __slots__ = ()
    __init__ = object.__init__

    is_extended_id = False
    is_remote_frame = False
    is_error_frame = False
    is_fd = False
    is_rx = True  # as who takes it sees it
    bitrate_switch = False
    error_state_indicator = False
