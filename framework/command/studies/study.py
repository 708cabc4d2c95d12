"""The runs of one command: their number, their outcomes, and the report at the end.

The runs may be processes of a launcher, so nothing is shared in memory. Each run writes its outcome
into the ledger, a folder that the parent creates and names in an environment variable. A run
without an outcome counts as failed.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import JobReturn
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, open_dict

from framework.command.complaints import USER_ERRORS, composing
from framework.command.config.check import check
from framework.command.config.naming import plain, study_dir
from framework.command.hydra_inside import jobs_of, skip_second_check
from framework.command.launchers.supported import watch_workers
from framework.command.overrides import check_method, parsed
from framework.command.studies.closing import closing, short_path
from framework.command.studies.estimate import announce
from framework.command.studies.ready import check_links, check_ready
from framework.compute.stopwatch import Stopwatch, duration
from framework.errors import UserError, machine_line, printable_line, require
from framework.files.cache import cache_dir, usable
from framework.files.locks import locked
from framework.files.program import program
from framework.files.whole import remove_temporaries, write_whole
from framework.records.progress import say
from framework.records.record import check_replaceable

LEDGER_VARIABLE = "FISHERSPLAT_LEDGER"
JOBS_VARIABLE = "FISHERSPLAT_JOBS"
VARIED_VARIABLE = "FISHERSPLAT_VARIED"
REPORT = "report"  # the kind of failure of a report, which is no run


class Refused(BaseException):
    """Stops a multirun before its first run. Hydra turns a callback's `Exception` into a warning,
    hence a `BaseException`; the cause is the user's error."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of one run.

    Attributes:
        error: one line, None for success.
        kind: of the error, a word or two.
        again: the command that does this run alone.
        bad_input: whether the user can fix it.
        busy: whether another process is doing the run.
    """

    number: int
    run_dir: str
    error: str | None = None
    kind: str = ""
    again: str = ""
    bad_input: bool = False
    busy: bool = False


@contextmanager
def ledger() -> Iterator[Path]:
    """Make an empty ledger for this process and its children; it is removed at the end."""
    with usable(cache_dir()):
        made = TemporaryDirectory(prefix="ledger-", dir=cache_dir(), ignore_cleanup_errors=True)
    with made as folder:
        os.environ[LEDGER_VARIABLE] = folder
        try:
            yield Path(folder)
        finally:
            for name in (LEDGER_VARIABLE, JOBS_VARIABLE, VARIED_VARIABLE):
                os.environ.pop(name, None)


def add_outcome(outcome: Outcome) -> None:
    """Write `outcome` into the ledger of the command. A run that was sent to another machine
    returns it instead (`framework.command.launchers.sent`)."""
    if LEDGER_VARIABLE not in os.environ:
        return
    path = Path(os.environ[LEDGER_VARIABLE]) / f"{outcome.number:06d}.json"
    write_whole(path, json.dumps(dataclasses.asdict(outcome)))


def outcomes() -> list[Outcome]:
    """The outcomes so far, in the order of the runs."""
    return read_outcomes(Path(os.environ[LEDGER_VARIABLE]))


def read_outcomes(folder: Path) -> list[Outcome]:
    """Read the outcomes in a folder, in the order of its files."""
    return [Outcome(**json.loads(path.read_bytes())) for path in sorted(folder.glob("*.json"))]


def job_count() -> int | None:
    """The number of runs of this command; None in a process that started before it was set."""
    text = os.environ.get(JOBS_VARIABLE)
    return None if text is None else int(text)


def set_jobs(jobs: Sequence[Sequence[str]]) -> None:
    """Store, for this process and its children, the number of runs and the words that vary.

    Args:
        jobs: the words of each run.
    """
    values: dict[str, set[str]] = {}
    for word in (word for job in jobs for word in job):
        key, _, value = word.lstrip("+").partition("=")
        values.setdefault(key, set()).add(value)
    os.environ[JOBS_VARIABLE] = str(len(jobs))
    os.environ[VARIED_VARIABLE] = " ".join(key for key in values if len(values[key]) > 1)


def varied(words: Sequence[str]) -> list[str]:
    """Return the words of a run that vary between the runs of its command."""
    keys = os.environ.get(VARIED_VARIABLE, "").split()
    return [word for word in words if word.lstrip("+").partition("=")[0] in keys]


class StudyCallback(Callback):
    """Refuses a bad multirun before its first run; builds the reports after the last."""

    def __init__(self) -> None:
        self._watch = Stopwatch()
        self._expected_s: float | None = None

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        try:
            require(
                not config.estimate,
                "estimate: expected a study, whose duration it estimates, got a single run; add -m,"
                " or leave estimate=true out: a run shows the time that is left",
            )
            check_links(Path(config.hydra.run.dir))
            check_replaceable(Path(config.hydra.run.dir), plain(config))
            check_method(parsed(config.hydra.overrides.task), ())
        except (*USER_ERRORS, OSError) as error:
            raise Refused from error
        os.environ[JOBS_VARIABLE] = "1"

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        try:
            jobs = sweep_jobs(config)
            studies = check_jobs(config, jobs)
            skip_second_check()
            for folder in studies:
                check_links(folder)
            if config.estimate:
                every = [run for configs in studies.values() for run in configs]
                self._expected_s = announce(every, _at_once(config))
                if config.estimate == "only":
                    raise SystemExit(0)
        except (*USER_ERRORS, OSError) as error:
            raise Refused from error
        set_jobs(jobs)
        if "joblib" in str(config.hydra.launcher.get("_target_")):
            watch_workers()
        self._watch = Stopwatch()

    def on_run_end(self, config: DictConfig, **kwargs: Any) -> None:
        build_reports()

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Drop the run's two configurations, which Hydra would keep to the end: 0.1 MB a run."""
        job_return.cfg = job_return.hydra_cfg = None

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        if config.hydra.launcher.get("detach"):  # no run has ended yet
            del os.environ[JOBS_VARIABLE]
            return
        estimated = "" if self._expected_s is None else f" (estimated {duration(self._expected_s)})"
        say(f"{len(outcomes())} runs took {duration(self._watch.wall_s)}{estimated}")
        build_reports()


