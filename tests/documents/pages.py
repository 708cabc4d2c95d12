"""The code blocks of a page: files for the reader to write, and commands to type."""

import math
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from framework.command.config.schema import ROOT

FENCE = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
COMMANDS = ("fishersplat", "python run.py")
QUICK = ("trainer.steps=10", "trainer.evaluations=1")
MOST_RUNS = 4  # of one command
SMALL = ("scene.width=96", "scene.height=72")  # the embedded scene's


@dataclass(frozen=True)
class Block:
    """language: of the fence. title: the file that it is saved as, "" for none. exit_code: of its
    commands."""

    language: str
    title: str
    text: str
    exit_code: int = 0

    def lines(self) -> Iterator[str]:
        """Its commands, a line each, without comments."""
        for line in self.text.splitlines():
            typed = re.sub(r"(^|\s)#.*", "", line).strip()
            if typed:
                yield typed


def blocks(page: Path) -> list[Block]:
    """The code blocks of a Markdown file in their order."""
    actual = []
    for language, rest, text in FENCE.findall(page.read_text(encoding="utf-8")):
        title = re.search(r'title="([^"]+)"', rest)
        code = re.search(r"exit=(\d+)", rest)
        actual.append(Block(language, title[1] if title else "", text, int(code[1]) if code else 0))
    return actual


def words_of(line: str) -> list[str] | None:
    """What a command line hands to the program; None for another program."""
    for command in COMMANDS:
        if line.startswith(f"{command} "):
            return shlex.split(line.removeprefix(f"{command} "))
    return None


def quick(words: list[str]) -> list[str]:
    """The same training, small, with few steps and seeds; what trains nothing as it is."""
    if words[0].isalpha() or {"--help", "--cfg", "--version"} & {*words}:
        return words
    swept = math.prod(word.count(",") + 1 for word in words)
    if swept > MOST_RUNS:
        words = [re.sub(r"^(seed=[^,]*),.*", r"\1", word) for word in words]
    if any(word.startswith("sweep=") for word in words):
        words = [*words, "seed=0,1"]
    embedded = not any(word.lstrip("+").startswith("scene=") for word in words)
    extra = [*QUICK, *(SMALL if embedded else ())]
    last = [word for word in words if word == "-m"]
    return [*(word for word in words if word != "-m"), *extra, *last]


def tutorials() -> list[Path]:
    """The pages whose every block runs, beside the README; the commands of other pages are composed
    and checked, see `tests/cli/test_documents.py`."""
    return sorted((ROOT / "docs" / "tutorials").glob("*.md"))
