"""A run in the browser: one self-contained page with its Gaussians, cameras and photos.

`runs` reads a run's folder. `pack` compresses the Gaussians and `photos` the photos. `page` makes
the page, whose renderer is in `assets`; `server` serves it.
"""
