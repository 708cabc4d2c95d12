"""Plugins that a test registers are gone after it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from framework import registry


@contextmanager
def as_before() -> Iterator[None]:
    """Every group has afterwards what it had before."""
    tables = [registry.table(group) for group in (*registry.GROUPS, *registry.PARTS)]
    before = [dict(table) for table in tables]
    try:
        yield
    finally:
        for table, content in zip(tables, before, strict=True):
            table.clear()
            table.update(content)
        for name in [name for name in sys.modules if name.startswith("own_plugins.")]:
            del sys.modules[name]
