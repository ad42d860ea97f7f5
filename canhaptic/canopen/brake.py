"""Settings of a holding brake: who operates it, and how long it takes."""

from typing import Annotated, Literal

from pydantic import model_validator

from canhaptic.units import Parameters, quantity


class Brake(Parameters):
    """A holding brake, such as on a vertical axis."""

    by: Literal["drive", "host"] = "drive"
    """Who operates the brake: `drive`, which releases it when enabled and sets it when disabled, or `host`, through
    `output`."""
    output: Annotated[int, quantity("1", ge=0, le=31)] | None = None
    """Bit of the drive's digital outputs (0x60FE:01) that releases the brake; only with `by: host`."""
    release_time: Annotated[float, quantity("s", ge=0.0, le=5.0)]
    """Longest time until the brake is released; the controller sends no torque before."""
    set_time: Annotated[float, quantity("s", ge=0.0, le=1.0)]
    """Longest time until the brake holds; an operator's stop keeps the last torque for this long."""

    @model_validator(mode="after")
    def _has_an_output(self) -> "Brake":
        if (self.by == "host") != (self.output is not None):
            raise ValueError(f"output: got {self.output} with by: {self.by}, expected a bit only for by: host")
        return self
