"""Reports of a study, from its records only: nothing here imports torch or the trainer.

`study` reads the records and names the methods, `statistics` computes, `verdict` says what to use,
`text` and `figures` show it, `opening`, `sections` and `details` put it in order, `page` writes it
down. The same records give the same bytes.
"""

from framework.report.build import build_report

__all__ = ["build_report"]
