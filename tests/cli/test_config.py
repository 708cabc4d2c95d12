"""The typed configuration: every choice composes, and a run's name contains what changed."""

from pathlib import Path

import pytest

from framework.command.config.check import check
from framework.command.config.naming import run_name, study_dir
from framework.command.config.schema import CONF_DIR, OBJECT_GROUPS, choices
from framework.errors import UserError
from tests.cli.conftest import composed

ALL = [(group, name) for group in OBJECT_GROUPS for name in choices(group)]
# for_scene comes with a scene, methods are in tests/cli/test_presets.py; published is for reports
NOT_CHOSEN = ("for_scene", "method", "published")
FILES = [p for p in sorted(CONF_DIR.glob("*/*.yaml")) if p.parent.name not in NOT_CHOSEN]
VARIANTS = [(p.parent.name, p.stem) for p in FILES]


@pytest.mark.parametrize(("group", "name"), ALL + VARIANTS)
def test_every_choice_composes(group: str, name: str) -> None:
    config = composed(f"{group}={name}")
    required = [key for key, value in (config.get(group) or {}).items() if value in ("???", "")]
    if required:
        with pytest.raises(UserError, match=rf"{group}\.{required[0]}"):
            check(config)
    else:
        check(config)


def test_the_hash_ignores_what_changes_no_run() -> None:
    config = composed()
    neutral = ("seed", "threads", "force", "study", "traceback", "tracker")
    changed = config | dict.fromkeys(neutral, 7)
    assert run_name(config, "a", "b").split("-")[-1] == run_name(changed, "a", "b").split("-")[-1]


def test_the_study_of_a_run() -> None:
    assert study_dir(Path("reports/embedded/runs/x")) == Path("reports/embedded")
    assert study_dir(Path("anywhere")) == Path("anywhere")
