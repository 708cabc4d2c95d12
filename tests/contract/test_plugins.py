"""What every discovered plugin must do, whoever wrote it."""

import dataclasses
from dataclasses import dataclass
from typing import Literal

import pytest

from framework import registry
from framework.errors import UserError
from framework.plugin import Augmenter, Capacity, Regularizer

BASES = {"augment": Augmenter, "reg": Regularizer, "capacity": Capacity}
ALL = [(group, name) for group in registry.GROUPS for name in sorted(registry.table(group))]


@pytest.mark.parametrize(("group", "name"), ALL)
def test_it_builds_from_its_defaults(group: str, name: str) -> None:
    """And is documented, and has a default for every option."""
    plugged = registry.build(group, {"name": name})
    assert isinstance(plugged.plugin, BASES[group])
    assert (plugged.plugin.group, plugged.plugin.name) == (group, name)
    assert plugged.weight >= 0
    cls = registry.lookup(group, name)
    assert cls.__doc__ and not cls.__doc__.startswith(f"{cls.__name__}(")
    for option, _, field in registry.option_fields(cls):
        assert field.default is not dataclasses.MISSING, option


def test_an_option_of_another_type_is_told_by_its_plugin() -> None:
    @dataclass(frozen=True)
    class Chosen(Regularizer):
        form: Literal["linear", "square"] = "linear"

    @dataclass(frozen=True)
    class Listed(Regularizer):
        forms: list[int] | None = None

    for cls, option in ((Chosen, "form"), (Listed, "forms")):
        with pytest.raises(UserError, match=rf"'{option}' of .* to be a bool, int, float or str"):
            registry.option_fields(cls)
