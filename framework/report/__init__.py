"""Reports of studies, from their records only: nothing here imports torch or the trainer.

`study` reads the records and names the methods. `statistics` computes the numbers, `findings`
compares the methods, and `tables`, `figures` and `templates` render. The same records give the same
bytes.
"""

from framework.report.build import build_report

__all__ = ["build_report"]
