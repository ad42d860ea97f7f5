"""Log paths of a scene: those outside its own folder and the current one are reported and overwrite nothing."""

from pathlib import Path

from canhaptic.errors import InputError
from canhaptic.scene.models import Scene


def logs_elsewhere(scene: Scene, *, energy: bool, bus: bool) -> list[str]:
    """Notes on logs that a scene itself puts outside its folder and the current one, one line each.

    A scene may come from somebody else: its log paths must not overwrite a file elsewhere.

    Args:
        scene: The scene.
        energy: Whether the scene's energy log is used, the user having named none.
        bus: Whether the scene's bus log is used.

    Raises:
        InputError: The file already exists.
    """
    homes = (Path.cwd().resolve(), Path(scene.source).resolve().parent)
    notes = []
    for key, path in (
        ("log.energy", scene.log.energy if energy else None),
        ("log.bus", scene.log.bus if bus else None),
    ):
        if path is None or any(path.resolve().is_relative_to(home) for home in homes):
            continue
        if path.exists():
            option = "--log" if key == "log.energy" else "--bus-log"
            raise InputError(
                f"{scene.source}: {key}: {path} already exists, outside the folder of the scene and the current one; "
                f"give {option} {path} --force to replace it"
            )
        notes.append(f"{key} of {scene.source} is outside its folder: {path}")
    return notes
