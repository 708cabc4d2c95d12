"""Reports of a study, from its records only: nothing here imports torch or the trainer.

`collect` reads the records and names the methods, `statistics` computes, `finding` says it in a
sentence, `tables` and `figures` show it, `markdown` puts it on a page. The same records give the
same bytes.
"""

from framework.report.build import build_report

__all__ = ["build_report"]
