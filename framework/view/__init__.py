"""A run in the browser: one page with its Gaussians, cameras and photos, that needs nothing else.

`runs` reads a run's folder, `cameras` its cameras, `pack` makes its Gaussians small, `photos` the
pictures beside them, `page` writes the page down (the drawing is in `assets`), `server` shows it.
"""

from framework.view.page import view_page
from framework.view.runs import check_together, find_run, read_viewed

__all__ = ["check_together", "find_run", "read_viewed", "view_page"]
