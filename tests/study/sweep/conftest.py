"""The scenes that several tests of sweeps share."""

from conftest_sweep import demo, two_axes

__all__ = ["demo", "two_axes"]