def sweep_jobs(config: DictConfig) -> list[list[str]]:
    """The overrides of every run of a multirun, as Hydra's own sweeper splits them."""
    params = OmegaConf.to_container(config.hydra.sweeper.params or OmegaConf.create({}))
    assert isinstance(params, dict)
    parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
    typed = parser.parse_overrides(list(config.hydra.overrides.task))
    check_method(typed, params)
    swept = parser.parse_overrides([f"{key!s}={value}" for key, value in params.items()])
    with composing():
        jobs = jobs_of([*swept, *typed])
    empty = [str(o.input_line) for o in (*swept, *typed) if not jobs and not jobs_of([o])]
    require(len(jobs) > 0, f"multirun: {' '.join(empty)} gives no value, so there is no run")
    return jobs


def check_jobs(config: DictConfig, jobs: list[list[str]]) -> dict[Path, list[dict[str, Any]]]:
    """Check all runs before the first one starts.

    Runs that differ only in the seed are composed once, as composing takes a tenth of a second.

    Returns:
        The configurations of the runs by the folder of their study.

    Raises:
        UserError: of the first bad run.
    """
    loader = GlobalHydra.instance().config_loader()
    parser = OverridesParser.create(config_loader=loader)
    checked: dict[tuple[str, ...], DictConfig] = {}
    taken: dict[str, list[str]] = {}
    studies: dict[Path, list[dict[str, Any]]] = {}
    words = OmegaConf.to_container(config.hydra.sweep, resolve=False)
    by_overrides = "overrid" in str(words)  # hydra.job.override_dirname or hydra.overrides
    for number, job in enumerate(jobs):
        seeds = [word for word in job if word.startswith("seed=")]
        method = tuple(word for word in job if word not in seeds)
        if method in checked and not by_overrides:
            composed = checked[method]
            for seed in parser.parse_overrides(seeds):
                composed.seed = seed.value()
        else:
            with composing():
                composed = checked[method] = loader.load_sweep_config(config, job)
        values = plain(composed)
        check(values)
        if "Slurm" not in str(config.hydra.launcher.get("_target_")):  # the run is on this machine
            check_ready(values)
        with open_dict(composed):
            composed.hydra.job.num = number  # as the launcher will, after this
        # the seed may be part of it
        folder = f"{composed.hydra.sweep.dir}/{composed.hydra.sweep.subdir}"
        studies.setdefault(study_dir(Path(folder)), []).append(values)
        if folder in taken:
            raise UserError(
                f"multirun: expected a folder for each run, got {folder} for both"
                f" '{' '.join(taken[folder])}' and '{' '.join(job)}'; sweep each value once, or"
                " give each run its own study=NAME or hydra.sweep.subdir"
            )
        check_replaceable(Path(folder), values)
        taken[folder] = job
    return studies


def _at_once(config: DictConfig) -> int:
    """How many runs the launcher does at a time."""
    launcher = config.hydra.launcher
    in_ray = OmegaConf.select(launcher, "ray.init.num_cpus")
    asked = int(launcher.get("n_jobs") or launcher.get("array_parallelism") or in_ray or 1)
    return asked if asked > 0 else os.cpu_count() or 1


def build_reports() -> None:
    """Build the report of every study with a successful run and print where it is.

    Hydra swallows exceptions of callbacks, so a failed report becomes an outcome.
    """
    good = [outcome for outcome in outcomes() if outcome.error is None]
    for folder in sorted({study_dir(Path(outcome.run_dir)) for outcome in good}):
        try:
            from framework.report import build_report

            with locked(folder, wait=True):
                remove_temporaries(folder, ".*.tmp")  # of a process killed at its report
                build_report(folder)
            for line in closing(folder / "report.md"):
                say(line)
        except Exception as error:
            # not the number of a run: a killed one has no outcome
            number = max(job_count() or 0, 1 + max(outcome.number for outcome in outcomes()))
            reason = str(error) if isinstance(error, UserError) else machine_line(error)
            fixable = reason is not None
            reason = reason or f"{type(error).__name__}: {error}"
            message = printable_line(f"report of {short_path(folder)}: {reason}")
            again = f"{program()} report {folder}"
            add_outcome(Outcome(number, str(folder), message, REPORT, again, bad_input=fixable))
