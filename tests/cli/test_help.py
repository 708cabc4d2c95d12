"""`--help` explains every option."""

from dataclasses import dataclass

import pytest

from framework.command.cli import main
from framework.command.config.help import option_meanings
from framework.command.config.meanings import meanings
from framework.command.config.schema import OBJECT_GROUPS, choices, rows
from framework.options import TrainerOptions


@dataclass(frozen=True)
class Base:
    """Of both. eta: how near, e.g. 1.5; more is farther. And more: nothing.

    low, high: the ends of it.
    """

    eta: float = 1.5
    low: int = 0
    high: int = 9
    more: int = 0


@dataclass(frozen=True)
class Child(Base):
    """every: how often."""

    low: int = 1  # another low end
    every: int = 2
    quiet: str = "# nothing"


def test_meanings_come_from_docstrings_and_comments() -> None:
    assert meanings(Child) == {
        "eta": "how near, e.g. 1.5; more is farther",
        "high": "the ends of it",
        "low": "another low end",
        "every": "how often",
        "more": "nothing",
    }


@pytest.mark.parametrize("group", [*OBJECT_GROUPS, "trainer"])
def test_every_option_has_a_meaning(group: str) -> None:
    if group == "trainer":
        assert set(meanings(TrainerOptions)) == set(TrainerOptions.__dataclass_fields__)
        return
    for name in choices(group):
        message = option_meanings(group, name)
        silent = {option[0] for option in rows(group, name)} - set(message)
        assert not silent, f"{group}={name}: what do {silent} mean?"
        cut = [text for text in message.values() if text.endswith("...")]
        assert not cut, f"{group}={name}: shorten the first sentence, which help cuts off: {cut}"


def test_the_help_shows_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help", "augment=safi", "preset=best"]) == 0
    lines = capsys.readouterr().out.splitlines()
    message = [line.split("#")[1] for line in lines if line.startswith("  eta: 1.5 ")]
    assert message == [" a view is a support if I_k is at most eta x the smallest"]
    options = lines[lines.index("trainer:") :]
    unexplained = [line for line in options if line.startswith("  ") and "# " not in line]
    assert len(options) > 50 and all("name: " in line for line in unexplained)
