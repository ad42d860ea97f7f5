"""The scenes that several tests of sweeps share."""

from tests.lab.sweep.conftest_sweep import demo, two_axes

__all__ = ["demo", "two_axes"]
