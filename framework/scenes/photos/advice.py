"""Messages about photos that could not be placed, and what to do about them."""

import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from framework.scenes.formats import listed
from framework.scenes.photos.options import LEARNED, LEARNED_STEP
from framework.scenes.photos.result import Link, Overruled, Result

FLAT = 100  # features; a photo with fewer has too little texture
STRONG = 20  # matches; fewer may be chance
STILL = 0.005  # shift over the longer side; below, the camera has not moved
WEAK = 20  # 3D points; a pose from fewer is doubtful
NEARLY_ALL = 0.9


def stands_still(links: Sequence[Link]) -> bool:
    """Whether the camera has not moved in nearly all pairs, so that placing is pointless."""
    strong = _strong(links)
    still = [link for link in strong if link.flat and link.shift < STILL]
    return len(still) > NEARLY_ALL * len(strong)


def shows_no_depth(links: Sequence[Link], placed: Mapping[str, int]) -> bool:
    """Whether the camera has only turned in nearly all pairs, and the placed photos (name -> 3D
    points) see few points."""
    strong = _strong(links)
    flat = [link for link in strong if link.flat]
    weak = not placed or statistics.median(placed.values()) < WEAK
    return weak and len(flat) > NEARLY_ALL * len(strong)


def _strong(links: Sequence[Link]) -> list[Link]:
    return [link for link in links if link.matches >= STRONG]


def advice(result: Result) -> Iterator[str]:
    """Lines about a successful search."""
    if result.copies:
        pairs = [f"{copy} is {first}" for copy, first in result.copies.items()]
        yield f"left out as copies: {listed(pairs)}"
    for group in result.groups:
        yield (
            f"{len(group)} photos belong together, but not to the other {len(result.placed)}:"
            f" {listed(group)}; if it is the same scene, take photos that lead from one group to"
            " the other, else move them to a folder of their own"
        )
    grouped = {name for group in result.groups for name in group}
    alone = [name for name in result.photos if name not in grouped.union(result.placed)]
    if alone:
        described = [_with_neighbours(result, name) for name in alone]
        yield (
            f"{len(alone)} of {len(result.photos)} photos could not be placed: {listed(described)};"
            " take more between these, each a step from the last and with most of its view"
            f"{_or_networks(result)}"
        )
    weak = [f"{name} ({n})" for name, n in result.placed.items() if n < WEAK]
    if weak:
        yield (
            f"placed by few points, so perhaps wrongly: {listed(weak)}; take more photos near them,"
            " or remove them"
        )
    if result.held:
        yield (
            "the photos do not determine the focal length, so it is EXIF's, else 1.2 times the"
            " longer side; photos from farther apart, or with the camera's own EXIF, help"
        )
    if result.overruled:
        yield _overruled(result.overruled)


def failure(photo: Path, result: Result) -> str:
    """Why fewer than three photos could be placed.

    Args:
        photo: the first one, or the video.
    """
    where = photo if result.video else photo.parent
    flat = [name for name, n in result.features.items() if n < FLAT]
    strong = _strong(result.links)
    shift = statistics.median(link.shift for link in strong) if strong else 0.0
    best = max((link.matches for link in result.links), default=0)
    start = f"{where}: expected photos that show the same things from different places, got"
    if len(result.photos) - len(flat) < 3:
        return (
            f"{start} {len(flat)} of {len(result.photos)} photos without enough texture"
            f" ({listed(flat)}); poses need detail that stays in place: no bare walls, no blur"
        )
    if not strong:
        return (
            f"{start} photos with hardly anything in common (at most {best} matches between two);"
            " are they of one scene? take more, a small step between one and the next"
            f"{_or_networks(result)}"
        )
    if shift < STILL:
        return (
            f"{start} photos from one place (matches move by {100 * shift:.1f} % of the width);"
            " take some from other places, a step to the side each"
        )
    if shows_no_depth(result.links, result.placed):
        return (
            f"{start} a camera that only turned, or something flat (a homography explains all"
            f" matches of {len(strong)} pairs); take a step to the side between one and the next"
        )
    return (
        f"{start} too little overlap, or a camera that only turned ({len(strong)} pairs of photos"
        f" have {STRONG} matches or more, {best} at most, but no three of them fit together); take"
        " more, a step to the side between one and the next"
        f"{_or_networks(result)}"
    )


def _or_networks(result: Result) -> str:
    """The end of a remedy where networks were not tried."""
    tried = any(one.step == LEARNED_STEP.name for one in result.tries)
    return "" if tried else f", or set scene.matching={LEARNED}"


def _overruled(focal: Overruled) -> str:
    against = (
        "with which fewer photos can be placed"
        if focal.exif_error_px is None
        else f"which fits worse (by {focal.exif_error_px:.2f} pixels, not"
        f" {focal.found_error_px:.2f})"
    )
    return (
        f"the focal length is estimated from the photos, {focal.found_px:.0f} pixels, and not"
        f" EXIF's {focal.exif_px:.0f}, {against}; were they cropped or edited?"
    )


def _with_neighbours(result: Result, name: str) -> str:
    """The photo, with those it has most matches with."""
    if result.features.get(name, 0) < FLAT:
        return f"{name} (too little texture)"
    links = [link for link in result.links if name in (link.first, link.second)]
    others = [(-link.matches, min({link.first, link.second} - {name})) for link in links]
    nearest = [f"{other} {-n}" for n, other in sorted(others)[:2]]
    return f"{name} (matches: {', '.join(nearest) or 'none'})"
