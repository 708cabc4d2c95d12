"""Read the runs of a study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd


@dataclass(frozen=True)
class Study:
    runs: pd.DataFrame


def load_study(path: Path | str) -> Study:
    raise NotImplementedError
