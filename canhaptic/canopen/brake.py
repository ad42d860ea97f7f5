"""The holding brake of an axis: who operates it, and its times."""

from typing import Annotated, Literal

from pydantic import model_validator

from canhaptic.units import Parameters, quantity


class Brake(Parameters):
    """A holding brake, such as on a vertical axis."""

    by: Literal["drive", "host"] = "drive"
    """drive: it opens and sets the brake itself when it is enabled and disabled; host: by `output`."""
    output: Annotated[int, quantity("1", ge=0, le=31)] | None = None
    """Bit of the drive's digital outputs (0x60FE:01) that opens the brake."""
    release_time: Annotated[float, quantity("s", ge=0.0, le=5.0)]
    """Longest time until it is open; no torque of the controller counts before."""
    set_time: Annotated[float, quantity("s", ge=0.0, le=1.0)]
    """Longest time until it holds; the operator's stop keeps the last torque for as long."""

    @model_validator(mode="after")
    def _has_an_output(self) -> "Brake":
        if (self.by == "host") != (self.output is not None):
            raise ValueError(f"output: got {self.output} with by: {self.by}, expected a bit only for by: host")
        return self
