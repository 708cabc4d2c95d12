"""How much steadier one method of a study is than another: a report sets all beside its baseline.

    python benchmarks/quality/pair_of_sigmas.py STUDY METHOD OTHER

Prints the ratio of their standard deviations over seeds with the interval of pairs, and the mean
difference in PSNR with its interval, both at 95 % and for this pair alone. STUDY is a folder with a
report's `runs.csv`, of one scene.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import pandas as pd
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.report.statistics.variance import compare_sigmas


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path)
    parser.add_argument("method")
    parser.add_argument("other")
    given = parser.parse_args()
    runs = pd.read_csv(given.study / "runs.csv")
    by_seed = runs.pivot(index="seed", columns="method", values="psnr")
    names = [given.method, given.other]
    shared = by_seed[names].dropna()  # what a pair's ratio is of
    a, b = (shared[name] if len(shared) > 2 else by_seed[name].dropna() for name in names)
    found = compare_sigmas(given.method, dict(a), given.other, dict(b))
    if found is None or found.interval is None:
        sys.exit(f"{given.study}: expected three seeds or more of both, got {len(a)} and {len(b)}")
    print(
        f"sigma {a.std():.3f} and {b.std():.3f} dB, ratio {found.ratio:.2f}"
        f" ({found.interval.low:.2f} to {found.interval.high:.2f}), p = {found.p:.2f}, r ="
        f" {found.rho if found.rho is None else round(found.rho, 2)}"
    )
    gap = (a - b).dropna()
    half = stats.t.ppf(0.975, len(gap) - 1) * gap.std() / math.sqrt(len(gap))
    print(
        f"PSNR {gap.mean():+.3f} dB ({gap.mean() - half:.3f} to {gap.mean() + half:.3f}),"
        f" {len(gap)} seeds"
    )


if __name__ == "__main__":
    main()
