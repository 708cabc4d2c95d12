"""Sends the log of a finished run to an experiment tracker, `tracker=NAME`.

A tracker is one function in `TRACKERS` that takes `Tracked`: the options, the rows of the history
by step, the measures at the end. All of it is read from the finished record. So training never
waits for a tracker, and a complete run is sent without being repeated. A file in the run's folder
`tracker/` marks a record as sent, so it is sent once.

A tracker never harms a run: `ready` refuses a missing package before anything is trained, and what
fails later is one warning line. This module is light: each package is imported where it is used.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framework.errors import UserError, nearest_hint, printable_line, require
from framework.records import RUN_FOLDERS

if TYPE_CHECKING:
    from framework.records.progress import Progress
    from framework.records.record import Run

FOLDER = "tracker"  # in a run's: what trackers write there, and what was sent
PROJECT = "fishersplat"
NONE = "none"
MOST_PARAMS = 100  # that MLflow takes at once (its REST API, runs/log-batch)


@dataclass(frozen=True)
class Tracked:
    """The data of a run for a tracker.

    Attributes:
        study, name: names of the run's study and folder.
        folder: existing folder for files of the tracker.
        options: by full name (`trainer.steps`), None as "null".
        rows: (finished steps, name -> finite value), in order; names are the columns of
            `history.csv`, as `loss`, `test_psnr`, `log/...`.
        summary: `summary/NAME`: mean over the test views of each metric that could be measured,
            `gaussians` and `train_s`.
    """

    study: str
    name: str
    folder: Path
    options: dict[str, str | int | float | bool]
    rows: tuple[tuple[int, dict[str, float]], ...]
    summary: dict[str, float]


def _tensorboard(run: Tracked) -> None:
    """Event files in `run.folder`, instead of those of an earlier sending."""
    from torch.utils.tensorboard import SummaryWriter

    for old in run.folder.glob("events.out.tfevents.*"):
        old.unlink()
    with SummaryWriter(str(run.folder)) as writer:
        for step, values in run.rows:
            for name, value in values.items():
                writer.add_scalar(name, value, step)
        writer.add_hparams(run.options, run.summary, run_name=".")


def _mlflow(run: Tracked) -> None:
    """To `MLFLOW_TRACKING_URI`, or where MLflow writes without it; the study is the experiment."""
    import mlflow

    logging.getLogger("mlflow").setLevel(logging.WARNING)  # it reports every table that it makes
    mlflow.set_experiment(run.study)
    with mlflow.start_run(run_name=run.name):
        options = list(run.options.items())
        for start in range(0, len(options), MOST_PARAMS):
            mlflow.log_params(dict(options[start : start + MOST_PARAMS]))
        for step, values in run.rows:
            mlflow.log_metrics(values, step=step)
        mlflow.log_metrics(run.summary)


def _wandb(run: Tracked) -> None:
    """To the account of `wandb login`, or into `run.folder` with `WANDB_MODE=offline`."""
    import wandb

    with wandb.init(
        project=PROJECT,
        group=run.study,
        name=run.name,
        dir=str(run.folder),
        config=run.options,
        reinit="create_new",  # one process may do many runs
        # it would copy the terminal of what runs next in this process, and its summary onto it
        settings=wandb.Settings(silent=True, console="off"),
    ) as session:
        for step, values in run.rows:
            session.log(values, step=step)
        session.summary.update(run.summary)


def _trackio(run: Tracked) -> None:
    """Into trackio's own folder; it has no summary, so the last step gets it."""
    import trackio

    with contextlib.redirect_stdout(io.StringIO()):  # it prints seven lines for each run
        trackio.init(project=PROJECT, group=run.study, name=run.name, config=run.options)
        try:
            for step, values in run.rows:
                trackio.log(values, step=step)
            trackio.log(run.summary, step=run.rows[-1][0] if run.rows else 0)
        finally:
            trackio.finish()


# name, which is that of the package and of the extra, too -> who sends a run there
TRACKERS: dict[str, Callable[[Tracked], None]] = {
    "tensorboard": _tensorboard,
    "mlflow": _mlflow,
    "wandb": _wandb,
    "trackio": _trackio,
}


def ready(tracker: str | None) -> None:
    """Raise UserError unless the option `tracker` names one whose package is installed, or none."""
    if tracker is None or tracker == NONE:
        return
    available = [NONE, *TRACKERS]
    require(
        tracker in available,
        f"tracker={tracker}: unknown tracker; {nearest_hint(tracker, available)}",
    )
    spec = importlib.util.find_spec(tracker)
    require(
        spec is not None and spec.origin is not None,  # no origin: only a folder of that name
        f"tracker={tracker}: expected the package {tracker} to be installed, found it missing; pip"
        f" install 'fishersplat[{tracker}]', or leave the option out",
    )


def send(tracker: str | None, run_dir: Path, progress: Progress) -> None:
    """Send the complete run in `run_dir`, unless this very record was sent before.

    Never raises: a failure becomes a note of `progress`, and is tried again when the command is
    repeated.
    """
    if tracker is None or tracker == NONE:
        return
    try:
        ready(tracker)
        _send_once(tracker, run_dir)
    except Exception as error:
        said = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
        line = printable_line(" ".join(said.split()))[:300]
        progress.note(f"warning: tracker={tracker}: not sent ({line}); the run itself is complete")


def _send_once(tracker: str, run_dir: Path) -> None:
    from framework.files.opened import read_bytes
    from framework.files.whole import file_sha256, write_whole
    from framework.records.record import RECORD, read_run

    digest = file_sha256(run_dir / RECORD) + "\n"
    sent = run_dir / FOLDER / f"{tracker}.sent"
    if sent.is_file() and read_bytes(sent, 1000) == digest.encode():
        return
    sent.parent.mkdir(exist_ok=True)
    TRACKERS[tracker](tracked(read_run(run_dir)))
    write_whole(sent, digest)


def tracked(run: Run) -> Tracked:
    """Return the tracker's data of a completed run."""
    record, columns = run.record, run.history.numbers
    values = {name: column for name, column in columns.items() if name != "step"}
    rows = tuple(
        (int(step), _finite({name: column[index] for name, column in values.items()}))
        for index, step in enumerate(columns["step"])
    )
    ended = {**record.summary, "gaussians": record.gaussians, "train_s": record.train_s}
    folder = run.run_dir.resolve()
    inside = folder.parent.name == RUN_FOLDERS
    return Tracked(
        study=folder.parent.parent.name if inside else folder.parent.name,
        name=folder.name,
        folder=folder / FOLDER,
        options=dict(_flat("", record.config)),
        rows=rows,
        summary={f"summary/{name}": value for name, value in _finite(ended).items()},
    )


def _finite(values: Mapping[str, Any]) -> dict[str, float]:
    """Those that are numbers: what could not be measured has no place on a curve."""
    numbers = {k: float(v) for k, v in values.items() if isinstance(v, int | float)}
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


def _flat(
    prefix: str, options: Mapping[str, Any]
) -> Iterator[tuple[str, str | int | float | bool]]:
    for key, value in options.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{prefix}{key}.", value)
        elif isinstance(value, str | int | float | bool):
            yield f"{prefix}{key}", value
        else:
            yield f"{prefix}{key}", "null" if value is None else str(value)
