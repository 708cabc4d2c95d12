"""Names of methods and scenes: what differs is named, what cannot matter is not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from framework.errors import UserError
from framework.records.record import SceneInfo, write_failed
from framework.report import build_report
from framework.report.figures import tradeoff
from framework.report.statistics.outcomes import outcomes
from framework.report.statistics.robustness import failure_rate
from framework.report.study.collect import collect
from framework.report.study.labels import USUAL, VARIANTS, method_labels, scene_labels
from framework.report.text import budgets
from framework.report.text.capacities import contests, evidence, sentences
from framework.report.verdict.points import MEANING
from tests.cli.conftest import composed
from tests.record.fakes import fake_run, make_config

VARIANT_FILES = sorted((Path(__file__).parents[2] / "conf/reg").glob("*.yaml"))


def names(configs: list[dict[str, Any]]) -> list[str]:
    return [label.full for label in method_labels(configs)]


def test_methods_are_named_by_augmenter_and_regularizer() -> None:
    configs = [make_config(), make_config("safi", "uar"), make_config("safi", "uar", seed=5)]
    assert names(configs) == ["none + none", "safi + uar", "safi + uar"]


@pytest.mark.parametrize("file", VARIANT_FILES, ids=lambda f: f.stem)
def test_a_variant_is_named_as_users_call_it(file: Path) -> None:
    """Beside its plugin and alone; a study of dropgaussian alone told of `none + uniform`."""
    told = yaml.safe_load(file.read_text(encoding="utf-8"))
    plugin = told.pop("defaults")[0]
    variant = make_config() | {"reg": {"name": plugin, **told}}
    (key,) = (key for name, key, _ in VARIANTS if name == plugin)
    plain = make_config() | {"reg": {"name": plugin, key.partition(".")[2]: "another"}}
    assert names([variant]) == [f"none + {file.stem}"] and file.stem in MEANING
    assert [name.partition(",")[0] for name in names([variant, plain])] == [
        f"none + {file.stem}",
        f"none + {plugin}",
    ]
    assert not any(key.partition(".")[2] in name for name in names([variant, plain]))


@pytest.mark.parametrize(
    "neutral",
    [{"threads": 2}, {"study": "x"}, {"force": True}, {"scene": {"name": "llff"}}],
)
def test_seed_scene_and_neutral_keys_are_no_method(neutral: dict[str, Any]) -> None:
    labels = names([make_config(), make_config(seed=3, **neutral)])
    assert labels == ["none + none"] * 2


def test_every_other_difference_is_named() -> None:
    labels = names(
        [
            make_config(trainer={"steps": 300, "sh_degree": 0}),
            make_config(capacity={"name": "adc", "weight": 1.0, "every": 100}),
            make_config(init={"name": "stereo", "budget": 5000}),
        ]
    )
    assert labels == [
        "none + none, budget=40000, steps=300",
        "none + none, budget=40000, steps=800, capacity=adc",
        "none + none, budget=5000, steps=800",
    ]


def test_options_only_count_among_runs_of_one_plugin() -> None:
    def uar(**options: Any) -> dict[str, Any]:
        return make_config() | {"reg": {"name": "uar", "weight": 1.0, **options}}

    assert names([make_config(), uar(p=0.2)]) == ["none + none", "none + uar"]
    assert names([make_config(), uar(p=0.2), uar(p=0.3)]) == [
        "none + none",
        "none + uar, reg.p=0.2",
        "none + uar, reg.p=0.3",
    ]


def test_a_draw_with_the_value_of_the_seed_needs_no_name() -> None:
    def draw(seed: int, of: int, corruption: str = "noise") -> dict[str, Any]:
        depth = {"name": "plane_sweep", "corruption": corruption, "corruption_seed": of}
        return make_config(seed=seed) | {"depth": depth}

    drawn = [draw(seed, seed) for seed in (0, 1, 2)]
    assert names(drawn) == ["none + none"] * 3
    clean = [draw(seed, 0, "none") for seed in (0, 1, 2)]
    assert names([*clean, *drawn]) == ["none + none"] * 6
    crossed = [draw(seed, of) for seed in (0, 1) for of in (0, 1)]
    assert len(set(names(crossed))) == 2
    assert len(set(names([draw(0, 0), draw(0, 1)]))) == 2
    assert names([draw(7, 7), make_config(seed=7)]) == ["none + none"] * 2


def test_an_option_is_named_even_where_it_happens_to_equal_the_seed() -> None:
    steps = [make_config(seed=k, trainer={"steps": 300, "sh_degree": k}) for k in (0, 1)]
    assert len(set(names(steps))) == 2


def test_an_option_that_two_plugins_share_is_named_where_it_differs() -> None:
    def capacity(name: str, **options: Any) -> dict[str, Any]:
        return make_config() | {"capacity": {"name": name, "weight": 1.0, **options}}

    evidence = [capacity("evidence", every=share, grow=1.0) for share in (0.1, 0.2)]
    assert names([capacity("adc", every=50), *evidence]) == [
        "none + none, capacity=adc",
        "none + none, capacity=evidence, every=0.1",
        "none + none, capacity=evidence, every=0.2",
    ]
    assert names(evidence)[0] == "none + none, capacity.every=0.1"


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


def test_own_plugins_are_no_other_version_of_the_code(tmp_path: Path) -> None:
    """Older records hash the user's plugins into `code`; newer ones beside it."""
    for seed, old in ((0, False), (1, True), (2, False)):
        path = fake_run(tmp_path, seed=seed) / "record.json"
        record = json.loads(path.read_text())
        record["provenance"] |= {"git": {"sha": "a" * 40, "dirty": False}}
        if old:
            record["provenance"] |= {"code": "0" * 64, "own_plugins": ["mine.py"]}
        else:
            record["provenance"] |= {"plugins": {"reg=none": str(seed)}}
        path.write_text(json.dumps(record))
    (note,) = (note for note in collect(tmp_path).notes if "versions" in note)
    assert "2 versions of `reg=none`" in note


