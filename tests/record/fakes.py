"""Small made-up runs, written by the product's own writer, for tests of records and reports."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.metrics.evaluate import evaluate
from framework.metrics.values import ViewMetrics
from framework.records.provenance import provenance, strict_json
from framework.records.record import RunRecord, SceneInfo, StageTime, write_run
from framework.records.run_files import HistoryRow
from framework.types import Camera, Gaussians, View

TAGS = (("interpolating",), ("interpolating",), ("extrapolating",), ("extrapolating",))
BASE_PSNR = (27.0, 25.0, 23.0, 21.0)


def make_gaussians(n: int, degree: int) -> Gaussians:
    draw = stream(0, f"gaussians/{n}/{degree}")

    def tensor(*shape: int) -> Tensor:
        return torch.from_numpy(draw.standard_normal(shape)).float()

    rest = (degree + 1) ** 2 - 1
    return Gaussians(
        tensor(n, 3), tensor(n, 4), tensor(n, 3), tensor(n), tensor(n, 1, 3), tensor(n, rest, 3)
    )


def measured(view: View, image: Tensor, network: Any = None) -> ViewMetrics:
    """The metrics of an image of a test view."""
    return replace(evaluate(lambda _: image, [view], network)[0][0], render_s=0.01)


def make_config(
    augment: str = "none", reg: str = "none", seed: int = 0, **more: Any
) -> dict[str, Any]:
    """A resolved config; `more` may replace any of its parts."""
    config: dict[str, Any] = {
        "seed": seed,
        "threads": 0,
        "force": False,
        "study": None,
        "traceback": False,
        "scene": {"name": "embedded", "n_views": 3},
        "augment": {"name": augment, "weight": 1.0},
        "reg": {"name": reg, "weight": 1.0},
        "capacity": {"name": "fixed", "weight": 1.0},
        "depth": {"name": "plane_sweep"},
        "init": {"name": "stereo", "budget": 40000},
        "trainer": {"steps": 800, "sh_degree": 0, "members": 1},
        "metrics": {"lpips_weights": None},
    }
    return config | more


def make_view(index: int, width: int = 64, height: int = 48, tags: tuple[str, ...] = ()) -> View:
    """A smooth picture with a bright disc whose place depends on `index`."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    disc = ((x - 10 * (index + 1)) ** 2 + (y - height / 2) ** 2).sqrt() < 8
    planes = [x / width, y / height, disc.float() * 0.8 + 0.1]
    camera = Camera(torch.eye(4), torch.eye(3), width, height)
    return View(f"test {index:02d}", camera, torch.stack(planes).float(), tags=tags)


def noisy(view: View, psnr: float, purpose: str, seed: int) -> Tensor:
    """The view's image with white noise of about the given PSNR in dB."""
    noise = stream(seed, f"{purpose}/{view.name}").standard_normal(tuple(view.image.shape))
    return view.image + 10 ** (-psnr / 20) * torch.from_numpy(noise).float()


def fake_run(
    study_dir: Path,
    augment: str = "none",
    reg: str = "none",
    seed: int = 0,
    gain: float = 0.0,
    tagged: bool = True,
    scene: str = "embedded",
    run_name: str | None = None,
    condition: dict[str, Any] | None = None,
    bits: float | None = None,
    tested: bool = True,
    **more: Any,
) -> Path:
    """Write a run whose test PSNR is BASE_PSNR + gain + a little that depends on the seed.

    condition: options of the scene; other ones make another scene of the same name. bits: runs with
    an equal one end with the same parameters. tested: whether there are test views."""
    config = make_config(augment, reg, seed, **more)
    config["scene"] = config["scene"] | (condition or {})
    mark = f"{scene}{sorted((condition or {}).items())}"
    fingerprint = hashlib.sha256(mark.encode()).hexdigest()
    views = [make_view(i, tags=tags if tagged else ()) for i, tags in enumerate(TAGS) if tested]
    shift = gain + 0.2 * float(stream(seed, f"{augment}/{reg}").standard_normal())
    renders = [
        (view, noisy(view, base + shift, f"{augment}-{reg}", seed))
        for view, base in zip(views, BASE_PSNR if tested else (), strict=True)
    ]
    record = RunRecord(
        identity=f"{augment}{reg}{seed}",
        config=config,
        overrides=(f"+augment={augment}", f"+reg={reg}", f"seed={seed}"),
        scene=SceneInfo(
            scene,
            config["scene"].get("split", "own" if tested else "none"),
            fingerprint,
            ("train 00",),
            tuple(v.name for v in views),
        ),
        timings={"scene": StageTime(0.5, 0.4), "train": StageTime(16.0 + gain + seed / 8, 30.0)},
        provenance=provenance(),
        peak_memory_bytes=600_000_000,
    )
    metrics = [measured(view, image) for view, image in renders]
    run_dir = study_dir / "runs" / (run_name or f"{scene}-{augment}-{reg}-s{seed}")
    gaussians, history = make_gaussians(12, 0), _history(shift, gain, tested)
    ours = float(stream(seed, strict_json(config)).standard_normal())
    gaussians.means[0, 0] = ours if bits is None else bits
    write_run(run_dir, record, metrics, history, gaussians, torch.zeros(3), renders)
    return run_dir


def _history(shift: float, gain: float, tested: bool) -> list[HistoryRow]:
    return [
        HistoryRow(
            step=step,
            seconds=step * 0.02 + 0.1 * gain,
            loss=0.2 / (1 + step / 100),
            gaussians=12,
            sh_degree=0,
            test_psnr=24.0 + shift - 4.0 * 0.99 ** (step / 4)
            if tested and step % 200 == 0
            else None,
            logged={"dropped": 0.1},
        )
        for step in range(100, 801, 100)
    ]
