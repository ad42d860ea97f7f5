"""The scenes that several tests of sweeps share."""

from tests.study.sweep.conftest_sweep import demo, two_axes

__all__ = ["demo", "two_axes"]
