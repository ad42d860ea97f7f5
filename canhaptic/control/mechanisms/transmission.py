"""A linear transmission: task coordinates are a matrix times the motor positions (gears, belts, differentials)."""

from typing import NamedTuple

import numpy as np
from pydantic import model_validator

from canhaptic.control.mechanisms.kinematics import FromMechanism, Limit, WorkspaceBox, is_outside, workspace_box
from canhaptic.kernels import Buffer, Matrix
from canhaptic.units import Coordinates, Numbers, Parameters

_LEAST_RATIO = 1e-6
_WORKSPACE = Limit.WORKSPACE.value


class LinearMap(NamedTuple):
    """The map x = A q + offset; see `KinematicsKernel`."""

    matrix: Matrix
    offset: Buffer
    box: WorkspaceBox

    def locate(self, positions: Buffer, place: Buffer, jacobian: Matrix) -> int:
        """Compute A q + offset and the Jacobian A into the buffers; return whether a limit is reached (`Limit`)."""
        for i in range(len(place)):
            row, into, total = self.matrix[i], jacobian[i], self.offset[i]
            for j in range(len(row)):
                total += row[j] * positions[j]
                into[j] = row[j]
            place[i] = total
        return _WORKSPACE if is_outside(self.box, place) else 0


class Transmission(FromMechanism, Parameters):
    """Task coordinates x = A q + offset."""

    matrix: tuple[Numbers, ...]
    """A, one row for each task coordinate, one column for each motor axis [m/rad, m/m, ...]."""
    offset: Coordinates | None = None
    """Task coordinates at motor positions 0."""
    workspace_lower: Coordinates | None = None
    """Least task coordinates [m or rad] of the workspace, beyond which nothing is rendered; None: no such limit."""
    workspace_upper: Coordinates | None = None
    """Largest task coordinates [m or rad] of the workspace; None: no such limit."""

    @model_validator(mode="after")
    def _regular(self) -> "Transmission":
        rows = self.matrix
        if not rows or not rows[0] or any(len(row) != len(rows[0]) for row in rows):
            raise ValueError(f"matrix: got rows of {[len(row) for row in rows]} entries, expected rows of equal length")
        if len(rows) > len(rows[0]):
            raise ValueError(
                f"matrix: got {len(rows)} task coordinates for {len(rows[0])} motor axes, expected at most as many; "
                "the motors cannot render forces in all of them"
            )
        values = np.linalg.svd(np.array(rows), compute_uv=False)
        if not values[-1] > _LEAST_RATIO * values[0]:
            raise ValueError(
                f"matrix: singular, least singular value {values[-1]:g} of {values[0]:g}; expected independent rows"
            )
        if self.offset is not None and len(self.offset) != len(rows):
            raise ValueError(f"offset: got {len(self.offset)} entries, expected {len(rows)}")
        workspace_box(self.workspace_lower, self.workspace_upper, len(rows))
        return self

    @property
    def axes(self) -> int:
        """Number of motor axes."""
        return len(self.matrix[0])

    @property
    def dimensions(self) -> int:
        """Number of task coordinates."""
        return len(self.matrix)

    def mechanism(self) -> LinearMap:
        """Return the kinematic map that the kernels call."""
        offset = self.offset or (0.0,) * len(self.matrix)
        box = workspace_box(self.workspace_lower, self.workspace_upper, len(self.matrix))
        return LinearMap([list(row) for row in self.matrix], list(offset), box)
