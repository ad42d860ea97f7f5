"""pytest's fixture `canhaptic_replay`: a test replays a recorded bus, and fails as `canhaptic replay` does.

def test_press_and_release(canhaptic_replay):
    canhaptic_replay("recordings/press_and_release.log", "rig.yaml")
"""

from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def canhaptic_replay() -> Callable[..., Any]:
    """Return a function that replays a bus log, and fails the test where `canhaptic replay` would end with 1.

    Its arguments: the bus log; the scene, by default the one next to the log; `changes`, values of the scene to
    replace; `allow_empty`, whether a recording without torque passes; `keys`, whether each key is tried;
    `allow_code` as for `load_scene`. It returns the result of the replay, with what it covers under `covers`.
    """
    from canhaptic.simulation import load_any

    def replay(
        bus_log: str | PathLike[str],
        scene: str | PathLike[str] | None = None,
        changes: Mapping[str, object] | None = None,
        *,
        allow_empty: bool = False,
        keys: bool = True,
        allow_code: bool = False,
    ) -> dict[str, Any]:
        from canhaptic.audit.replay_coverage import covered, scene_next_to
        from canhaptic.cli.replay import replay_text, why_failed
        from canhaptic.replay import replay_bus_log

        loaded = load_any(scene_next_to(Path(bus_log)) if scene is None else scene, changes or {}, allow_code)
        result = replay_bus_log(Path(bus_log), loaded)
        covers = covered(result, loaded, keys=keys)
        if faults := why_failed(result, covers, allow_empty=allow_empty):
            pytest.fail(replay_text(result, covers, faults), pytrace=False)
        return {**result, "covers": covers}

    return replay
