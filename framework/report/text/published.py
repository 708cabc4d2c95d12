"""Published figures to stand beside ours (`published.csv`, by scene `published_scenes.csv`). Other
hardware and numbers of steps, and often another size of photo, which every cell tells: they place
our numbers, they are no comparison."""

from __future__ import annotations

import csv
from pathlib import Path

from framework.report.parts.document import Block, Heading, Table, Text, table
from framework.report.statistics.numbers import ABSENT
from framework.report.study.runs import Study

FOLDER = Path(__file__).parent
MEANS = (
    "Means over the scenes of a data set: PSNR (± σ over runs, where it was measured) / SSIM /"
    " LPIPS (size of the photos), trained on a GPU for 10,000 steps or more; not comparable with"
    " the numbers above. The rows that CoR-GS published on Mip-NeRF 360 are at 1/4 of the size, the"
    " others at 1/8. Only the rows of a mean of runs tell how far runs differ; DropGaussian's own"
    " figures are the best of 5. SAFI's paper gives σ_PSNR 0.084 for DBA and 0.027 for SAFI, 0.061"
    " for uniform dropout and 0.026 for UAR: each against its nearest kin, none against plain"
    " training, and without the number of runs. Sources: {sources}."
)
BY_SCENE = (
    "The scenes of this report, as others trained them on a GPU with the protocol of their data"
    " set. AVGE is the geometric mean of the squared error, of the root of 1 - SSIM and of LPIPS:"
    " lower is better. Sources: {sources}."
)


def published(study: Study) -> list[Block]:
    """The means of data sets, and where some are known the figures of this study's scenes."""
    means = read("published.csv")
    blocks: list[Block] = [Heading(2, "Published figures"), _means(means)]
    blocks.append(Text(MEANS.format(sources=_sources(means))))
    own = scene_rows({study.name_of(s) for s in study.scenes if study.split_as_published(s)})
    if own:
        rows = [
            {
                "Scene": row["scene"],
                "Method": row["method"],
                "Training views": row["views"],
                "PSNR / SSIM / LPIPS (size)": _cell(row) if row["psnr"] else ABSENT,
                "AVGE (size)": f"{row['avge']} ({row['size']})",
            }
            for row in own
        ]
        blocks += [table(rows, ("Scene", "Method"))]
        blocks.append(Text(BY_SCENE.format(sources=_sources(own))))
    return blocks


def _means(rows: list[dict[str, str]]) -> Table:
    by_method: dict[str, dict[str, str]] = {}
    columns = list(dict.fromkeys(_column(row) for row in rows))
    for row in rows:
        by_method.setdefault(row["method"], {})[_column(row)] = _cell(row)
    cells = tuple(
        (method, *(found.get(column, "–") for column in columns))
        for method, found in by_method.items()
    )
    return Table(("Method", *columns), cells, ("Method",))


def _column(row: dict[str, str]) -> str:
    return f"{row['dataset']}, {row['views']} views"


def _cell(row: dict[str, str]) -> str:
    spread = f" ± {float(row['sd_psnr']):.2f}" if row.get("sd_psnr") else ""
    return f"{row['psnr']}{spread} / {row['ssim']} / {row['lpips']} ({row['size']})"


def _sources(rows: list[dict[str, str]]) -> str:
    return "; ".join(dict.fromkeys(row["source"] for row in rows))


def scene_rows(names: set[str]) -> list[dict[str, str]]:
    """What third parties got on scenes of these names."""
    return [
        row
        for row in read("published_scenes.csv")
        if row["scene"] in names or row["scene"].removeprefix("llff_") in names
    ]


def read(name: str) -> list[dict[str, str]]:
    """The rows of a table of published figures."""
    with (FOLDER / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
