"""Draw the README's picture of a finished run: its training photos, and of one test view the
render and the photo, which it was not trained on.

    python docs/picture.py RUN [docs/images/first.jpg]

RUN: a run's folder. The built-in scene is the one whose pictures may be passed on.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

WIDTH, GAP, LABEL = 260, 8, 24  # pixels of a picture, between two, and of the line above them
HIGH_QUALITY = 90


def pictures(run: Path) -> list[tuple[str, Path]]:
    """(label, file) of the training photos, then render and photo of the median test view."""
    photos = sorted((run / "photos").glob("*.png")) + sorted((run / "photos").glob("*.jpg"))
    with (run / "metrics.csv").open(encoding="utf-8", newline="") as table:
        views = sorted(csv.DictReader(table), key=lambda row: float(row["psnr"]))
    stem = views[len(views) // 2]["file"]
    shown = [(f"photo {i + 1}", photo) for i, photo in enumerate(photos[:3])]
    return [
        *shown,
        ("render of a new view", run / "renders" / f"{stem}.png"),
        ("its photo", run / "renders" / f"{stem}_truth.png"),
    ]


def draw(run: Path, out: Path) -> None:
    """Write the picture, all in a row."""
    shown = pictures(run)
    images = [Image.open(path).convert("RGB") for _, path in shown]
    height = round(WIDTH * images[0].height / images[0].width)
    canvas = Image.new("RGB", (len(shown) * (WIDTH + GAP) - GAP, height + LABEL), "white")
    pen, font = ImageDraw.Draw(canvas), ImageFont.load_default(size=15)
    for i, ((label, _), image) in enumerate(zip(shown, images, strict=True)):
        left = i * (WIDTH + GAP)
        pen.text((left, 2), label, fill="black", font=font)
        canvas.paste(image.resize((WIDTH, height), Image.Resampling.LANCZOS), (left, LABEL))
    out.parent.mkdir(parents=True, exist_ok=True)
    canvas.save(out, quality=HIGH_QUALITY)


if __name__ == "__main__":
    default = Path(__file__).parent / "images" / "first.jpg"
    draw(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else default)
