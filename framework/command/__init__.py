"""The command line.

`entry` starts the program, `cli` parses the line, `runner` does a run. `config/` has the typed
configuration and its checks, `studies/` handles many runs, `launchers/` runs them on other
machines, `search/` optimises options. Nothing heavy is imported before a run starts.
"""

__all__ = ["cli", "entry"]
