"""Load scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from framework.types import Scene


def load_scene(name: str, **options: Any) -> Scene:
    """Load a scene.

    Camera poses that do not fit the photos cause a logged warning, as in a run.

    Args:
        name: a loader, for instance `embedded`, `colmap`, `llff` or `photos`.
        options: options of the loader, for instance `path="DIR"` and `n_views=3`.

    Returns:
        The scene: `training.views` and `test` are tuples of views with `image` [3, H, W] in [0, 1]
        and `camera`. Training functions receive `training` only.

    Raises:
        UserError: The loader or an option is unknown, or the files are invalid.
    """
    from framework import registry
    from framework.run.poses import checked_poses
    from framework.run.preparation import loaded_scene

    registry.discover()
    chosen = {"name": name, **options}
    scene = loaded_scene(chosen)
    checked_poses(name, registry.part("scene", chosen), scene.training)
    return scene
