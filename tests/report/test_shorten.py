"""Short names of capacities: one option where others follow from it, and a note of those."""

from __future__ import annotations

from framework.report.study.labels import MethodLabel, joined, listed
from framework.report.study.shorten import shortened


def short(*capacities: str) -> tuple[list[str], list[str]]:
    named, notes = shortened([MethodLabel("none + none", capacity=text) for text in capacities])
    return [label.capacity for label in named.values()], notes


def test_what_follows_is_left_out_and_told_once() -> None:
    texts = ("capacity=a, every=0.1, kind=x, until=1", "capacity=a, every=0.2, kind=y, until=1")
    names, notes = short(*texts, "capacity=b", "")
    assert names == ["capacity=a, kind=x", "capacity=a, kind=y", "capacity=b", ""]
    assert len(notes) == 1 and notes[0].startswith(
        "Short names: capacity=a, kind=x ran with every=0.1 and until=1; capacity=a, kind=y ran"
    )


def test_what_tells_names_apart_stays() -> None:
    texts = ("capacity=a, p=1, q=1", "capacity=a, p=1, q=2", "capacity=a, p=2, q=1")
    assert short(*texts) == ([*texts], [])
    assert short("capacity=a, p=1", "capacity=a, q=1") == (
        ["capacity=a, p=1", "capacity=a, q=1"],
        [],
    )
    assert short("capacity=a, p=1") == (["capacity=a, p=1"], [])


def test_names_with_commas_are_told_apart_in_a_list() -> None:
    """`a, b, steps=300 and c` reads as four methods."""
    assert listed(["a", "b", "c"], "and") == "a, b and c"
    assert listed(["a", "b, steps=300", "c"], "and") == "a; b, steps=300 and c"
    assert joined(["a", "b, steps=300", "c"]) == "a; b, steps=300; c"
    assert listed(["fern (n_views=3, split=llff)", "fox", "door"], "or").endswith(
        "llff), fox or door"
    )
