"""A run's identity covers the plugin files that it uses, and no others."""

from pathlib import Path

import pytest

from framework import registry
from framework.files.paths import OWN_VARIABLE
from framework.run import plugin_code
from framework.run.plugin_code import plugin_hashes
from tests.documents.registered import as_before

PLUGIN = """{imports}
from dataclasses import dataclass
from framework.plugin import Regularizer, register

@register("reg", "{name}")
@dataclass(frozen=True)
class Mine(Regularizer):
    def loss(self, ctx, state, view, render):
        return render.rgb.mean()
"""
NONE = {"name": "none"}


def hashed(name: str) -> str:
    parts = dict.fromkeys(("augment", "capacity", "scene", "depth", "init"), NONE)
    plugin_code._sources.cache_clear()
    return plugin_hashes({**parts, "metrics": {}, "reg": {"name": name}})[f"reg={name}"]


@pytest.mark.parametrize(
    ("imports", "edited", "another"),
    [
        ("", "mine_a.py", True),
        ("", "mine_b.py", False),
        ("", "_helper.py", False),
        ("if 0: import _helper", "_helper.py", True),
        ("if 0: import _helper", "_deeper.py", True),
        ("import importlib", "mine_b.py", True),
        ("from framework import registry", "_helper.py", True),
    ],
)
def test_an_edit_is_another_run_only_for_those_that_use_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, imports: str, edited: str, another: bool
) -> None:
    for name in ("mine_a", "mine_b"):
        (tmp_path / f"{name}.py").write_text(PLUGIN.format(imports=imports, name=name))
    (tmp_path / "mine_b.py").write_text(PLUGIN.format(imports="", name="mine_b"))
    (tmp_path / "_helper.py").write_text("import _deeper")
    (tmp_path / "_deeper.py").write_text("A = 1")
    registry.discover()
    monkeypatch.setattr(registry, "_classes", {g: {**t} for g, t in registry._classes.items()})
    monkeypatch.setenv(OWN_VARIABLE, str(tmp_path))
    with as_before():
        registry.discover()
        before = hashed("mine_a")
        (tmp_path / edited).write_text((tmp_path / edited).read_text() + "\n# edited\n")
        assert (hashed("mine_a") != before) is another
