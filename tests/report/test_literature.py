"""Recipes stand beside what was published of them, told by the word `method=` of their run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from framework.command.config.schema import CONF_DIR
from framework.report.details import compared
from framework.report.parts.document import Table, Text
from framework.report.statistics.outcomes import outcomes
from framework.report.study.collect import collect
from framework.report.text.literature import (
    AVGE_HERE,
    AVGE_THERE,
    HERE,
    OF_SCENE,
    OVER,
    PUBLISHED,
    REPEATED,
    REVERSED,
    literature,
)
from framework.report.text.published import published, read
from framework.report.verdict.lead import where
from tests.record.fakes import fake_run


def _recipe(folder: Path, name: str, seed: int, loader: str = "llff", **options: object) -> None:
    """A run whose command line chose a method."""
    fake_run(folder, "none", "none", seed, run_name=f"{name}-{seed}", scene="llff_fern", **options)  # type: ignore[arg-type]
    path = folder / "runs" / f"{name}-{seed}" / "record.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["overrides"] = [f"method={name}", f"seed={seed}"]
    content["config"]["reg"] = {"name": name}
    content["config"]["scene"]["name"] = loader
    path.write_text(json.dumps(content), encoding="utf-8")


def test_recipes_stand_beside_published_and_repeated_figures(tmp_path: Path) -> None:
    for seed in (0, 1):
        _recipe(tmp_path, "corgs", seed)
        _recipe(tmp_path, "fsgs_sweep", seed, gain=1.0)
    found, reversals = (b for b in literature(collect(tmp_path)) if isinstance(b, Table))
    columns = dict(zip(found.columns, range(20), strict=False))
    rows = {row[columns["Method"]]: row for row in found.rows}
    assert set(rows) == {"CoR-GS", "FSGS", "ReconFusion", "MuRF"}
    corgs = rows["CoR-GS"]
    assert corgs[columns[PUBLISHED.format(set="LLFF")]] == "20.45" and corgs[columns["Runs"]] == "2"
    assert corgs[columns[REPEATED.format(set="LLFF")]] == (
        "20.19 ± 0.14 (10 runs), 20.17, 20.11, 20.47"
    )
    assert corgs[columns[OF_SCENE]] == "22.29"
    assert corgs[columns[AVGE_THERE]] == "0.0862, 0.0806 ± 0.0008"
    assert AVGE_HERE not in columns, "no run has LPIPS"
    ((above, below),) = reversals.rows
    assert above == "CoR-GS" and below.startswith("FSGS (+0.14, ")
    assert rows["FSGS"][columns["Recipe"]] == "fsgs_sweep"
    assert rows["MuRF"][columns["Recipe"]] == "published only"
    assert rows["MuRF"][columns[HERE]] == "–" and rows["FSGS"][columns[HERE]] != "–"


@pytest.mark.parametrize("split", ["llff_drawn0", "llff_held_out", "none"])
def test_other_photos_than_the_papers_stand_beside_no_published_figures(
    tmp_path: Path, split: str
) -> None:
    for recipe in ("corgs", "fsgs_sweep"):
        _recipe(tmp_path, recipe, 0)
    usual = collect(tmp_path)
    for path in (tmp_path / "runs").glob("*/record.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        content["scene"]["protocol"] = split
        path.write_text(json.dumps(content), encoding="utf-8")
    drawn = collect(tmp_path)
    assert literature(usual) and not literature(drawn)
    assert len(published(usual)) == len(published(drawn)) + 2, "the table of the scene, with a text"


def test_a_study_of_draws_tells_nothing_of_other_scenes(tmp_path: Path) -> None:
    for draw in (0, 1):
        for reg in ("none", "uar"):
            for seed in (0, 1):
                gain = 0.5 + 0.1 * seed if reg == "uar" else 0.1 * seed
                name = f"{reg}-{draw}-{seed}"
                fake_run(tmp_path, "none", reg, seed, run_name=name, gain=gain)
                path = tmp_path / "runs" / name / "record.json"
                content = json.loads(path.read_text(encoding="utf-8"))
                content["config"]["scene"]["split"] = f"llff_drawn{draw}"
                content["scene"] |= {"protocol": f"llff_drawn{draw}", "fingerprint": f"{draw}" * 64}
                path.write_text(json.dumps(content), encoding="utf-8")
    study = collect(tmp_path)
    assert len(study.scenes) == 2
    found = outcomes(study)
    (compared_with_plain,) = found.comparisons.values()
    assert compared_with_plain.scenes == tuple(study.scenes) and compared_with_plain.like is None
    assert where(study) == "on these 2 conditions of embedded"
    texts = [block.text for block in compared(found) if isinstance(block, Text)]
    assert texts and not any("Scenes like these" in text for text in texts)


def test_scenes_of_dtu_stand_beside_figures_of_dtu(tmp_path: Path) -> None:
    for name in ("binocular_sweep", "stereogs_sweep", "segs"):
        _recipe(tmp_path, name, 0, loader="dtu", gain=float(name == "stereogs_sweep"))
    (found,) = (b for b in literature(collect(tmp_path)) if isinstance(b, Table))
    columns = dict(zip(found.columns, range(20), strict=False))
    printed = {
        row[columns["Method"]]: (
            row[columns[PUBLISHED.format(set="DTU")]],
            row[columns[REPEATED.format(set="DTU")]],
        )
        for row in found.rows
    }
    assert printed["Binocular3DGS"] == ("20.71", "20.83") and printed["SE-GS"] == ("–", "–")
    assert printed["StereoGS"] == ("21.46", "–") and printed["MuRF"] == ("21.31", "–")


def test_a_reversal_that_seeds_confirm_is_told(tmp_path: Path) -> None:
    for seed, gain in enumerate((2.0, 2.2, 2.1)):
        _recipe(tmp_path, "stereogs_sweep", seed)  # published the highest of the three
        _recipe(tmp_path, "binocular_sweep", seed, gain=gain)
        _recipe(tmp_path, "segs", seed, gain=(-5.0, -1.0, -3.0)[seed])
    tables = [b for b in literature(collect(tmp_path)) if isinstance(b, Table)]
    (told,) = (t for t in tables if t.columns == (REVERSED, OVER))
    ((above, below),) = told.rows
    assert above == "StereoGS" and below.startswith("Binocular3DGS (+0.47, -1.")
    assert below.endswith(" shown)"), "SE-GS is published below it, and is"


def test_a_recipe_that_was_run_in_several_ways_is_in_no_pair(tmp_path: Path) -> None:
    for seed in (0, 1):
        _recipe(tmp_path, "fsgs", seed, gain=3.0)
        _recipe(tmp_path, "fsgs_sweep", seed, gain=1.0)
        _recipe(tmp_path, "corgs", seed)
    assert not [
        b
        for b in literature(collect(tmp_path))
        if isinstance(b, Table) and b.columns == (REVERSED, OVER)
    ]


def test_a_study_without_recipes_has_no_such_table(tmp_path: Path) -> None:
    fake_run(tmp_path)
    assert literature(collect(tmp_path)) == []
    _recipe(tmp_path / "one", "fsgs", 0)
    assert literature(collect(tmp_path / "one")) == []


def test_every_published_recipe_is_one() -> None:
    names = {row["recipe"] for row in read("literature.csv")} - {""}
    assert names <= {path.stem for path in (CONF_DIR / "method").glob("*.yaml")}
