"""A classic data frame with an 11-bit identifier: the only kind that master and simulated drives send."""

import can


class DataFrame(can.Message):
    """A message of python-can in which only identifier, data and time differ from frame to frame.

    Everything else belongs to the class: a frame is made and filled for less than the constructor of `Message` costs.
    The sender fills all five slots, hands it over, and neither changes nor sends it again, so that a bus inside
    the process need not copy it.
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
