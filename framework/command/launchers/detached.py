"""Whether the launch of this process only submits (`fishersplat study submit`)."""

from __future__ import annotations

_command: str | None = None


def detach(command: str | None) -> None:
    """From now on launches start workers and come back at once. command: what was typed, for the
    plan; None ends it."""
    global _command
    _command = command


def detached() -> bool:
    return _command is not None


def submitted() -> str:
    """The command that submits."""
    assert _command is not None
    return _command
