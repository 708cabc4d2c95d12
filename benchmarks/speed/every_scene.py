"""Wall time from the start of Python to the end of the report, and quality, on several scenes.

    python benchmarks/speed/every_scene.py --scene "scene=embedded" \\
        --scene "scene=llff scene.path=DIR scene.n_views=3" +augment=safi +reg=uar preset=fast

Every run is a fresh process with the words of a `--scene` and the others, as in `end_to_end.py`,
whose stages are added up here. Medians over the runs. The machine should be idle. Writes a markdown
table to `--output`, or prints it.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import statistics
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.speed.end_to_end import END, REPORT, REST, STAGES, START, profile
from framework.records.provenance import cpu_model

BEFORE = {"scene", "depth, while kernels load", "initial Gaussians"}
TRAINING = {stage for stage in STAGES if stage.startswith("training")}
GROUPS = {
    "Python, libraries": {START},
    "scene, depth, initial Gaussians": BEFORE,
    "training": TRAINING,
    "tests, files, report": {*STAGES, REST, REPORT, END} - BEFORE - TRAINING,
}


def short(scene: str) -> str:
    """The name of a row: the folder of the scene, or its layout, the number of views, the rest."""
    folder = re.search(r"path=\S*?([^/\s]+)/?(?:\s|$)", scene)
    layout = re.search(r"scene=(\S+)", scene)
    views = re.search(r"n_views=(\d+)", scene)
    name = folder[1] if folder else layout[1] if layout else scene
    shown = ("scene=", "scene.path=", "scene.n_views=")
    rest = [word for word in scene.split() if not word.startswith(shown)]
    return " ".join([f"{name}, {views[1]} views" if views else name, *rest])


def measured(scene: str, words: list[str], runs: int) -> list[str]:
    """A row of the table."""
    line = [*scene.split(), *words]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        profile(folder, [*line, "trainer.steps=10"])  # kernels are cached, and files read once
        seconds = [profile(folder, line) for _ in range(runs)]
        record = json.loads((folder / "run" / "record.json").read_text())
        with (folder / "run" / "metrics.csv").open(newline="") as file:
            # a view without a PSNR has none of its pixels masked in, or not one that differs
            views = {r["view"]: float(r["psnr"]) for r in csv.DictReader(file) if r["psnr"]}
    total = statistics.median(run["total"] for run in seconds)
    parts = [
        statistics.median(sum(run.get(stage, 0.0) for stage in stages) for run in seconds)
        for stages in GROUPS.values()
    ]
    worst = min(views, key=lambda view: views[view])
    return [
        short(scene),
        f"{record['gaussians']:,}",
        f"{record['summary']['psnr']['mean']:.2f}",
        f"{views[worst]:.2f} ({worst}, of {len(views)})",
        *(f"{part:.1f}" for part in parts),
        f"**{total:.1f}**",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", action="append", required=True)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--output", type=Path)
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_args()
    rows = [measured(scene, options.overrides, options.runs) for scene in options.scene]
    header = ["scene", "Gaussians", "test PSNR", "worst view", *GROUPS, "all seconds"]
    separator = ",\n"  # an expression of an f-string may hold no backslash in Python 3.11
    names = [f'`--scene "{re.sub(r"path=[^ ]+", "path=DIR", scene)}"`' for scene in options.scene]
    text = "\n".join(
        [
            "# Scenes from end to end",
            "",
            f"`python benchmarks/speed/every_scene.py --runs {options.runs}"
            f" {' '.join(options.overrides)}` on {cpu_model()}, with\n{separator.join(names)}.",
            "",
            *(f"| {' | '.join(cells)} |" for cells in (header, ["---", *["---:"] * 8], *rows)),
            "",
        ]
    )
    print(text)
    if options.output:
        options.output.write_text(text)


if __name__ == "__main__":
    main()
