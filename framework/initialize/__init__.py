"""The Gaussians a training starts from, and the background colour behind them.

`INITIALIZERS` maps the name in `init=...` to a frozen dataclass of options with

    build(training, depth, sh_degree, seed) -> Gaussians

where depth holds one map per training view. Importing this package is light (no torch), because
`--help` lists the options.
"""

from framework.initialize.sparse import Sparse
from framework.initialize.stereo import Stereo

INITIALIZERS: dict[str, type] = {"stereo": Stereo, "sparse": Sparse}
