"""Count code lines: without blank lines, comments and docstrings.

    python benchmarks/lines.py [--rooms]

One row per package, with the median and the 90th percentile of the lengths of its functions (code
lines) and of its lines (characters). `--rooms` adds the folders of framework/.
"""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tokenize
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("framework", "plugins", "hydra_plugins", "fishersplat", "tests", "benchmarks")
SKIPPED = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
SCOPES = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Count:
    """Counts of one package: code lines, and lengths of functions and lines."""

    files: int = 0
    lines: int = 0
    functions: list[int] = field(default_factory=list)
    widths: list[int] = field(default_factory=list)

    def add(self, source: str) -> None:
        """Count one file."""
        tree = ast.parse(source)
        code = code_lines(source, tree)
        text = source.splitlines()
        self.files += 1
        self.lines += len(code)
        self.widths += [len(text[line - 1]) for line in code]
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                end = node.end_lineno or node.lineno
                self.functions.append(len(code & set(range(node.lineno, end + 1))))

    def row(self, name: str) -> str:
        functions = np.percentile(self.functions or [0], [50, 90])
        widths = np.percentile(self.widths or [0], [50, 90])
        cells = (name, self.files, f"{self.lines:,}", *(f"{x:.0f}" for x in (*functions, *widths)))
        return f"| {' | '.join(map(str, cells))} |"


def code_lines(source: str, tree: ast.Module) -> set[int]:
    """Numbers of the lines that hold code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in SKIPPED:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if isinstance(node, SCOPES) and ast.get_docstring(node) is not None:
            lines -= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    ends = len(source.splitlines())
    return {line for line in lines if line <= ends}


def main() -> None:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True)
    counts: dict[str, Count] = {}
    for name in listed.stdout.split():
        path = Path(name)
        if not (ROOT / path).is_file():
            continue
        keys = [path.parts[0]] if path.parts[0] in PACKAGES else []
        if "--rooms" in sys.argv and path.parts[0] == "framework" and len(path.parts) > 2:
            keys.append("/".join(path.parts[:2]))
        for key in keys:
            counts.setdefault(key, Count()).add((ROOT / path).read_text(encoding="utf-8"))
    print("| package | files | code lines | function: median | 90 % | width: median | 90 % |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for key in sorted(counts):
        print(counts[key].row(key))


if __name__ == "__main__":
    main()
