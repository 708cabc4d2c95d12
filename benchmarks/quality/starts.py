"""How good is the depth that a training starts from, and what would another guess change?

    python benchmarks/quality/starts.py --data DIR [--scenes fern,horns] [--seeds 0,1]
        [--guesses around,points,matches,nothing,true] [--steps 600] [--leave-one-out]
        [--output FILE.md]

Half-size photos of the scenes of `budgets.py`. First table: COLMAP's points of *all* photos, test
views too (a track of three photos or more, an error below 1.5 pixels), against the training views'
depth maps; scenes without such a model are left out. Second: test PSNR where pixels without
consistent depth begin on another guess. `around` is the default's, from the consistent pixels and
sparse points around (`framework/initialize/completion.py`); `points` interpolates inverse depth
between the sparse points that training views see, beyond them the nearest one's; `matches` the same
between points of the training photos alone (`matches.py`); `nothing` is `around` without any point;
`true` gives these pixels depth interpolated between COLMAP's points of all photos, which no
training may know.
`--leave-one-out` instead trains without each training photo in turn (six at most) and judges by it,
with depth and sparse points of the others alone: what a choice for a scene could go by.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import torch
from scipy.interpolate import griddata

from benchmarks.prepare import Prepared, prepared
from benchmarks.quality.budgets import SCENES
from benchmarks.quality.matches import matched_points
from framework import registry
from framework.compute import parallel
from framework.geometry import project
from framework.initialize import completion
from framework.initialize.fusion import Mapped
from framework.metrics.evaluate import psnr
from framework.run.training import renderer
from framework.types import DepthMap

FEWEST, LARGEST_ERROR = 3, 1.5  # photos of a track; pixels
MOST = 6  # photos that are left out in turn
WRONG = 0.05  # relative error of a depth
# of every training view: uv [P, 2] pixels, z [P], [P] how many training photos the track has
Points = list[tuple[np.ndarray, np.ndarray, np.ndarray]]


def model_of(folder: Path) -> Path | None:
    model = folder / "sparse" / "0"
    return model if (model / "points3D.bin").is_file() else None


def true_points(ready: Prepared, model: Path) -> Points:
    """COLMAP's points in the training views, with the depth in scene units."""
    import pycolmap

    found, views = pycolmap.Reconstruction(str(model)), ready.scene.training.views
    named = {Path(image.name).stem.lower(): image for image in found.images.values()}
    images = [named[Path(view.name).stem.lower()] for view in views]
    theirs = np.stack([image.projection_center() for image in images])
    ours = torch.stack([view.camera.center for view in views]).double().numpy()
    scale = np.linalg.norm(ours - ours.mean(0)) / np.linalg.norm(theirs - theirs.mean(0))
    points, training = [], {image.image_id for image in images}
    for view, image in zip(views, images, strict=True):
        size, camera = view.camera, found.cameras[image.camera_id]
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        uv, z, n = [], [], []
        for seen in image.points2D:
            point = found.points3D[seen.point3D_id] if seen.has_point3D() else None
            if point is None or point.track.length() < FEWEST or point.error > LARGEST_ERROR:
                continue
            uv.append(seen.xy * [size.width / camera.width, size.height / camera.height])
            z.append((pose * point.xyz)[2] * scale)
            n.append(len({e.image_id for e in point.track.elements} & training))
        places, depth = np.array(uv), np.array(z)
        kept = _inside(places, depth, size.width, size.height)
        points.append((places[kept], depth[kept], np.array(n)[kept]))
    return points


def _inside(uv: np.ndarray, z: np.ndarray, width: int, height: int) -> np.ndarray:
    kept: np.ndarray = (z > 0) & (uv >= 0).all(1) & (uv[:, 0] < width) & (uv[:, 1] < height)
    return kept


