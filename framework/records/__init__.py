"""A run while it works (`progress`, `notices`) and on disk (`record`, `run_files`, `ply`,
`cameras`). `record_check` checks files from elsewhere, `provenance` records code and
machine."""

RUN_FOLDERS = "runs"  # in the folder of a study; each of its runs has one there
