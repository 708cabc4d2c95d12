"""Resolves names from files, which must stay inside their folder.

A scene from a stranger may name `../../private.png` as a photo, or contain a link to it; it would
end up in a published report.
"""

from __future__ import annotations

import os
from pathlib import Path

from framework.errors import UserError, require

OWN_VARIABLE = "FISHERSPLAT_PLUGINS"  # the folder of `--plugins`, for every process of a command
ENTRY_POINTS = "fishersplat.plugins"  # the group under which installed packages declare theirs
NAME_BYTES = 255  # of one part of a path, on the usual file systems


def inside(folder: Path, name: str | Path) -> Path:
    """`folder` / `name`, which need not exist.

    Raises:
        UserError: when the name is absolute or it (or a link on the way) leads out of the folder;
            the folder itself may be a link.
    """
    text = str(name)
    where = f"{folder}: expected names inside this folder, got {text[:100]!r}"
    parts = Path(text).parts
    require(
        "\0" not in text and len(parts) > 0 and not Path(text).is_absolute(),
        f"{where}; correct the name",
    )
    try:
        longest = max(len(part.encode("utf-8")) for part in parts)
    except UnicodeEncodeError:  # records and reports are UTF-8 and name it
        raise UserError(f"{where}, which is not UTF-8; rename the file") from None
    require(
        longest <= NAME_BYTES,
        f"{where}, of {longest} bytes where a file name has at most {NAME_BYTES}; correct it",
    )
    path = folder / name
    try:
        real, root = path.resolve(), folder.resolve()
    except (OSError, RuntimeError, UnicodeError) as error:  # links in a circle; half a character
        raise UserError(f"{where}, which cannot be followed; correct the name") from error
    require(
        real.is_relative_to(root),
        f"{where}, which leads out of it; copy the file into the folder",
    )
    return path


def own_plugins() -> list[tuple[str, Path]]:
    """The modules of the user's plugins: (relative path with slashes, file), sorted.

    They are the `.py` files of the folder that `OWN_VARIABLE` names and of its sub-folders. Files
    that begin with `_` are helpers: they are not imported as plugins, but belong to the code of a
    run.
    """
    folder = os.environ.get(OWN_VARIABLE)
    if not folder:
        return []
    files = [*Path(folder).glob("*.py"), *Path(folder).glob("*/*.py")]
    return sorted((file.relative_to(folder).as_posix(), file) for file in files if file.is_file())
