"""Names from files: they stay inside the folder they belong to.

A scene from elsewhere may name `../../private.png` as a photo, or hold a link to it; it would end
up in a report that is published.
"""

from __future__ import annotations

from pathlib import Path

from framework.errors import UserError, require


def inside(folder: Path, name: str | Path) -> Path:
    """`folder` / `name`, which need not exist. Raises UserError when the name is absolute or it (or
    a link on the way) leads out of the folder; the folder itself may be a link."""
    text = str(name)
    where = f"{folder}: expected names inside this folder, got {text[:100]!r}"
    require(
        "\0" not in text and text != "" and not Path(text).is_absolute(),
        f"{where}; correct the name",
    )
    path = folder / name
    try:
        real, root = path.resolve(), folder.resolve()
    except (OSError, RuntimeError) as error:  # links in a circle; a name too long for the system
        raise UserError(f"{where}, which cannot be followed; correct the name") from error
    require(
        real.is_relative_to(root),
        f"{where}, which leads out of it; copy the file into the folder",
    )
    return path
