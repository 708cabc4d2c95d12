"""Recipes stand next to what was published about them, by the word `method=` of their run."""

import json
from pathlib import Path

from framework.command.config.schema import CONF_DIR
from framework.report import build_report
from framework.report.literature import (
    AVGE_HERE,
    AVGE_THERE,
    OF_SCENE,
    recipes,
)
from framework.report.study.collect import collect
from framework.report.study.published import literature
from framework.report.tables import Row
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
    assert "### Compared with the literature" in build_report(tmp_path).path.read_text("utf-8")


def test_every_published_recipe_is_one() -> None:
    names = {entry.recipe for entry in literature() if entry.recipe}
    assert names <= {path.stem for path in (CONF_DIR / "method").glob("*.yaml")}