def info(name: str, fingerprint: str) -> SceneInfo:
    return SceneInfo(name, "own", fingerprint * 32, ("a",), ("b",))


def scene_names(*scenes: tuple[dict[str, Any], SceneInfo | None]) -> list[str]:
    configs = [make_config() | {"scene": {"name": "llff", **options}} for options, _ in scenes]
    return [label.full for label in scene_labels(configs, [found for _, found in scenes])]


def test_one_scene_name_with_two_splits() -> None:
    three, six = ({"n_views": 3}, info("fern", "33")), ({"n_views": 6}, info("fern", "66"))
    assert scene_names(three, six) == ["fern (n_views=3)", "fern (n_views=6)"]
    assert scene_names(three, ({"n_views": 3}, info("door", "77"))) == ["fern", "door"]


def test_the_fingerprint_tells_what_the_options_do_not() -> None:
    edited = [({"n_views": 3}, info("fern", mark)) for mark in ("33", "66")]
    assert scene_names(*edited) == ["fern (33333333)", "fern (66666666)"]


def test_a_corrupted_depth_is_a_condition_and_no_method() -> None:
    configs = [
        make_config() | {"depth": {"name": "file", "corruption": kind, "strength": s}}
        for kind, s in (("noise", 0.1), ("noise", 0.2), ("bias", 0.1))
    ]
    assert names(configs) == ["none + none"] * 3
    labels = scene_labels(configs, [info("embedded", "11")] * 3)
    assert [label.full for label in labels] == [
        "embedded (corruption=noise, strength=0.1)",
        "embedded (corruption=noise, strength=0.2)",
        "embedded (corruption=bias, strength=0.1)",
    ]


def test_budgets_are_told_apart_from_the_family() -> None:
    configs = [make_config("safi", trainer={"steps": steps}) for steps in (100, 400)]
    assert [(label.family, label.budget) for label in method_labels(configs)] == [
        ("safi + none", "steps=100"),
        ("safi + none", "steps=400"),
    ]


