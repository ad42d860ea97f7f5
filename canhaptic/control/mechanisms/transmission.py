"""A linear transmission: task coordinates are a matrix times the motor positions (gears, belts, differentials)."""

from collections.abc import Sequence

import numpy as np
from pydantic import model_validator

from canhaptic.control.mechanisms.kinematics import Limit, Pose
from canhaptic.control.mechanisms.workspace import FromPose, Rows, check_box, outside_box
from canhaptic.units import Parameters

_LEAST_RATIO = 1e-6


class Transmission(FromPose, Parameters):
    """x = A q + offset."""

    matrix: Rows
    """A, one row for each task coordinate, one column for each motor axis [m/rad, m/m, ...]."""
    offset: tuple[float, ...] | None = None
    """Task coordinates at motor positions 0."""
    workspace_lower: tuple[float, ...] | None = None
    """Least task coordinates [m or rad] of the workspace, beyond which nothing is rendered; None: no such limit."""
    workspace_upper: tuple[float, ...] | None = None
    """Largest task coordinates [m or rad] of the workspace; None: no such limit."""

    @model_validator(mode="after")
    def _regular(self) -> "Transmission":
        rows = self.matrix
        if not rows or not rows[0] or any(len(row) != len(rows[0]) for row in rows):
            raise ValueError(f"matrix: got rows of {[len(row) for row in rows]} entries, expected rows of equal length")
        if not np.all(np.isfinite(np.array(rows))):
            raise ValueError("matrix: got an entry that is not finite, expected finite numbers")
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
        check_box(self.workspace_lower, self.workspace_upper, len(rows))
        return self

    @property
    def axes(self) -> int:
        """Motor axes."""
        return len(self.matrix[0])

    @property
    def dimensions(self) -> int:
        """Of task space."""
        return len(self.matrix)

    def pose(self, positions: Sequence[float]) -> Pose:
        """Returns A q + offset and A."""
        values = []
        for index, row in enumerate(self.matrix):
            total = 0.0 if self.offset is None else self.offset[index]
            for a, q in zip(row, positions, strict=True):
                total += a * q
            values.append(total)
        outside = outside_box(values, self.workspace_lower, self.workspace_upper)
        return Pose(tuple(values), self.matrix, Limit.WORKSPACE.value if outside else 0)
