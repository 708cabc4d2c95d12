"""joblib's workers, which end with their command from their first moment on.

A run watches the command that it belongs to (`framework.compute.orphans`). A worker that has had no
run yet does not, and where the command is killed while it sends the first one, the worker waits for
the rest of it for ever: it holds the other end of that pipe itself.
"""

from __future__ import annotations

from typing import Any

from framework.compute.orphans import end_with_parent


def watch_workers() -> None:
    """Let every worker that joblib starts from now on watch this process. Safe to call again."""
    from joblib.parallel import LokyBackend, register_parallel_backend

    class Watching(LokyBackend):  # type: ignore[misc]
        def configure(self, *args: Any, **options: Any) -> int:
            workers: int = super().configure(*args, initializer=end_with_parent, **options)
            return workers

    register_parallel_backend("loky", Watching)