def test_the_baseline_has_the_same_budget(tmp_path: Path) -> None:
    for augment in ("none", "safi"):
        for steps in (100, 400):
            fake_run(tmp_path, augment, trainer={"steps": steps}, run_name=f"{augment}{steps}")
    study = collect(tmp_path)
    assert study.baseline_of("safi + none, steps=400") == "none + none, steps=400"


def test_a_budget_without_the_baseline_has_no_comparison(tmp_path: Path) -> None:
    """As where plain training failed there: another method is no baseline in its place."""
    for augment, reg, steps in (
        *(("none", "none", 100), ("none", "uar", 100)),
        *(("none", "uar", 400), ("safi", "none", 400)),
    ):
        for seed in range(3):
            fake_run(
                *(tmp_path, augment, reg, seed),
                gain=6.0 if augment == "safi" else 0.0,
                trainer={"steps": steps},
                run_name=f"{augment}{reg}{steps}{seed}",
            )
    study = collect(tmp_path)
    assert study.baselines == ["none + none, steps=100"]
    alone = ["none + uar, steps=400", "safi + none, steps=400"]
    assert study.without_baseline == alone
    assert [study.baseline_of(method) for method in alone] == alone
    assert list(outcomes(study).comparisons) == ["none + uar, steps=100"]
    rate = failure_rate(study, "none + uar, steps=400")  # 6 dB below safi, which is no plain one
    assert rate is not None and rate.failed == 0
    text = build_report(tmp_path).read_text(encoding="utf-8")
    assert f"No baseline has their budget, hence compared with nothing: {'; '.join(alone)}." in text
    (verdict,) = [line for line in text.splitlines() if line.startswith("**Use none + none ")]
    assert " rather safi + none, steps=400 (" in verdict and " with safi" not in verdict


def test_a_method_is_compared_under_its_own_options(tmp_path: Path) -> None:
    """The default choices have no name and come first."""
    for augment in ("none", "safi"):
        for name in ("sparse", "stereo"):
            fake_run(tmp_path, augment, init={"name": name}, run_name=f"{augment}{name}")
    study = collect(tmp_path)
    assert study.methods == [
        *("none + none", "none + none, init=sparse"),
        *("safi + none", "safi + none, init=sparse"),
    ]
    assert study.baseline_of("safi + none, init=sparse") == "none + none, init=sparse"
    assert study.baseline_of("safi + none") == "none + none"
    assert study.baseline_of("none + none, init=sparse") == "none + none"


def test_unnamed_choices_are_the_defaults() -> None:
    config = composed()
    # a capacity is unnamed where it leaves the number of Gaussians alone, whatever the default is
    usual = {key: name for key, name in USUAL.items() if key != "capacity.name"}
    assert {key: config[key.partition(".")[0]]["name"] for key in usual} == usual
    assert USUAL["capacity.name"] == "fixed"


def test_what_the_steps_determine_needs_no_name() -> None:
    presets = [(75, 1.0), (100, 0.5), (300, 0.25)]
    configs = [make_config(trainer={"steps": s, "coarse_until": c}) for s, c in presets]
    capacity = {"name": "budget", "weight": 1.0, "start": 0.0, "stop": 1.0}
    small = make_config(trainer={"steps": 300, "coarse_until": 0.25}, capacity=capacity)
    assert names([*configs, small]) == [
        *(f"none + none, steps={steps}" for steps, _ in presets),
        "none + none, steps=300, capacity=budget",
    ]
    watched = make_config(trainer={"steps": 100, "coarse_until": 0.5, "evaluations": 3})
    assert names([*configs, watched])[-1] == "none + none, steps=100"
    other = make_config(trainer={"steps": 300, "coarse_until": 0.5})
    assert "none + none, coarse_until=0.5, steps=300" in names([*configs, other])


