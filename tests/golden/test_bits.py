"""The numbers are those that were committed, on a simulated lesser processor, too.

A change that is meant to change numbers commits the new ones with it:
`python benchmarks/safety/determinism.py --update`.
"""

import json
import platform

import pytest

from benchmarks.safety.determinism import BITS, SSE, stages, versions


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the hash is of x86-64")
def test_the_bits_are_those_committed() -> None:
    expected = json.loads(BITS.read_text(encoding="utf-8"))
    actual = stages(SSE)
    differ = sorted(stage for stage in actual if actual[stage] != expected["stages"].get(stage))
    others = sorted(set(versions().items()) - set(expected["versions"].items()))
    if differ and others:
        pytest.skip(f"other versions than the committed bits': {others}; other bits: {differ}")
    assert not differ, (
        f"other bits: {differ}; if that is meant, run benchmarks/safety/determinism.py --update"
    )
    assert actual.keys() == expected["stages"].keys()
