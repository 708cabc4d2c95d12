"""What a user types, and what they are told.

`entry` begins, `cli` reads the line, `runner` does the runs; `config/` says what may be asked for
and checks it, `studies/` is about many runs at once. Nothing heavy is imported before a run starts.
"""

__all__ = ["cli", "entry"]