def test_rates_that_go_with_a_budget_need_no_name() -> None:
    """Two presets may have the same steps: what else tells them apart determines their rates."""
    presets = [(75, 1.0, 0.1), (75, 0.5, 0.2), (300, 0.25, 0.1)]
    configs = [
        make_config(trainer={"steps": s, "coarse_until": c, "lr_final": r}) for s, c, r in presets
    ]
    assert names(configs) == [f"none + none, coarse_until={c}, steps={s}" for s, c, _ in presets]
    tried = make_config(trainer={"steps": 75, "coarse_until": 0.5, "lr_final": 0.3})
    assert names([*configs, tried])[-1].startswith("none + none, trainer.lr_final=0.3, coarse_unt")


def test_budgets_of_one_method_are_compared_with_the_first(tmp_path: Path) -> None:
    for steps in (100, 400):
        fake_run(tmp_path, trainer={"steps": steps}, run_name=f"{steps}")
    study = collect(tmp_path)
    assert study.baseline_of("none + none, steps=400") == "none + none, steps=100"


def test_failed_runs_have_the_name_of_their_method(tmp_path: Path) -> None:
    fake_run(tmp_path, "safi", seed=0)
    write_failed(tmp_path / "runs" / "x", make_config("safi", seed=1), ["seed=1"], "no overlap")
    (failed,) = collect(tmp_path).failed
    assert (failed.method, failed.scene, failed.seed) == ("safi + none", "embedded", 1)


def test_failed_runs_of_a_recipe_have_its_name_where_all_of_a_scene_failed(tmp_path: Path) -> None:
    """There its other options (`conf/for_scene`) give it another name than elsewhere."""

    def config(reg: str, name: str, start: float) -> dict[str, Any]:
        options = {"name": reg, "weight": 1.0, "start": start}
        return make_config() | {"reg": options, "scene": {"name": name, "n_views": 3}}

    for recipe, reg in (("baseline", "none"), ("corgs", "uar")):
        path = fake_run(tmp_path, reg=reg, scene="fern") / "record.json"
        content = json.loads(path.read_text())
        content |= {"overrides": [f"method={recipe}"], "config": config(reg, "fern", 0.0)}
        path.write_text(json.dumps(content))
    lost = config("uar", "scan65", 0.2)
    write_failed(tmp_path / "runs" / "x", lost, ["method=corgs"], "no overlap")
    study = collect(tmp_path)
    assert {run.method for run in study.runs} == {"none + none", "corgs"}
    assert [run.method for run in study.failed] == ["corgs"]
    assert ("scan65", "corgs", 0) not in study.missing


def test_a_failed_run_without_a_record_is_read_from_what_it_left(tmp_path: Path) -> None:
    fake_run(tmp_path, "safi", seed=0)
    folder = tmp_path / "runs" / "x"
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "config.yaml").write_text(yaml.safe_dump(make_config("safi", seed=1)))
    (folder / "failed.json").write_text('{"error": "no overlap", "overrides": ["seed=1"]}')
    (failed,) = collect(tmp_path).failed
    assert (failed.method, failed.scene, failed.seed) == ("safi + none", "embedded", 1)
    (folder / "failed.json").write_text("{")
    (damaged,) = collect(tmp_path).failed
    assert damaged.kind == "damaged" and damaged.error.startswith("failed.json: expected JSON")


def test_a_repetition_that_failed_is_told(tmp_path: Path) -> None:
    run_dir = fake_run(tmp_path)
    write_failed(run_dir, make_config(), [], "no memory")
    study = collect(tmp_path)
    assert len(study.runs) == 1 and not study.failed
    assert "was repeated and failed (no memory)" in study.notes[0]


