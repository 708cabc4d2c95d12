"""How many of a run's Gaussians does the gradient of one photo reach?

    python benchmarks/speed/reached.py RUN...

RUN: folders of finished runs, made from this folder, as scenes are read again. Adam moves every
Gaussian in every step. An optimizer that leaves out those without a gradient (Taming 3DGS, Mallick
et al. 2024) saves what is printed here as not reached: of each training photo the share of
Gaussians that it sees, of those with a gradient, and of blocks of sixteen, as the kernels take
them, of which one has a gradient. At the photo's full size, with the run's own loss.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework import registry
from framework.exports.opened import open_run
from framework.records.record import RECORD, read_record
from framework.train.epoch import Items
from framework.train.gradient import screen_gradient

LANES = 16


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    for folder in parser.parse_args().runs:
        run, config = open_run(folder), read_record(folder / RECORD).config
        scene = registry.part("scene", config["scene"]).load()
        n, items = len(run.gaussians), Items()
        print(f"{folder.name}: {n} Gaussians, SH of degree {run.gaussians.sh_degree}")
        for view in scene.training.views:
            item = items.get(view, 1)
            how = (run.gaussians, item, view.name, config["trainer"]["ssim_weight"])
            found = screen_gradient(*how, background=run.background, near=run.near)[1]
            seen = float((found.radii > 0).float().mean())
            pulled = found.pull_back()[0]["opacity_logits"] != 0
            whole = pulled[: n - n % LANES].reshape(-1, LANES).any(1)
            shares = (seen, float(pulled.float().mean()), float(whole.float().mean()))
            print(f"  {view.name}: seen, pulled, blocks: " + ", ".join(f"{s:.3f}" for s in shares))


if __name__ == "__main__":
    main()
