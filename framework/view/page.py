"""Makes the page: one HTML file that needs neither network nor other files.

As in reports, texts from outside are escaped and data is JSON without `<`. The content security
policy allows only the page's own script and style, by their hashes.
"""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from framework.errors import printable_line
from framework.exports.opened import NamedCamera
from framework.files.pages import filled, policy_hash, script_json
from framework.scenes.images import read_image
from framework.view.pack import Packed, packed
from framework.view.runs import ViewedRun

ASSETS = Path(__file__).parent / "assets"
BYTES = 4_000_000  # of all photos of a page, about, before base64
LONGEST, SHORTEST = 1280, 320  # pixels of a copy's longer side: at most; however many there are
QUALITY, EFFORT = 82, 4
BYTES_PER_PIXEL = 0.2  # of a WebP copy of this quality, rather too much
SCRIPTS = ("math", "model", "shaders", "renderer", "camera", "input", "page")
SETTINGS = ("capacity", "depth", "init")  # named if two runs differ in them


def view_page(runs: Sequence[ViewedRun], photos: bool = True) -> str:
    """The page of one run, or of two side by side (`framework.view.check_together`).

    Args:
        photos: include the photos.

    Raises:
        UserError: for a damaged one.
    """
    models = [packed(run.splats) for run in runs]
    script = '"use strict";\n(() => {\n' + "".join(_asset(f"{n}.js") for n in SCRIPTS) + "})();\n"
    style = _asset("page.css")
    names = labels(runs)
    blobs = "\n".join(
        f'<script type="text/plain" id="splats{i}">{model.text}</script>'
        for i, model in enumerate(models)
    )
    return filled(
        _asset("page.html"),
        {
            "title": html.escape(printable_line(runs[0].scene)),
            "policy": f"default-src 'none'; img-src data: blob:; script-src {policy_hash(script)};"
            f" style-src {policy_hash(style)}; base-uri 'none'; form-action 'none'",
            "style": style,
            "facts": "".join(map(_facts, runs, names)),
            "blobs": blobs,
            "data": script_json(_data(runs, models, names, photos)),
            "script": script,
        },
    )


def labels(runs: Sequence[ViewedRun]) -> list[str]:
    """Short names that distinguish the runs."""
    methods = [run.record.methods for run in runs]
    differing = [key for key in SETTINGS if len({m.get(key) for m in methods}) > 1]
    named = []
    for run, method in zip(runs, methods, strict=True):
        plugins = [method.get(group, "none") for group in ("augment", "reg")]
        parts = [" + ".join(name for name in plugins if name != "none") or "baseline"]
        parts += [f"{key} {method.get(key, 'none')}" for key in differing]
        named.append(" · ".join([*parts, f"seed {run.record.seed}"]))
    if len(set(named)) < len(named):
        named = [f"{name} · {run.folder.name}" for name, run in zip(named, runs, strict=True)]
    return [printable_line(name) for name in named]


def _facts(run: ViewedRun, name: str) -> str:
    """HTML about a run and its warnings."""
    psnr = run.record.summary.get("psnr")
    tested = f" · test PSNR {psnr:.2f} dB" if isinstance(psnr, float) else ""
    lines = [f"{name} · {len(run.splats.means):,} Gaussians{tested}"]
    lines += [f"Warning: {text}" for text in run.record.warnings]
    return "".join(f"<p>{html.escape(printable_line(line))}</p>" for line in lines)


def _data(
    runs: Sequence[ViewedRun], models: Sequence[Packed], names: Sequence[str], photos: bool
) -> dict[str, Any]:
    """The data for the page's script: runs, cameras, photos and the first camera."""
    cameras = {c.name: c for run in reversed(runs) for c in reversed(run.cameras)}
    ordered = sorted(reversed(cameras.values()), key=lambda camera: not camera.tests)
    files = {name: file for run in reversed(runs) for name, file in run.photos.items()}
    kept = [camera.name for camera in ordered if photos and camera.name in files]
    places = {name: i for i, name in enumerate(kept)}
    return {
        "runs": [_run(*each) for each in zip(runs, models, names, strict=True)],
        "cameras": [_camera(camera, runs, places) for camera in ordered],
        "photos": copies([files[name] for name in kept]),
        "up": _upward(ordered),
        "first": 0,
    }


def _upward(cameras: Sequence[NamedCamera]) -> list[float]:
    """[3] unit vector: the mean up direction of the cameras."""
    total = sum((-camera.viewmat[1, :3] for camera in cameras), np.zeros(3))
    length = float(np.linalg.norm(total))
    return [0.0, -1.0, 0.0] if length < 1e-3 else [float(v) for v in total / length]


def _run(run: ViewedRun, model: Packed, name: str) -> dict[str, Any]:
    background = run.splats.background or [0.0, 0.0, 0.0]
    return {
        "label": name,
        **{key: value for key, value in vars(model).items() if key != "text"},
        "background": [min(1.0, max(0.0, value)) for value in background],
        "near": run.near,
    }


def _camera(
    camera: NamedCamera, runs: Sequence[ViewedRun], places: dict[str, int]
) -> dict[str, Any]:
    lens = camera.lens
    exposures = [{c.name: c.exposure for c in run.cameras} for run in runs]
    return {
        "name": printable_line(camera.name),
        "role": "test" if camera.tests else "train",
        "rotation": camera.viewmat[:3, :3].ravel().tolist(),
        "center": camera.center.tolist(),
        **{"fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy},
        **{"w": lens.width, "h": lens.height},
        "photo": places.get(camera.name),
        "exposure": [of.get(camera.name, (1.0, 1.0, 1.0)) for of in exposures],
        "psnr": [run.psnr.get(camera.name) for run in runs],
    }


def _asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")


def copies(files: Sequence[Path]) -> list[str]:
    """Data URIs.

    Raises:
        UserError: for a file that is no image.
    """
    pixels = BYTES / max(1, len(files)) / BYTES_PER_PIXEL  # of a copy, to keep to the budget
    longest = int(min(LONGEST, max(SHORTEST, (pixels * 4 / 3) ** 0.5)))
    return [_copy(file, longest) for file in files]


def _copy(file: Path, longest: int) -> str:
    from PIL import Image

    image = Image.fromarray(read_image(file))
    image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=QUALITY, method=EFFORT)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
