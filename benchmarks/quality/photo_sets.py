"""How many sets of three to five photos `scene=photos` places correctly, with SIFT and networks.

    python benchmarks/quality/photo_sets.py DATA --output benchmarks/results/photo_sets.md

DATA is the folder of the scenes. The sets are random draws of the photos of a scene with known
poses. A set is placed correctly if all its photos are. A photo is, if its rotation error is below 2
degrees and its position error below 5 % of the cameras' extent, after the best similarity (see
`photos.py`).
The same sets are searched with `scene.matching=sift` and `learned`, which needs
`fishersplat fetch matching`. Results are also appended to `--records`, and not computed again.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.quality.photos import Cameras, cameras, children_s, errors
from framework.compute import parallel
from framework.errors import UserError
from framework.records.provenance import cpu_model
from framework.scenes.llff import Llff
from framework.scenes.photos.options import LEARNED, SIFT
from framework.scenes.photos.process import run_child
from framework.scenes.photos.result import read_result
from framework.scenes.photos.source import find_source

SCENES = {
    "fern": "llff_fern",
    "horns": "llff_horns",
    "room": "llff_room",
    "door": "lund_door",
    "fountain": "strecha_fountain",
    "fox": "nerf_fox",
}
SIZES, SETS = (3, 4, 5), 10
DEGREES, PERCENT = 2.0, 5.0


def known_cameras(folder: Path) -> Cameras:
    """The known cameras of a scene, by the photos' names."""
    if not (folder / "poses_bounds.npy").is_file():
        return cameras(folder / "sparse" / "0")
    listed = Llff(str(folder), images="images", n_views="all", split="none").listing(folder)
    photos = [listed.photo_at(i) for i in range(len(listed.viewmats))]
    return {photo.file.name: (photo.viewmat, photo.lens.fx / photo.lens.width) for photo in photos}


def draws(names: list[str], scene: str, size: int) -> list[list[str]]:
    """Different random sets of photos, the same in every run."""
    random = np.random.default_rng([size, len(scene), sum(scene.encode())])
    sets: list[list[str]] = []
    while len(sets) < SETS:
        chosen = sorted(random.choice(names, size, replace=False).tolist())
        if chosen not in sets:
            sets.append(chosen)
    return sets


def searched(folder: Path, names: list[str], reference: Cameras, matching: str) -> dict[str, Any]:
    """Search for the poses of these photos and compare them with the known ones."""
    with tempfile.TemporaryDirectory() as work:
        photos, poses = Path(work, "photos"), Path(work, "poses")
        photos.mkdir()
        poses.mkdir()
        for name in names:
            shutil.copyfile(folder / "images" / name, photos / name)
        before = children_s()
        try:
            run_child(find_source(str(photos), side=1200, frames=40, matching=matching), poses)
        except UserError as error:
            if "its process ended" in str(error):  # a defect, not photos that do not fit
                raise
            return {"placed": 0, "cpu_s": children_s() - before, "message": str(error)[:200]}
        result = read_result(poses)
        wrong = errors(cameras(poses / "sparse" / "0"), reference)
        return {
            "placed": len(result.placed),
            "cpu_s": children_s() - before,
            "tries": len(result.tries),
            "degrees": float(wrong.degrees.max()),
            "percent": float(wrong.percent.max()),
        }


def is_correct(row: pd.Series[Any]) -> bool:
    """Whether all photos of a set are placed correctly."""
    return bool(row.placed == row.photos and row.degrees < DEGREES and row.percent < PERCENT)


def table(rows: pd.DataFrame) -> str:
    """Correct sets and median CPU seconds, by scene and number of photos."""
    rows = rows.assign(correct=rows.apply(is_correct, axis=1))
    lines = ["| scene | photos | SIFT | learned | CPU s, SIFT | CPU s, learned |"]
    lines.append("|---|---:|---:|---:|---:|---:|")
    total = rows.assign(scene="**all**")
    for (scene, size), group in pd.concat([rows, total]).groupby(["scene", "photos"], sort=False):
        parts = [group[group.matching == matching] for matching in (SIFT, LEARNED)]
        cells = [f"{part.correct.sum()} of {len(part)}" for part in parts]
        cells += [f"{part.cpu_s.median():.1f}" for part in parts]
        lines.append(f"| {scene} | {size} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def comparison(rows: pd.DataFrame) -> str:
    """All sets together, with the exact sign test of those that only one matching places."""
    correct = rows.assign(correct=rows.apply(is_correct, axis=1)).pivot(
        index=["scene", "photos", "number"], columns="matching", values="correct"
    )
    sift, learned = correct[SIFT].astype(bool), correct[LEARNED].astype(bool)
    only = [int((sift & ~learned).sum()), int((learned & ~sift).sum())]
    p = binomtest(only[0], sum(only)).pvalue if sum(only) else 1.0
    misplaced = rows[(rows.placed == rows.photos) & ~rows.apply(is_correct, axis=1)]
    wrong = misplaced.matching.value_counts()
    return (
        f"SIFT places {sift.sum()} of {len(correct)} sets correctly, the networks {learned.sum()}."
        f" Sets that only SIFT places: {only[0]}, only the networks: {only[1]} (exact sign test,"
        f" p = {p:.2g}). Sets with all photos placed, but wrongly: {wrong.get(SIFT, 0)} with SIFT,"
        f" {wrong.get(LEARNED, 0)} with the networks.\n"
    )


def main() -> None:
    """Search all sets, print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("data", type=Path)
    parser.add_argument("--records", type=Path, default=Path("photo_sets.jsonl"))
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    parallel.set_threads(1)
    lines = options.records.read_text().splitlines() if options.records.is_file() else []
    rows = [json.loads(line) for line in lines]
    done = {(row["scene"], row["photos"], row["number"], row["matching"]) for row in rows}
    for scene, folder in SCENES.items():
        reference = known_cameras(options.data / folder)
        names = sorted(
            name for name in reference if (options.data / folder / "images" / name).is_file()
        )
        for size in SIZES:
            for number, chosen in enumerate(draws(names, scene, size)):
                for matching in (SIFT, LEARNED):
                    if (scene, size, number, matching) in done:
                        continue
                    row = {"scene": scene, "photos": size, "number": number, "matching": matching}
                    row |= searched(options.data / folder, chosen, reference, matching)
                    rows.append(row)
                    with options.records.open("a") as file:
                        file.write(json.dumps(row) + "\n")
        print(table(pd.DataFrame(rows)), flush=True)
    if options.output is not None:
        command = "`python benchmarks/quality/photo_sets.py DATA`"
        text = f"# Small sets of photos placed correctly\n\n{command} on {cpu_model()}. "
        text += f"{SETS} random sets each; correct: all photos within {DEGREES:g} degrees and"
        text += f" {PERCENT:g} % of the cameras' extent.\n\n"
        text += f"{table(pd.DataFrame(rows))}\n{comparison(pd.DataFrame(rows))}"
        options.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
