"""HTML pages that need nothing else: what becomes of texts and data from elsewhere in them."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

PLACEHOLDER = re.compile(r"\{\{(\w+)\}\}")


def filled(template: str, values: Mapping[str, str]) -> str:
    """`{{name}}` replaced in one pass, so that no value is read as a template."""
    return PLACEHOLDER.sub(lambda found: values[found[1]], template)


def script_json(value: Any) -> str:
    """JSON that can stand in a script element: no `<` occurs in it."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def policy_hash(text: str) -> str:
    """How a content security policy names a script or style that stands in its page."""
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return f"'sha256-{digest}'"