def test_evened_exposures_are_told(tmp_path: Path) -> None:
    runs = [fake_run(tmp_path, run_name=name, seed=i) for i, name in enumerate(("even", "not"))]
    assert not any("exposed" in note for note in collect(tmp_path).notes)
    record = json.loads((runs[0] / "record.json").read_text(encoding="utf-8"))
    record["provenance"]["exposure_rms"] = 0.094
    (runs[0] / "record.json").write_text(json.dumps(record), encoding="utf-8")
    (told,) = (note for note in collect(tmp_path).notes if "exposed" in note)
    assert (
        told.startswith("Photos were exposed differently (")
        and " by 9 % in 1 of 2 runs, root" in told
    )


def test_a_run_that_was_begun_and_left_nothing_is_told(tmp_path: Path) -> None:
    fake_run(tmp_path, run_name="whole")
    (tmp_path / "runs" / "killed" / "checkpoints").mkdir(parents=True)
    (tmp_path / "runs" / ".trash").mkdir()
    (told,) = (note for note in collect(tmp_path).notes if "begun" in note)
    assert told.startswith("1 run was begun and has no result: still going, or killed (`killed`).")


def test_missing_runs_of_a_cross(tmp_path: Path) -> None:
    for augment, seed in (("none", 0), ("none", 1), ("safi", 0)):
        fake_run(tmp_path, augment, seed=seed)
    assert collect(tmp_path).missing == (("embedded", "safi + none", 1),)


def test_merged_studies_lack_only_what_each_of_them_lacks(tmp_path: Path) -> None:
    for seed in (0, 1):
        fake_run(tmp_path / "a", seed=seed)
    fake_run(tmp_path / "b", scene="fern", seed=0)
    study = collect([tmp_path / "a", tmp_path / "b"], tmp_path / "both")
    assert study.scenes == ["embedded", "fern"] and study.missing == ()
    assert study.folder_of(study.runs[0].run.run_dir) == "../a/runs/embedded-none-none-s0"


