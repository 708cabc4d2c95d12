"""What to tell of photos that found no place, and what to do about it. Plain text of what `Found`
holds; nothing is computed from pixels here.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from framework.scenes.formats import listed
from framework.scenes.photos.found import Found, Link, Overruled

FLAT = 100  # features; a photo with fewer has too little texture
STRONG = 20  # matches; fewer may be chance
STILL = 0.005  # shift in shares of the longer side; the camera has not moved
CLOSE = 0.02  # of neighbours: frames of a video
WEAK = 20  # 3D points; a pose from fewer is not to be trusted
NEARLY_ALL = 0.9


def stands_still(links: Sequence[Link]) -> bool:
    """Whether nearly all matches say that the camera has not moved: not worth placing."""
    strong = [link for link in links if link.matches >= STRONG]
    still = [link for link in strong if link.flat and link.shift < STILL]
    return len(still) > NEARLY_ALL * len(strong)


def tells_no_depth(links: Sequence[Link], placed: Mapping[str, int]) -> bool:
    """Whether nearly all matches say that the camera has only turned, and what was placed all the
    same (name -> 3D points) hangs on a few points."""
    strong = [link for link in links if link.matches >= STRONG]
    flat = [link for link in strong if link.flat]
    weak = not placed or statistics.median(placed.values()) < WEAK
    return weak and len(flat) > NEARLY_ALL * len(strong)


def advice(found: Found) -> Iterator[str]:
    """Lines about a search that went well enough to go on."""
    if found.copies:
        pairs = [f"{copy} is {first}" for copy, first in found.copies.items()]
        yield f"left out as copies: {listed(pairs)}"
    yield from _groups(found)
    alone = [n for n in found.left_out if not any(n in group for group in found.groups)]
    if alone:
        told = [_neighbours(found, name) for name in alone]
        yield (
            f"{len(alone)} of {len(found.photos)} photos found no place: {listed(told)}; take more"
            " between these, each a step from the last and with most of its view"
        )
    weak = [f"{name} ({n})" for name, n in found.placed.items() if n < WEAK]
    if weak:
        yield (
            f"placed by few points, so perhaps wrongly: {listed(weak)}; take more photos near them,"
            " or remove them"
        )
    if found.held:
        yield (
            "the photos do not tell the focal length, so it was taken from EXIF, else as 1.2 times"
            " the longer side; photos from farther apart, or with EXIF as the camera wrote it, help"
        )
    if found.overruled:
        yield _focal(found.overruled)
    if not found.video and _is_video(found):
        yield (
            "neighbouring photos are nearly the same, as frames of a video are; every third or so"
            " is enough, or give the video itself: scene.path=clip.mp4 scene.frames=40"
        )


def failure(place: Path, found: Found) -> str:
    """Why fewer than three photos found a place, in one line. place: a photo, or the video."""
    where = place if found.video else place.parent
    flat = [name for name, n in found.features.items() if n < FLAT]
    strong = [link for link in found.links if link.matches >= STRONG]
    shift = statistics.median(link.shift for link in strong) if strong else 0.0
    best = max((link.matches for link in found.links), default=0)
    opening = f"{where}: expected photos that show the same things from different places, got"
    if len(found.photos) - len(flat) < 3:
        return (
            f"{opening} {len(flat)} of {len(found.photos)} photos without enough texture"
            f" ({listed(flat)}); poses need detail that stays in place: no bare walls, no blur"
        )
    if not strong:
        return (
            f"{opening} photos with hardly anything in common (at most {best} matches between two);"
            " are they of one scene? take more, a small step between one and the next"
        )
    if shift < STILL:
        return (
            f"{opening} photos from one place (matches move by {100 * shift:.1f} % of the width);"
            " take some from other places, a step to the side each"
        )
    if tells_no_depth(found.links, found.placed):
        return (
            f"{opening} a camera that only turned, or something flat (a homography explains all"
            f" matches of {len(strong)} pairs); take a step to the side between one and the next"
        )
    return (
        f"{opening} too little overlap, or a camera that only turned ({len(strong)} pairs of photos"
        f" have {STRONG} matches or more, {best} at most, but no three of them fit together); take"
        " more, a step to the side between one and the next"
    )


def _focal(told: Overruled) -> str:
    against = (
        "with which fewer photos find a place"
        if told.exif_error_px is None
        else f"which fits worse (by {told.exif_error_px:.2f} pixels, not {told.found_error_px:.2f})"
    )
    return (
        f"the focal length, {told.found_px:.0f} pixels, is what the photos tell, not EXIF's"
        f" {told.exif_px:.0f}, {against}; were they cropped or edited?"
    )


def _groups(found: Found) -> Iterator[str]:
    for group in found.groups:
        yield (
            f"{len(group)} photos belong together, but not to the other {len(found.placed)}:"
            f" {listed(group)}; if it is the same scene, take photos that lead from one group to"
            " the other, else move them to a folder of their own"
        )


def _neighbours(found: Found, name: str) -> str:
    """The photo, with those it has most in common with."""
    if found.features.get(name, 0) < FLAT:
        return f"{name} (too little texture)"
    links = [(link.matches, link.first, link.second) for link in found.links]
    near = sorted(((n, {a, b} - {name}) for n, a, b in links if name in (a, b)), key=_strength)
    told = [f"{next(iter(other))} {n}" for n, other in near[:2]]
    return f"{name} (matches: {', '.join(told) or 'none'})"


def _strength(entry: tuple[int, set[str]]) -> tuple[int, str]:
    """Most matches first, then by name."""
    return -entry[0], min(entry[1])


def _is_video(found: Found) -> bool:
    """Whether half of all neighbours, by name, show nearly the same."""
    shifts = {(link.first, link.second): link.shift for link in found.links}
    shifts |= {(b, a): shift for (a, b), shift in shifts.items()}
    neighbours = list(itertools.pairwise(found.photos))
    close = [pair for pair in neighbours if shifts.get(pair, 1.0) < CLOSE]
    return len(found.photos) > 10 and 2 * len(close) > len(neighbours)
