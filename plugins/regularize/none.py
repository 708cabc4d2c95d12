"""`reg=none`: the photometric loss alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from framework.plugin import Regularizer, register


@register("reg", "none")
@dataclass(frozen=True)
class NoRegularization(Regularizer):
    """Neither opacity factors nor a loss term."""

    idle: ClassVar[bool] = True
