"""How many examples a property test draws: all of them in `make test-all`, a part in `make test`."""

from hypothesis import settings

_THOROUGH = 100  # examples of the profile `thorough`, which is hypothesis' own default


def examples(thorough: int) -> int:
    """Returns the examples to draw under the profile that is loaded.

    Args:
        thorough: Examples under the profile `thorough`; another profile draws the part that it draws of 100.
    """
    return max(5, thorough * settings.default.max_examples // _THOROUGH)
