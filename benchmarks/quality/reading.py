"""How many words a reader reads in a report before five questions are answered: `python
benchmarks/quality/reading.py [COMMIT]`.

The phrases that answer them were found by reading; the script counts the words of `report.md` up to
the end of each, and up to the first figure, which ends the first screen. With COMMIT, of the
reports there, whose phrases are `BEFORE`.
"""

from __future__ import annotations

import subprocess
import sys

from framework.records.provenance import ROOT

QUESTIONS = ("which method", "how sure", "at what cost", "where it fails", "how big")
BEFORE = {
    "ablation_main": (None, "interval -0.02 to 0.03", "safi + none 23.7 s", "Worst seed", "53259"),
    "stress_views": ("safi + uar: no sig", "of the turning point", "Train", "22.94 ±", "10752"),
    "capacity": (None, "0.03 to 0.14", "1.1 times the CPU", "Worst seed", "0.12 times the par"),
    "pareto": ("steps=300, 26.07", "± 0.08 dB", "in 6.5 s", "Worst seed", "16128"),
    "stability": ("none + none reaches", "-0.03 to 0.14", "10.3 s", "Worst seed", "16128"),
}
AFTER = {
    "ablation_main": ("(plain", "(-0.19 to -0.01)", "none 20.8 s", "is weakest:", "53259"),
    "stress_views": ("(plain", "(-0.50 to -0.30)", "8.2 s", "is weakest on", "10752"),
    "capacity": ("(plain", "(-0.24 to -0.03)", "budget 18.4 s", "is weakest:", "5000 Gaussians"),
    "pareto": ("capacity=budget", "1.5 dB could", "(4.9 s", "its worst seed", "5,000 Gaussians"),
    "stability": ("(plain", "(-0.34 to -0.19)", "10.3 s", "its worst seed", "16128"),
}


def main() -> None:
    """Print the table."""
    commit = sys.argv[1] if len(sys.argv) > 1 else None
    print(f"| report | {' | '.join(QUESTIONS)} | first figure |")
    print(f"|:---|{'---:|' * 6}")
    for name, phrases in (BEFORE if commit else AFTER).items():
        text = _report(name, commit)
        counts = [_words(text, phrase) for phrase in (*phrases, "![")]
        print(f"| {name} | {' | '.join(counts)} |")


def _report(name: str, commit: str | None) -> str:
    inside = "reports/committed" if commit is None else "reports"  # where they were then
    path = f"{inside}/{name}/report.md"
    if commit is None:
        return (ROOT / path).read_text(encoding="utf-8")
    words = ["git", "show", f"{commit}:{path}"]
    return subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout


def _words(text: str, phrase: str | None) -> str:
    at = -1 if phrase is None else text.find(phrase)
    return "nowhere" if phrase is None or at < 0 else str(len(text[: at + len(phrase)].split()))


if __name__ == "__main__":
    main()
