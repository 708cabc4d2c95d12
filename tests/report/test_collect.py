"""Names of methods and scenes: what differs is named, what cannot matter is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from framework.errors import UserError
from framework.report.collect import collect, method_labels, scene_labels
from tests.record.fakes import fake_run, make_config


def test_methods_are_named_by_augmenter_and_regularizer() -> None:
    configs = [make_config(), make_config("safi", "uar"), make_config("safi", "uar", seed=5)]
    assert method_labels(configs) == ["none + none", "safi + uar", "safi + uar"]


@pytest.mark.parametrize(
    "neutral",
    [{"threads": 2}, {"study": "x"}, {"force": True}, {"scene": {"name": "llff"}}],
)
def test_seed_scene_and_neutral_keys_are_no_method(neutral: dict[str, Any]) -> None:
    labels = method_labels([make_config(), make_config(seed=3, **neutral)])
    assert labels == ["none + none"] * 2


def test_every_other_difference_is_named() -> None:
    labels = method_labels(
        [
            make_config(trainer={"steps": 300, "sh_degree": 0}),
            make_config(capacity={"name": "adc", "weight": 1.0, "every": 100}),
            make_config(init={"name": "stereo", "budget": 5000}),
        ]
    )
    assert labels == [
        "none + none, capacity=fixed, init.budget=40000, trainer.steps=300",
        "none + none, capacity=adc, init.budget=40000, trainer.steps=800",
        "none + none, capacity=fixed, init.budget=5000, trainer.steps=800",
    ]


def test_options_only_count_among_runs_of_one_plugin() -> None:
    def uar(**options: Any) -> dict[str, Any]:
        return make_config() | {"reg": {"name": "uar", "weight": 1.0, **options}}

    assert method_labels([make_config(), uar(p=0.2)]) == ["none + none", "none + uar"]
    assert method_labels([make_config(), uar(p=0.2), uar(p=0.3)]) == [
        "none + none",
        "none + uar, reg.p=0.2",
        "none + uar, reg.p=0.3",
    ]


def test_baseline_comes_first_and_runs_are_sorted(tmp_path: Path) -> None:
    for augment, seed in (("safi", 1), ("none", 10), ("none", 2), ("safi", 0)):
        fake_run(tmp_path, augment, seed=seed)
    study = collect(tmp_path)
    assert study.baseline == "none + none"
    assert [(run.method, run.seed) for run in study.runs] == [
        ("none + none", 2),
        ("none + none", 10),
        ("safi + none", 0),
        ("safi + none", 1),
    ]
    assert study.notes == ()


def test_a_repeated_run_is_told_and_left_out(tmp_path: Path) -> None:
    fake_run(tmp_path, run_name="a")
    fake_run(tmp_path, run_name="b/nested")
    study = collect(tmp_path)
    assert len(study.runs) == 1
    assert "left out in favour of `a`" in study.notes[0]


def test_runs_of_different_code_are_told(tmp_path: Path) -> None:
    fake_run(tmp_path, seed=0)
    record = fake_run(tmp_path, seed=1) / "record.json"
    code = collect(tmp_path).runs[0].record.provenance["code"]
    record.write_text(record.read_text().replace(code, "0" * 64))
    assert "2 versions of the code" in collect(tmp_path).notes[0]


def test_one_scene_name_with_two_splits(tmp_path: Path) -> None:
    from dataclasses import replace

    records = []
    for n_views in (3, 6):
        run_dir = fake_run(tmp_path, run_name=f"{n_views}")
        record = collect(run_dir).runs[0].record
        assert record.scene is not None
        scene = replace(record.scene, fingerprint=f"{n_views}" * 64)
        config = {**record.config, "scene": {"name": "llff", "n_views": n_views}}
        records.append(replace(record, scene=scene, config=config))
    assert scene_labels(records) == [
        "embedded (n_views=3, 33333333)",
        "embedded (n_views=6, 66666666)",
    ]


def test_a_folder_without_runs_is_one_line(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(UserError, match="folder with runs"):
            collect(folder)
