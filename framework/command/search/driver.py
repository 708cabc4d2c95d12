"""The search: optuna suggests, processes train, and optuna's journal on disk keeps the trials.

Every trial is written before it begins and when it has ended. After a kill the same command
continues: trials that ended count, and interrupted ones are resumed first, with the same options,
from their runs' checkpoints. A trial has the same bits as the same run by hand. With several trials
at a time the next suggestion depends on which trial ended first.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.command.search.space import Dimension
from framework.command.search.trial import Result, Slot
from framework.errors import require
from framework.files.whole import write_whole
from framework.metrics.values import LOWER
from framework.records.progress import say
from framework.records.search import SEARCH

JOURNAL = "search.journal"
JUDGES = ("psnr", "ssim", "flip", "lpips")  # the metrics that may choose
MOST_KILLS = 3  # of one trial's process
WORDS, RUN, TRAIN_S, ERROR = "words", "run", "train_s", "error"  # of a trial's attributes


@dataclass(frozen=True)
class Search:
    """A search.

    Attributes:
        folder: of the study.
        fixed: the words that stay.
        trials: number of trials, failed ones included.
    """

    folder: Path
    fixed: tuple[str, ...]
    space: tuple[Dimension, ...]
    metric: str
    trials: int
    at_once: int
    seed: int

    def settings(self) -> dict[str, Any]:
        """The settings that a continued search must share."""
        space = [dimension.plain() for dimension in self.space]
        return {"fixed": list(self.fixed), "space": space, "metric": self.metric}


class Trials:
    """optuna's study on disk."""

    def __init__(self, search: Search) -> None:
        import optuna
        from optuna.storages.journal import JournalFileBackend

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self.search, self._optuna = search, optuna
        storage = optuna.storages.JournalStorage(JournalFileBackend(str(search.folder / JOURNAL)))
        self.study = optuna.create_study(
            storage=storage,
            study_name="search",
            direction="minimize" if search.metric in LOWER else "maximize",
            load_if_exists=True,
        )
        before = self.study.user_attrs.get("search")
        require(
            before in (None, search.settings()),
            f"{search.folder}: expected the search that was begun there, got another; give it"
            " another name by --name",
        )
        self.study.set_user_attr("search", search.settings())
        # a sampler with the same seed would repeat its first draws
        begun = len(self.study.trials)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what optuna calls experimental
            self.study.sampler = optuna.samplers.TPESampler(
                seed=search.seed + begun, constant_liar=True
            )
        done = (t for t in self.study.trials if t.state.is_finished() and WORDS in t.user_attrs)
        self.left = search.trials - sum(1 for _ in done)

    def next(self) -> Iterator[tuple[int, list[str]]]:
        """(number, words) of the trials to do: first those that were under way."""
        for trial in self.study.trials:
            if not trial.state.is_finished():
                if WORDS not in trial.user_attrs:  # killed while it was suggested
                    self.study.tell(trial.number, state=self._optuna.trial.TrialState.FAIL)
                    continue
                say(f"trial {trial.number}: continues")
                yield trial.number, list(trial.user_attrs[WORDS])
        while True:
            asked = self.study.ask()
            words = [dimension.word(asked) for dimension in self.search.space]
            asked.set_user_attr(WORDS, words)
            yield asked.number, words

    def ended(self, number: int, result: Result) -> None:
        """Write the result of a trial."""
        trial = self._trial(number)
        trial.set_user_attr(RUN, Path(result.run_dir).name)
        trial.set_user_attr(TRAIN_S, result.train_s)
        if result.value is None:
            trial.set_user_attr(ERROR, result.error)
            self.study.tell(number, state=self._optuna.trial.TrialState.FAIL)
            say(f"trial {number}: failed · {result.error}")
        else:
            self.study.tell(number, result.value)
            best = self.study.best_trial
            say(
                f"trial {number}: {self.search.metric} {result.value:.4g} ·"
                f" best {best.value:.4g} (trial {best.number})"
            )
        write_whole(self.search.folder / SEARCH, json.dumps(self.table(), indent=1))

    def _trial(self, number: int) -> Any:
        (match,) = [trial for trial in self.study.trials if trial.number == number]
        return self._optuna.trial.Trial(self.study, match._trial_id)

    def table(self) -> dict[str, Any]:
        """The table of the report."""
        rows = [
            {
                "number": trial.number,
                "value": trial.value,
                **{key: trial.user_attrs.get(key) for key in (WORDS, RUN, TRAIN_S, ERROR)},
            }
            for trial in self.study.trials
            if trial.state.is_finished() and WORDS in trial.user_attrs
        ]
        return {**self.search.settings(), "trials": rows}

    @property
    def best(self) -> list[str] | None:
        """The words of the best trial; None where none ended well."""
        good = [t for t in self.study.trials if t.value is not None]
        return list(self.study.best_trial.user_attrs[WORDS]) if good else None


def run_search(search: Search) -> list[str] | None:
    """Do the trials that are left; returns the words of the best."""
    trials = Trials(search)
    slots = [Slot() for _ in range(search.at_once)]
    try:
        if trials.left > 0:
            _run(search, trials, slots)
    finally:
        for slot in slots:
            slot.close()
    return trials.best


def _run(search: Search, trials: Trials, slots: list[Slot]) -> None:
    todo = trials.next()
    running: dict[Future[Result], tuple[int, list[str], Slot, int]] = {}

    def begin(number: int, words: list[str], slot: Slot, kills: int = 0) -> None:
        label = f"[trial {number}] {' '.join(words)}"
        future = slot.submit([*search.fixed, *words], label, search.metric)
        running[future] = (number, words, slot, kills)

    free = list(slots)
    while trials.left > 0:
        while free and len(running) < trials.left:
            begin(*next(todo), free.pop())
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            number, words, slot, kills = running.pop(future)
            try:
                result = future.result()
            except BrokenProcessPool:
                slot.close()
                say(f"trial {number}: its process was killed")
                if kills < MOST_KILLS:
                    begin(number, words, slot, kills + 1)
                    continue
                result = Result("", None, error=f"its process was killed {kills + 1} times")
            trials.ended(number, result)
            trials.left -= 1
            free.append(slot)
