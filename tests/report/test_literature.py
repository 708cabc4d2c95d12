"""Recipes stand next to what was published about them, by the word `method=` of their run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from framework.command.config.schema import CONF_DIR
from framework.report import build_report
from framework.report.literature import (
    AVGE_HERE,
    AVGE_THERE,
    OF_SCENE,
    recipes,
)
from framework.report.statistics.outcomes import outcomes
from framework.report.study.collect import collect
from framework.report.study.published import by_recipe
from framework.report.tables import Row
from tests.record.fakes import fake_run
from tests.report.studies import first_screen


def _recipe(folder: Path, name: str, seed: int, loader: str = "llff", **options: object) -> None:
    """A run whose command line chose a method."""
    fake_run(folder, "none", "none", seed, run_name=f"{name}-{seed}", scene="llff_fern", **options)  # type: ignore[arg-type]
    path = folder / "runs" / f"{name}-{seed}" / "record.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["overrides"] = [f"method={name}", f"seed={seed}"]
    content["config"]["reg"] = {"name": name}
    content["config"]["scene"]["name"] = loader
    path.write_text(json.dumps(content), encoding="utf-8")


def by_method(rows: list[Row]) -> dict[str, Row]:
    return {str(row["Method"]): row for row in rows}


def test_recipes_stand_next_to_published_and_repeated_figures(tmp_path: Path) -> None:
    for seed in (0, 1):
        _recipe(tmp_path, "corgs", seed)
        _recipe(tmp_path, "fsgs_sweep", seed, gain=1.0)
    ((_, actual),) = recipes(collect(tmp_path))
    rows = by_method(actual)
    assert set(rows) == {"CoR-GS", "FSGS", "ReconFusion", "MuRF"}
    corgs = rows["CoR-GS"]
    assert corgs["Published, LLFF"] == "20.45" and corgs["Runs"] == "2"
    assert corgs["Repeated by others, LLFF"] == "20.19 ± 0.14 (10 runs), 20.17, 20.11, 20.47"
    assert corgs[OF_SCENE] == "22.29" and corgs[AVGE_THERE] == "0.0862, 0.0806 ± 0.0008"
    assert AVGE_HERE not in corgs, "no run has LPIPS"
    assert rows["FSGS"]["Recipe"] == "fsgs_sweep"
    assert "### Compared with the literature" in build_report(tmp_path).read_text("utf-8")


@pytest.mark.parametrize("split", ["llff_drawn0", "llff_held_out", "file"])
def test_photos_of_another_division_stand_alone(tmp_path: Path, split: str) -> None:
    for recipe in ("corgs", "fsgs_sweep"):
        _recipe(tmp_path, recipe, 0)
    usual = collect(tmp_path)
    for path in (tmp_path / "runs").glob("*/record.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        content["scene"]["protocol"] = split
        path.write_text(json.dumps(content), encoding="utf-8")
    drawn = collect(tmp_path)
    assert recipes(usual) and not recipes(drawn)


def test_draws_of_one_scene_say_nothing_about_other_scenes(tmp_path: Path) -> None:
    for draw in (0, 1):
        for reg in ("none", "uar"):
            for seed in (0, 1):
                name = f"{reg}-{draw}-{seed}"
                fake_run(tmp_path, "none", reg, seed, run_name=name,
                         condition={"split": f"llff_drawn{draw}"})  # fmt: skip
    study = collect(tmp_path)
    (compared,) = outcomes(study).comparisons.values()
    assert compared.scenes == tuple(study.scenes) and compared.like is None
    assert "on these 2 conditions of embedded" in first_screen(tmp_path)


def test_published_figures_stand_next_to_their_own_data_set(tmp_path: Path) -> None:
    for name in ("binocular_sweep", "stereogs_sweep", "segs"):
        _recipe(tmp_path / "dtu", name, 0, loader="dtu", gain=float(name == "stereogs_sweep"))
        _recipe(tmp_path / "own", name, 0, loader="transforms")
    dtu, ours = (collect(tmp_path / name) for name in ("dtu", "own"))
    ((_, actual),) = recipes(dtu)
    cells = ("Published, DTU", "Repeated by others, DTU")
    printed = {name: tuple(row[c] for c in cells) for name, row in by_method(actual).items()}
    assert printed["Binocular3DGS"] == ("20.71", "20.83") and printed["SE-GS"] == ("–", "–")
    assert printed["StereoGS"] == ("21.46", "–") and printed["MuRF"] == ("21.31", "–")
    assert recipes(ours) == []


def test_every_published_recipe_is_one() -> None:
    assert by_recipe().keys() <= {path.stem for path in (CONF_DIR / "method").glob("*.yaml")}
