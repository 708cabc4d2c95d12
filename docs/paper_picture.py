"""Draw the findings' picture: what every method gains under the paper's conditions, by scene.

    python docs/paper_picture.py [docs/images/paper.png]

From the tables of the committed reports; intervals are theirs, for all nine comparisons at once.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from matplotlib.figure import Figure

COMMITTED = Path(__file__).resolve().parents[1] / "reports" / "committed"
STUDIES = {"fern": "paper_fern", "scan 65": "paper_scan65"}
NAMES = {  # method in the tables -> in words, top to bottom
    "none + uniform": "uniform dropout",
    "none + dropgaussian": "DropGaussian",
    "none + uar_hard": "UAR, hard",
    "none + uar": "UAR",
    "dba + none": "DBA: the nearest photo",
    "euclidean + none": "near photos",
    "full_set + none": "all photos",
    "safi + none": "SAFI",
    "safi + uar": "SAFI + UAR",
}
PAPERS = ("UAR, hard", "UAR", "SAFI", "SAFI + UAR")  # the paper's own methods, in colour
OWN, OTHER = "#0f9b7a", "#44546a"


def differences(study: str) -> dict[str, tuple[float, float, float]]:
    """Method -> (difference, low, high) in dB."""
    with (COMMITTED / study / "differences.csv").open(encoding="utf-8", newline="") as table:
        return {
            row["method"]: (float(row["difference_db"]), float(row["low"]), float(row["high"]))
            for row in csv.DictReader(table)
            if row["interval"] == "all comparisons at once"
        }


def draw(out: Path) -> None:
    """Write the picture, a panel for each scene."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panels = figure.subplots(1, len(STUDIES), sharey=True)
    for panel, (scene, study) in zip(panels, STUDIES.items(), strict=True):
        found = differences(study)
        for place, (method, name) in enumerate(NAMES.items()):
            middle, low, high = found[method]
            colour = OWN if name in PAPERS else OTHER
            panel.plot([low, high], [place, place], color=colour, linewidth=2)
            filled = colour if low > 0 or high < 0 else "white"
            panel.plot(middle, place, "o", color=colour, markerfacecolor=filled, markersize=7)
        panel.axvline(0, color="black", linewidth=1)
        panel.set_title(scene)
        panel.set_xlabel("test PSNR above plain training (dB)")
        panel.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(NAMES)), list(NAMES.values()))
    panels[0].invert_yaxis()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=100)


if __name__ == "__main__":
    default = Path(__file__).parent / "images" / "paper.png"
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
