"""Published figures of methods, from `conf/published/NAME.yaml`: a file per method with its title,
its paper, and what its authors and others measured on data sets and scenes."""

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import framework
from framework.files.documents import read_yaml
from framework.registry import SWEPT

IDEA = "_here"  # ends the name of a recipe that takes one idea alone
PACKAGE = Path(framework.__file__).resolve().parent
FOLDERS = [home / "conf" / "published" for home in (PACKAGE, PACKAGE.parent)]


@dataclass(frozen=True)
class Published:
    """A method of the literature.

    Attributes:
        name: stem of its file.
        recipe: name in `conf/method`; "" if there is none.
        data_sets: data set -> published and repeated means with three views.
        scenes: rows of figures on single scenes, as text.
        paper: the fields of the BibTeX entry, with its key.
    """

    title: str
    name: str
    recipe: str = ""
    note: str = ""
    data_sets: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    scenes: tuple[Mapping[str, str], ...] = ()
    paper: Mapping[str, str] = field(default_factory=dict)

    @property
    def bibtex(self) -> str:
        """The BibTeX entry of the paper."""
        fields = [f"  {k} = {{{v}}}" for k, v in self.paper.items() if k != "key"]
        return f"@article{{{self.paper['key']},\n" + ",\n".join(fields) + "\n}"


@functools.cache
def literature() -> tuple[Published, ...]:
    """All methods with published figures, by recipe."""
    folder = next(folder for folder in FOLDERS if folder.is_dir())
    files = [(path.stem, read_yaml(path)) for path in sorted(folder.glob("*.yaml"))]
    return tuple(
        Published(
            title=content["title"],
            name=stem,
            recipe="" if content.get("published_only") else stem,
            note=content.get("note", ""),
            data_sets={name: content[name] for name in ("LLFF", "DTU") if name in content},
            scenes=tuple(content.get("scenes", ())),
            paper=content.get("paper", {}),
        )
        for stem, content in files
    )


def recipe_title(recipe: str) -> str:
    """The display name of a recipe, as "CoR-GS (plane sweep)"; its own name if it has no other."""
    titles = {entry.name: entry.title for entry in literature()}
    for suffix, text in ((SWEPT, " (plane sweep)"), (IDEA, " (idea alone)"), ("", "")):
        name = recipe.removesuffix(suffix)
        if recipe.endswith(suffix) and name in titles:
            return f"{titles[name]}{text}"
    return recipe


def bibtex(names: Iterable[str]) -> str:
    """Entries of papers, by the names of their files or as BibTeX, and of the software, sorted."""
    files = {entry.name: entry.bibtex for entry in literature() if entry.paper}
    entries = {files.get(name, name) for name in ("baseline", *names)}
    return "\n\n".join(sorted(entry for entry in entries if entry.startswith("@")))