def test_a_folder_without_runs_is_one_line(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(UserError, match="folder with runs"):
            collect(folder)


def test_trainings_beside_other_programs_are_told_and_compared_by_cpu(tmp_path: Path) -> None:
    fake_run(tmp_path, "none", "none", 0)
    fake_run(tmp_path, "safi", "none", 0)
    assert not collect(tmp_path).by_cpu
    busy = fake_run(tmp_path, "none", "none", 1) / "record.json"
    content = json.loads(busy.read_text(encoding="utf-8"))
    (train,) = (stage for stage in content["timings"] if stage["stage"] == "train")
    train["cpu_s"] = 5.0
    busy.write_text(json.dumps(content), encoding="utf-8")
    study = collect(tmp_path)
    assert study.notes[0].startswith("While 1 of 3 trainings ran, other programs")
    ((chart,), *_) = tradeoff.charts(study, "embedded")
    assert chart.x_label == "training time (s, CPU)"
    assert budgets.advice(study, "embedded")[0].split(":")[0].endswith("s of CPU time")


def test_members_are_a_budget_and_named_only_where_the_steps_do_not_tell() -> None:
    def config(steps: int, members: int) -> dict[str, Any]:
        own = {"steps": steps, "members": members, "tuning": 0.05}
        return {"augment": {"name": "none"}, "reg": {"name": "none"}, "trainer": own}

    labels = method_labels([config(100, 1), config(300, 1), config(450, 2)])
    assert {label.family for label in labels} == {"none + none"}
    assert [label.budget for label in labels] == [f"steps={n}" for n in (100, 300, 450)]
    labels = method_labels([config(300, 1), config(300, 2)])
    assert [label.budget for label in labels] == ["members=1", "members=2, tuning=0.05"]


def test_every_capacity_has_a_colour_where_there_are_enough(tmp_path: Path) -> None:
    for name in ("fixed", "adc"):
        for steps in (100, 400):
            config = {"capacity": {"name": name}, "trainer": {"steps": steps}}
            fake_run(tmp_path, gain=steps / 100, run_name=f"{name}{steps}", **config)
    ((chart,), *_) = tradeoff.charts(collect(tmp_path), "embedded")
    assert {series.name for series in chart.series} == {
        "none + none",
        "none + none, capacity=adc",
    }
    for name in ("a", "b", "c", "d", "e"):
        fake_run(tmp_path, run_name=name, capacity={"name": name}, trainer={"steps": 100})
    ((chart,), *_) = tradeoff.charts(collect(tmp_path), "embedded")
    assert {series.name for series in chart.series} == {"none + none"}


def test_a_chart_per_method_where_the_colours_are_too_few_for_all(tmp_path: Path) -> None:
    capacities = ("fixed", "adc", "budget", "evidence")
    for augment in ("none", "safi"):
        for at, capacity in enumerate(capacities):
            name, config = f"{augment}-{capacity}", {"name": capacity}
            fake_run(tmp_path, augment, gain=at, run_name=name, capacity=config)
    (panels, *_) = tradeoff.charts(collect(tmp_path), "embedded")
    assert [chart.title for chart in panels] == ["embedded, none + none", "embedded, safi + none"]
    for chart in panels:
        named = {series.look: series.name for series in chart.series}
        assert set(named.values()) == {f"capacity={name}" for name in capacities}
        assert named == {series.look: series.name for series in panels[0].series}
    # single runs show no gain, so nothing is ringed
    assert not any(series.ringed for chart in panels for series in chart.series)


def test_methods_that_did_nothing_are_told(tmp_path: Path) -> None:
    """Where a method never took effect its runs have the baseline's bits."""
    for seed in range(3):
        fake_run(tmp_path, "none", "none", seed, bits=seed)
        fake_run(tmp_path, "safi", "none", seed, bits=seed if seed < 2 else 9.0)
        fake_run(tmp_path, "none", "uar", seed)
    assert collect(tmp_path).notes == (
        "none + none and safi + none trained to the same bits (embedded, seeds 0 and 1): what tells"
        " them apart never took effect there, so nothing was learned about it.",
    )


def test_capacities_are_compared_all_else_equal(tmp_path: Path) -> None:
    """Each with the fixed number, under the same method and the same other budgets."""
    for seed in range(3):
        for reg in ("none", "uar"):
            for name, gain in (("fixed", 0.0), ("adc", 2.0), ("budget", -3.0)):
                run_name = f"{reg}-{name}-{seed}"
                capacity = {"name": name, "weight": 1.0}
                fake_run(tmp_path, "none", reg, seed, gain, run_name=run_name, capacity=capacity)
    found = contests(collect(tmp_path))
    assert [(c.method, c.capacity, c.against) for c in found] == [
        (method, capacity, "capacity=fixed")
        for method in ("none + none", "none + uar")
        for capacity in ("capacity=adc", "capacity=budget")
    ]
    assert [round(c.comparison.difference) for c in found] == [2, -3, 2, -3]
    assert all(c.comparison.n == 3 and c.parameters == 1.0 for c in found)
    first, second = sentences(found[:2])
    assert first.startswith("adc: 1.0 times the parameters, ")
    assert " -2.7" in second
    assert evidence(found) == " (3 seeds, ranges hold for all 4 comparisons at once)"


def test_draws_of_one_scene_are_not_scenes_like_these(tmp_path: Path) -> None:
    """Of capacities, as of every other comparison."""
    for draw in range(3):
        for name, gain in (("fixed", 0.0), ("adc", 2.0)):
            capacity = {"name": name, "weight": 1.0}
            condition = {"split": f"llff_drawn{draw}"}
            for seed in range(2):
                fake_run(tmp_path, seed=seed, gain=gain, capacity=capacity, condition=condition,
                         run_name=f"{draw}{name}{seed}")  # fmt: skip
    (contest,) = contests(collect(tmp_path))
    assert len(contest.comparison.scenes) == 3 and contest.comparison.like is None


def test_one_capacity_makes_no_contest(tmp_path: Path) -> None:
    for steps in (100, 400):
        fake_run(tmp_path, trainer={"steps": steps}, run_name=f"{steps}")
    assert contests(collect(tmp_path)) == []
