"""How far a submitted study is: lines for the terminal, and a page that reloads itself.

The page is written by whoever changes something, at most every few seconds, so it needs no server.
"""

from __future__ import annotations

import contextlib
import html
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from framework.command.launchers.plan import Plan, running
from framework.command.studies.study import short_path
from framework.compute.stopwatch import duration
from framework.errors import UserError, printable_line
from framework.files.whole import write_whole

PAGE = "status.html"
PERIOD_S = 5.0  # between two writings, and two readings
MOST_ROWS = 2000
STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;
color:#1b1f24;background:#fff}table{border-collapse:collapse;width:100%}td,th{text-align:left;
padding:.2rem .6rem;border-bottom:1px solid #ddd;vertical-align:top}
progress{width:100%;height:1.2rem}
.failed{color:#b00020}.running{color:#0550ae}.waiting{color:#666}code{font-size:.9em}
@media(prefers-color-scheme:dark){body{color:#e6e6e6;background:#15181c}td,th{border-color:#444}
.failed{color:#ff8a80}.running{color:#7ab8ff}.waiting{color:#999}}"""

POLICY = (
    '<meta name=viewport content="width=device-width"><meta http-equiv=Content-Security-Policy'
    " content=\"default-src 'none'; style-src 'unsafe-inline'\">"
)


@dataclass(frozen=True)
class Row:
    """A run: its number, overrides, state (done, failed, running or waiting) and what of it."""

    number: int
    words: str
    state: str
    detail: str = ""


@dataclass(frozen=True)
class Status:
    """per_hour: runs that ended, by the time between the first and the last; None before two."""

    rows: tuple[Row, ...]
    counts: Counter[str]
    per_hour: float | None

    @property
    def left_s(self) -> float | None:
        """Seconds until all have ended, at this pace."""
        left = self.counts["running"] + self.counts["waiting"]
        return 3600 * left / self.per_hour if left and self.per_hour else None


def status(plan: Plan) -> Status:
    """Of the plan, now."""
    ended = plan.ended()
    at_work = running(plan, ended)
    rows = []
    for number, words in plan.runs:
        text = " ".join(words)
        if number in ended:
            error = ended[number].error
            rows.append(Row(number, text, "done" if error is None else "failed", error or ""))
        elif number in at_work:
            rows.append(Row(number, text, "running", at_work[number]))
        else:
            rows.append(Row(number, text, "waiting"))
    return Status(tuple(rows), Counter(row.state for row in rows), _per_hour(plan))


def told(plan: Plan, now: Status, queue: str = "") -> list[str]:
    """Lines for the terminal. queue: what the cluster says of the workers."""
    total, counts = len(now.rows), now.counts
    state = "cancelled" if plan.cancelled else "all ended" if _over(now) else "submitted"
    lines = [
        f"{plan.folder.name}: {state}, {counts['done']} of {total} runs done, {counts['failed']}"
        f" failed, {counts['running']} running, {counts['waiting']} waiting{queue}",
        f"  {plan.command}",
    ]
    if now.per_hour is not None and not _over(now):
        left = "" if now.left_s is None else f", about {duration(now.left_s)} left"
        lines.append(f"  {now.per_hour:.0f} runs an hour{left}")
    lines += [
        f"  running: {row.words} · {row.detail}" for row in now.rows if row.state == "running"
    ]
    failed = [row for row in now.rows if row.state == "failed"]
    lines += [f"  failed: {row.words} · {row.detail}" for row in failed[:20]]
    if len(failed) > 20:
        lines.append(f"  ... and {len(failed) - 20} more failed, see the page")
    lines.append(f"  page: {short_path(plan.folder / PAGE)}")
    return [printable_line(line) for line in lines]


def write_page(plan: Plan, force: bool = False) -> None:
    """Renew the page, unless it is but a few seconds old and runs are left."""
    path = plan.folder / PAGE
    with contextlib.suppress(OSError):
        young = time.time() - path.stat().st_mtime < PERIOD_S
        if young and not force and len(list(plan.ledger.glob("*.json"))) < len(plan.runs):
            return
    with contextlib.suppress(OSError, UserError):  # a full disk is the runs' to tell
        write_whole(path, page(plan, status(plan)))


def page(plan: Plan, now: Status) -> str:
    """HTML without scripts, that reloads itself until all have ended."""
    order = {"failed": 0, "running": 1, "waiting": 2, "done": 3}
    rows = sorted(now.rows, key=lambda row: (order[row.state], row.number))
    cells = [
        f"<tr class={row.state}><td>{row.number + 1}<td>{row.state}<td><code>"
        f"{html.escape(row.words)}</code><td>{html.escape(row.detail)}"
        for row in rows[:MOST_ROWS]
    ]
    more = f"<p>and {len(rows) - MOST_ROWS} more</p>" if len(rows) > MOST_ROWS else ""
    lines = [html.escape(line) for line in told(plan, now)[:3]]
    ended = now.counts["done"] + now.counts["failed"]
    reload = (
        ""
        if _over(now) or plan.cancelled
        else f'<meta http-equiv=refresh content="{PERIOD_S:.0f}">'
    )
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8>{reload}{POLICY}"
        f"<title>{ended}/{len(rows)} · {html.escape(plan.folder.name)}</title>"
        f"<style>{STYLE}</style>"
        f"<h1>{html.escape(plan.folder.name)}</h1><p>{'<br>'.join(lines)}</p>"
        f"<progress max={len(rows)} value={ended}></progress><p>as of {time.strftime('%F %T')}</p>"
        f"<table><tr><th>run<th>state<th>what<th>where or why{''.join(cells)}</table>{more}\n"
    )


def _over(now: Status) -> bool:
    return now.counts["running"] + now.counts["waiting"] == 0


def _per_hour(plan: Plan) -> float | None:
    times = sorted(_mtime(path) for path in plan.ledger.glob("*.json"))
    span = times[-1] - times[0] if len(times) > 1 else 0.0
    return 3600 * (len(times) - 1) / span if span > 0 else None


def _mtime(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0
