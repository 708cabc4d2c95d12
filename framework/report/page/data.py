"""What the page's script draws: charts, forest plots and the viewer's shots, as plain values."""

from __future__ import annotations

import dataclasses
from typing import Any

from framework.report.page.gallery import Gallery
from framework.report.parts.chart import Chart, Series
from framework.report.parts.document import Document, Picture
from framework.report.parts.forest import Forest, limits
from framework.report.parts.palette import DASHES, color_index, dash_index, marker_index


def page_data(document: Document, pictures: Gallery) -> dict[str, Any]:
    """Charts and forest plots in the document's order, which `places` of the page refer to."""
    drawn = [block for block in document.blocks if isinstance(block, Picture)]
    return {
        "charts": [_chart(chart) for picture in drawn for chart in picture.charts],
        "forests": [_forest(picture.forest) for picture in drawn if picture.forest],
        "scenes": document.scenes,
        "methods": document.methods,
        "names": document.names,
        "beside": document.beside,
        "images": pictures.images,
        "shots": pictures.shots,
        "looks": pictures.looks,
        "videos": pictures.videos,
    }


def _chart(chart: Chart) -> dict[str, Any]:
    plain = {f.name: getattr(chart, f.name) for f in dataclasses.fields(chart)}
    band = chart.band and dataclasses.asdict(chart.band)
    return plain | {"series": [_series(one) for one in chart.series], "band": band}


def _series(series: Series) -> dict[str, Any]:
    """The style as numbers; points as [x, y, low, high, note], six digits."""
    points = [[*(_short(v) for v in (p.x, p.y, p.y_low, p.y_high)), p.note] for p in series.points]
    return {
        "name": series.name,
        "color": color_index(series.look),
        "marker": marker_index(series.look),
        "dash": " ".join(str(2 * n) for n in DASHES[dash_index(series.look)]),
        "points": points,
        "faint": series.faint,
        "joined": series.joined,
        "ringed": list(series.ringed),
    }


def _forest(forest: Forest) -> dict[str, Any]:
    """Rows as [method, label, color, marker, middle, low, high, joint, real]."""
    rows = []
    for r in forest.rows:
        ends = [None if v is None else _short(v) for v in (r.middle, r.low, r.high)]
        style = (color_index(r.look), marker_index(r.look))
        rows.append([r.method, r.label, *style, *ends, r.joint, r.real])
    return {"x_label": forest.x_label, "limits": [*map(_short, limits(forest))], "rows": rows}


def _short(value: float) -> float:
    return float(f"{value:.6g}")