def between(uv: np.ndarray, z: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """[H, W] depth: inverse depth linear between the points, beyond them the nearest one's."""
    x, y = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    linear, nearest = (griddata(uv, 1 / z, (x, y), how) for how in ("linear", "nearest"))
    return np.asarray(1 / np.where(np.isnan(linear), nearest, linear))


def errors(ready: Prepared, points: Points) -> str:
    """The cells of the first table."""
    off, known, photos = [], [], []
    for (uv, z, n), found in zip(points, ready.depth, strict=True):
        column, row = uv.astype(int).T
        off.append(np.abs(found.depth.numpy()[row, column] / z - 1))
        known.append(found.confidence.numpy()[row, column] > 0)
        photos.append(np.minimum(n, 3))
    error, consistent, on = (np.concatenate(parts) for parts in (off, known, photos))
    tracks = (f"{(on == k).mean():.0%}, {consistent[on == k].mean():.0%}" for k in (1, 2, 3))
    return (
        f"{len(error):,} | {consistent.mean():.0%} | {np.median(error[consistent]):.1%} |"
        f" {(error[consistent] > WRONG).mean():.0%} | {(error[~consistent] > WRONG).mean():.0%} |"
        f" {' | '.join(tracks)}"
    )


def with_truth(ready: Prepared, points: Points) -> Prepared:
    """With true depth, as sure as the rest, where there was no consistent one."""
    maps = []
    for (uv, z, _), old in zip(points, ready.depth, strict=True):
        unknown = old.confidence <= 0
        truth = torch.from_numpy(between(uv, z, tuple(unknown.shape))).float()  # type: ignore[arg-type]
        usual = old.confidence[~unknown].median()
        confidence = torch.where(unknown, usual, old.confidence)
        maps.append(DepthMap(torch.where(unknown, truth, old.depth), confidence))
    return replace(ready, depth=tuple(maps))


def guess_between_points(maps: Mapped, v: int) -> np.ndarray:
    """In place of `completion._start`."""
    usual = AROUND(maps, v)
    view, points = maps.views[v], maps.training.points
    seen = points.xyz[points.visible[:, maps.order[v]]].to(torch.float64)
    uv, z = (values.numpy() for values in project(seen, view.camera))
    kept = _inside(uv, z, view.camera.width, view.camera.height)
    uv, z = uv[kept], z[kept]
    if len(uv) < 10:
        return usual
    return np.where(usual > 0, between(uv, z, usual.shape), 0.0)


AROUND = completion._start


def with_own_points(ready: Prepared, words: list[str], none: bool) -> Prepared:
    """With sparse points from the training photos alone, at the size they have, or with none."""
    full = prepared([word for word in words if not word.startswith("scene.downscale")])
    own = matched_points(full.scene.training)
    print(f"{len(own.xyz)} points of the training photos alone", flush=True)
    if none:
        own = replace(own, xyz=own.xyz[:0], rgb=own.rgb[:0], visible=own.visible[:0])
    training = replace(ready.scene.training, points=own)
    return replace(ready, scene=replace(ready.scene, training=training))


def result(ready: Prepared) -> float:
    """Mean test PSNR of a training."""
    trained, near = ready.trained(), ready.config["trainer"]["near_plane"]
    near *= ready.scene.training.near
    render = renderer(trained.gaussians, trained.background, trained.sh_degree, near)
    return statistics.mean(
        float(psnr(render(view.camera), view.image, view.mask))  # type: ignore[arg-type]
        for view in ready.scene.test
    )


def without(ready: Prepared, photo: int) -> Prepared:
    """As if training photo number `photo` were the only test view, and unknown to the start."""
    scene = ready.scene
    known, points = scene.training, scene.training.points
    kept = [v for v in range(len(known.views)) if v != photo]
    both = points.visible[:, kept].sum(1) >= 2
    fewer = replace(
        points, xyz=points.xyz[both], rgb=points.rgb[both], visible=points.visible[both][:, kept]
    )
    training = replace(known, views=tuple(known.views[v] for v in kept), points=fewer)
    depth = registry.part("depth", ready.config["depth"]).estimate(training)
    return Prepared(
        ready.config, replace(scene, training=training, test=(known.views[photo],)), depth
    )


def left_out(ready: Prepared, name: str) -> str:
    """A row: PSNR of each photo from the others, and what `points` changes of it."""
    photos, changes = len(ready.scene.training.views), []
    for i in range(min(photos, MOST)):
        fold, psnrs = without(ready, i * photos // min(photos, MOST)), []
        for start in (AROUND, guess_between_points):
            with patch.object(completion, "_start", start):
                psnrs.append(result(fold))
        changes.append(psnrs[1] - psnrs[0])
    told = ", ".join(f"{change:+.2f}" for change in changes)
    return f"| {name} | {told} | {statistics.mean(changes):+.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--scenes", default="fern,door,scan24,horns,room")
    parser.add_argument("--guesses", default="around,points,true")
    parser.add_argument("--seeds", default="0,1")
    parser.add_argument("--steps", default="600")
    parser.add_argument("--leave-one-out", action="store_true")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    parallel.set_threads(1)
    guesses = given.guesses.split(",")
    heads = "scene, views", "points", "consistent", "median error of these", "off by over 5 %"
    heads += "others, off by over 5 %", "on 1 training photo, consistent of these", "on 2", "on 3"
    depth = [f"| {' | '.join(heads)} |", "|---|" + "---:|" * (len(heads) - 1)]
    psnrs = ["| scene, views | " + " | ".join(guesses) + " |", "|---|" + "---:|" * len(guesses)]
    folds = ["| scene, views | of each photo, `points` against `around` | mean |", "|---|---|---:|"]
    for scene in given.scenes.split(","):
        place = SCENES[scene]
        words = place.words.format(given.data).split()
        words += [f"scene.n_views={place.views}", "scene.downscale=2", "threads=1"]
        words += [f"trainer.steps={given.steps}", "trainer.evaluations=1"]
        model = model_of(Path(words[1].removeprefix("scene.path=")))
        found: dict[str, list[float]] = {guess: [] for guess in guesses}
        name, points = f"{place.bold(scene)}, {place.views}", None
        if given.leave_one_out:
            folds.append(left_out(prepared([*words, "seed=0"]), name))
            print(folds[-1], flush=True)
            continue
        for seed in given.seeds.split(","):
            ready = prepared([*words, f"seed={seed}"])
            if model is not None and points is None:
                points = true_points(ready, model)
                depth.append(f"| {name} | {errors(ready, points)} |")
                print(depth[-1], flush=True)
            for guess in guesses:
                if guess == "true" and points is None:
                    continue
                other = ready
                if guess == "true":
                    other = with_truth(ready, points or [])
                elif guess in ("matches", "nothing"):
                    other = with_own_points(ready, words, none=guess == "nothing")
                start = guess_between_points if guess in ("points", "matches") else AROUND
                with patch.object(completion, "_start", start):
                    found[guess].append(result(other))
        cells = (
            f"{statistics.mean(v):.2f}" + (f" ± {statistics.stdev(v):.2f}" if len(v) > 1 else "")
            if v
            else "-"
            for v in found.values()
        )
        psnrs.append(f"| {name} | {' | '.join(cells)} |")
        print(psnrs[-1], flush=True)
    text = "\n".join(folds if given.leave_one_out else [*depth, "", *psnrs]) + "\n"
    print(text)
    if given.output:
        given.output.write_text(text)


if __name__ == "__main__":
    main()
