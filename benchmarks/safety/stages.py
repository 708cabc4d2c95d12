"""What every stage computes, as one SHA-256 each, printed as JSON; `determinism.py` compares them.

Small, so that it also runs in the suite: the embedded scene and photos of another one, depth,
initial Gaussians, trainings with plugins of every group, metrics. Only when it is named,
`plugins`: a training with each plugin there is.

    python benchmarks/safety/stages.py [STAGE ...]
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

SCENE = {"width": 96, "height": 72, "supersampling": 2}
DEPTHS = {
    "plane sweep": {"name": "plane_sweep", "planes": 48},
    "noise": {"name": "ground_truth", "corruption": "noise"},
    "bias": {"name": "ground_truth", "corruption": "bias"},
    "blur": {"name": "ground_truth", "corruption": "blur"},
    "holes": {"name": "ground_truth", "corruption": "holes"},
}
TRAININGS: dict[str, list[str]] = {
    "plain": ["reg=none", "augment=none", "capacity=fixed"],
    "safi, uar, evidence, SH 1": [
        "augment=safi",
        "reg=uar",
        "capacity=evidence",
        "trainer.sh_degree=1",
    ],
    "dba, uniform, adc": ["augment=dba", "reg=uniform", "capacity=adc_short"],
    "full_set, dropgaussian, budget": ["augment=full_set", "reg=dropgaussian", "capacity=budget"],
    "euclidean, uar_hard, fisher_prune": [
        "augment=euclidean",
        "reg=uar_hard",
        "capacity=fisher_prune",
    ],
    "second camera": [
        "augment=none",
        "reg=uar",
        "trainer.pace_steps=0",
        "trainer.binocular_from=0",
    ],
    "two members": [
        *("augment=none", "reg=none", "trainer.members=2", "trainer.tuning=0.2"),
        "trainer.kept=0",
    ],
    "a student": ["augment=none", "reg=none", "trainer.members=2", "trainer.tuning=0.2"],
}
COMMON = (
    *(f"scene.{key}={value}" for key, value in SCENE.items()),
    *("trainer.steps=20", "threads=2"),
    "metrics.lpips_weights=none",  # whatever the user has fetched
)


def digest(parts: Iterable[Any]) -> str:
    """Hash arrays, tensors, texts, numbers and bytes in their order."""
    import numpy as np

    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, (str, int, float, type(None))):
            total.update(repr(part).encode())
        elif isinstance(part, bytes):
            total.update(part)
        else:
            array = np.ascontiguousarray(part)
            total.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return total.hexdigest()


def _of_scene(scene: Any) -> Iterable[Any]:
    for view in (*scene.training.views, *scene.test):
        yield from (view.name, view.image, view.camera.viewmat, view.camera.K)
        yield from () if view.mask is None else (view.mask,)
    yield from (scene.training.near, scene.training.far, scene.training.extent)
    points = scene.training.points
    yield from () if points is None else (points.xyz, points.rgb)


def scene(folder: Path) -> dict[str, str]:
    """The embedded scene, with every option that computes."""
    kinds: dict[str, dict[str, Any]] = {
        "plain": {},
        "changed": {"gloss": 0.5, "texture": 0.5, "pose_noise": 1.0, "spread": 0.5},
    }
    return {f"scene {kind}": digest(_of_scene(_embedded(more))) for kind, more in kinds.items()}


def photos(folder: Path) -> dict[str, str]:
    """PNG and JPEG photos through a lens and a box filter, with a PLY of points."""
    import numpy as np
    from PIL import Image

    from framework import registry
    from framework.compute.rng import stream

    hashes = {}
    for suffix in ("png", "jpg"):
        where = folder / suffix
        where.mkdir()
        frames = []
        for k in range(9):
            small = stream(k, "stages").integers(0, 256, (13, 17, 3), dtype=np.uint8)
            Image.fromarray(small.repeat(8, 0).repeat(8, 1)).save(where / f"im{k}.{suffix}")
            pose = np.eye(4)
            pose[0, 3], pose[1, 3] = 0.1 * k, 0.05 * k
            frames.append({"file_path": f"im{k}.{suffix}", "transform_matrix": pose.tolist()})
        lens = {"fl_x": 120.0, "fl_y": 121.0, "cx": 68.0, "cy": 52.5, "w": 136, "h": 104}
        lens |= {"k1": 0.05, "k2": -0.01, "p1": 0.001, "p2": -0.002}
        (where / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
        options = {"path": str(where), "n_views": 3, "downscale": 2, "near": 1.0, "far": 9.0}
        loader = registry.part("scene", {"name": "transforms", **options})
        hashes[f"photos {suffix}"] = digest(_of_scene(loader.load()))
    return hashes


def _embedded(options: dict[str, Any]) -> Any:
    from framework import registry

    return registry.part("scene", {"name": "embedded", **SCENE, **options}).load()


def _training() -> Any:
    return _embedded({}).training


def depth(folder: Path) -> dict[str, str]:
    """Depth maps by stereo and with every corruption."""
    from framework import registry

    hashes = {}
    for kind, options in DEPTHS.items():
        maps = registry.part("depth", options).estimate(_training())
        parts = [x for m in maps for x in (m.depth, m.confidence)]
        hashes[f"depth {kind}"] = digest(parts)
    return hashes


def init(folder: Path) -> dict[str, str]:
    """Initial Gaussians of every built-in initializer."""
    from framework.depth.providers import PlaneSweep
    from framework.initialize import Sparse, Stereo

    training, hashes = _training(), {}
    maps = PlaneSweep(planes=48).estimate(training)
    for name, builder in (("stereo", Stereo()), ("sparse", Sparse())):
        gaussians = builder.build(training, maps, 1, 0)
        hashes[f"init {name}"] = digest(x for _, x in gaussians.items())
    return hashes


def training(folder: Path) -> dict[str, str]:
    """Hash the files of whole runs, without times and facts about the machine."""
    import fishersplat

    hashes = {}
    for k, (kind, options) in enumerate(TRAININGS.items()):
        run = folder / f"run{k}"
        fishersplat.run(*COMMON, "depth.planes=48", *options, folder=run, quiet=True)
        hashes[f"training {kind}"] = digest([(run / "point_cloud.ply").read_bytes()])
        hashes[f"run {kind}"] = digest(_of_run(run))
    return hashes


def plugins(folder: Path) -> dict[str, str]:
    """A short training with each plugin."""
    import fishersplat
    from framework import registry

    hashes = {}
    chosen = [
        f"{group}={name}" for group in registry.GROUPS for name in sorted(registry.table(group))
    ]
    chosen += ["init=patch_growth init.rounds=20", "init=epipolar", "trainer.opacity_spare=0.5"]
    for k, words in enumerate(chosen):
        run = folder / f"run{k}"
        planes = ["depth.planes=48"] if "depth=" not in words or "plane_sweep" in words else []
        fishersplat.run(*COMMON, *words.split(), *planes, folder=run, quiet=True)
        hashes[words] = digest([(run / "point_cloud.ply").read_bytes()])
    return hashes


def _of_run(run: Path) -> Iterable[Any]:
    import pandas as pd

    record = json.loads((run / "record.json").read_text(encoding="utf-8"))
    keys = ("dose", "gaussians", "parameters_sha256", "summary", "scene")
    yield from (json.dumps(record[key], sort_keys=True) for key in keys)
    for name, timed in (("history.csv", "seconds"), ("metrics.csv", "render_s")):
        yield pd.read_csv(run / name, dtype=str).drop(columns=timed).to_csv()
    yield (run / "cameras.json").read_bytes()
    for file in sorted((run / "renders").iterdir()):
        yield file.read_bytes()


def metrics(folder: Path) -> dict[str, str]:
    """Every metric of images that differ a little, a lot, and by a mask; LPIPS alone has other bits
    on other processors."""
    from dataclasses import replace

    import torch

    from framework.compute.rng import stream
    from framework.metrics.evaluate import evaluate

    views = _training().views
    first, second, third, *_ = [view.image for view in views]
    noise = torch.from_numpy(stream(0, "stages").random(first.shape)).float()
    mask = (first[0] > 0.4).float()
    pairs = [
        (first, second, None),
        (first, (first + 0.05 * noise).clamp(0, 1), None),
        (third, noise, mask),
    ]
    measured = []
    for render, truth, of in pairs:
        view = replace(views[0], image=truth, mask=of)
        measured += evaluate(lambda _, image=render: image, [view])[0]  # type: ignore[misc]
    return {
        f"metric {name}": digest(repr(metrics.value(name)) for metrics in measured)
        for name in ("psnr", "ssim", "flip")
    }


STAGES: dict[str, Callable[[Path], dict[str, str]]] = {
    function.__name__: function
    for function in (scene, photos, depth, init, training, metrics, plugins)
}
USUAL = tuple(name for name in STAGES if name != plugins.__name__)


def main(argv: list[str]) -> int:
    import contextlib

    hashes: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
        for name in argv or USUAL:
            (Path(folder) / name).mkdir()
            hashes |= STAGES[name](Path(folder) / name)
    print(json.dumps(hashes, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
