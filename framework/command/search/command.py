"""`search [--trials 30] [--jobs 1] [--metric psnr] [--name NAME] KEY=VALUE ...`

Searches the best values of the options that vary, judged on training views that are held out. The
scene's test views are neither trained on nor read. The same command continues an interrupted
search.

    fishersplat search --trials 30 --jobs 2 scene=llff scene.path=DIR threads=1 \\
        'trainer.lr_scale=tag(log,interval(1.0,20.0))' init=stereo,fused
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from framework.command.config.naming import study_dir
from framework.command.config.schema import register_config
from framework.command.overrides import normalise
from framework.command.search.driver import JUDGES, Search, run_search
from framework.command.search.space import space_of
from framework.command.search.trial import job_of
from framework.command.studies.study import short_path
from framework.errors import Arguments, require
from framework.files.locks import locked
from framework.files.program import command_line
from framework.records.progress import say
from framework.scenes import HELD_OUT, UNTESTED, untested

ALONE = ".search"  # holds the lock of the search


def main(arguments: Sequence[str], prog: str) -> int:
    """Exit code 0, or 1 where no trial ended well."""
    parser = Arguments(
        prog=prog, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", metavar="KEY=VALUE")
    parser.add_argument("--trials", type=int, default=30, help="default 30")
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time (default 1)")
    parser.add_argument("--metric", default="psnr", help=f"{', '.join(JUDGES)} (default psnr)")
    parser.add_argument("--name", help="of the study (default: search_ and the scene's)")
    parser.add_argument("--sampler-seed", type=int, default=0, help="of the suggestions")
    options = parser.parse_intermixed_args(list(arguments))
    require(
        importlib.util.find_spec("optuna") is not None,
        f"{prog}: expected optuna to be installed, found it missing; pip install"
        " 'fishersplat[search]'",
    )
    register_config()
    hydra = [word for word in options.words if word.lstrip("+~").startswith("hydra")]
    require(not hydra, f"{prog}: expected options of a run, got {' '.join(hydra)}; leave it out")
    search = _search(options)
    try:
        with locked(search.folder / ALONE):
            best = run_search(search)
    finally:
        with contextlib.suppress(OSError):  # another process searches there
            (search.folder / ALONE).rmdir()
    return _conclude(search, best, prog)


def _search(options: Any) -> Search:
    require(
        options.metric in JUDGES,
        f"--metric: expected one of {', '.join(JUDGES)}, got {options.metric!r}; choose one",
    )
    for flag, value in (("--trials", options.trials), ("--jobs", options.jobs)):
        require(
            1 <= value <= 10_000,
            f"{flag}: expected a number from 1 to 10,000, got {value}; choose another",
        )
    fixed, space = space_of(normalise(options.words))
    outer = [d.key for d in space if d.key.lstrip("+").partition(".")[0] in ("seed", "scene")]
    require(
        not outer,
        f"search: expected options of a training to vary, got {' and '.join(outer)}, which would"
        " choose what is measured; give one value, and judge the best with several",
    )
    first = [dimension.first for dimension in space]
    fixed = _held_out(fixed, job_of([*fixed, *first]).config["scene"])
    if options.name is not None or not any(word.startswith("study=") for word in fixed):
        scene = study_dir(Path(job_of([*fixed, *first]).run_dir)).name
        fixed = [word for word in fixed if not word.startswith("study=")]
        fixed.append(f"study={options.name or f'search_{scene}'}")
    return Search(
        folder=study_dir(Path(job_of([*fixed, *first]).run_dir)),
        fixed=tuple(fixed),
        space=tuple(space),
        metric=options.metric,
        trials=options.trials,
        at_once=options.jobs,
        seed=options.sampler_seed,
    )


def _held_out(words: Sequence[str], scene: Mapping[str, Any]) -> list[str]:
    """`words` with a split of the scene that tests held-out training views."""
    split = str(scene.get("split", UNTESTED))
    shown = " scene.split=none" if "split" in scene else ""
    require(
        not untested(split),
        "search: expected a scene some of whose photos can be held out, got"
        f" scene={scene['name']}{shown}; choose another, test views may not choose",
    )
    split = split if split.endswith(HELD_OUT) else f"{split}{HELD_OUT}"
    return [
        *(word for word in words if not word.startswith("scene.split=")),
        f"scene.split={split}",
    ]


def _conclude(search: Search, best: list[str] | None, prog: str) -> int:
    from framework.report import build_report

    with locked(search.folder, wait=True):
        report = build_report(search.folder).path
    say(f"report: {short_path(report)}")
    if best is None:
        say(f"{prog}: no trial ended well, see the report")
        return 1
    say(f"best: {shlex.join(best)}")
    say(
        "evaluate it once, on scenes that the search did not use, for instance:"
        f" {command_line([*to_judge(search.fixed, best), '-m'])}"
    )
    return 0


def to_judge(fixed: Sequence[str], best: Sequence[str]) -> list[str]:
    """The words that evaluate `best` on another scene, with the other fixed words."""
    kept = [w for w in fixed if not w.lstrip("+").startswith(("scene", "study=", "threads="))]
    varies = any(word.startswith("seed=") for word in (*kept, *best))
    return [*kept, *best, "scene=...", *([] if varies else ["seed=0,1,2"])]
