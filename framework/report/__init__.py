"""Reports of a study, built from its records only; nothing here imports torch or the trainer.

`study` reads the records and derives the methods, `statistics` computes, `findings` collects the
answers, and `figures` draws. `render` writes them with the templates. The same records give the
same bytes.
"""

from framework.report.build import build_report

__all__ = ["build_report"]
