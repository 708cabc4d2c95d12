"""Files are opened and written by the modules that do it safely, and by few others."""

from __future__ import annotations

import ast

from framework.command.config.schema import ROOT

OPENERS = ("framework/files/opened.py",)  # the one place where files from elsewhere are opened
OWN = {  # our own sources and settings, caches and what was written a moment ago
    *("framework/compute/jit.py", "framework/records/provenance.py", "framework/files/whole.py"),
    *("framework/run/plugin_code.py", "framework/command/streams.py"),
    *(
        "framework/files/locks.py",
        "framework/records/progress.py",
        "framework/scenes/embedded/generate.py",
    ),
    *("framework/report/render.py", "framework/command/studies/study.py"),
    # the report just written; the page's own scripts; exports just made, a film's writer; a browser
    *("framework/command/studies/closing.py", "framework/view/page.py"),
    *("framework/exports/formats.py", "framework/exports/movie.py", "framework/view/server.py"),
    *("framework/command/config/help.py", "framework/command/config/meanings.py"),
    # tables of the package itself
    *("framework/report/figures/palette.py", "framework/report/study/scenes.py"),
    # what a search for poses has just made of photos that were opened safely; a database
    *("framework/scenes/photos/process.py", "framework/scenes/photos/prepare.py"),
    "framework/scenes/photos/attempt.py",
    "framework/metrics/lpips_weights.py",  # an archive whose hash is checked
    "framework/train/plugin_calls.py",  # opens a count, no file
}


WRITERS = {  # beside `write_whole` and the locks: temporary or own folders, the cache, /proc
    *("framework/files/whole.py", "framework/files/locks.py"),
    *("framework/files/tidy.py", "framework/run/warmup.py", "framework/records/provenance.py"),
    *("framework/metrics/lpips_weights.py", "framework/scenes/colmap_model.py"),
    "framework/scenes/photos/attempt.py",
    "framework/exports/movie.py",  # a file that the command line names
}
SOURCES = {path: ast.parse(path.read_text("utf-8")) for path in (ROOT / "framework").rglob("*.py")}


READING = ("open", "read_text", "read_bytes", "imread", "copyfile")
WRITING = ("open", "write_text", "write_bytes", "touch")


def calls(tree: ast.Module, names: tuple[str, ...]) -> list[tuple[str, ast.Call]]:
    """(what is called, the call) for every call in a source of a function or method that has
    one of these names."""
    nodes = [n for n in ast.walk(tree) if isinstance(n, ast.Call)]
    named = [n for n in nodes if getattr(n.func, "attr", getattr(n.func, "id", "")) in names]
    return [(ast.unparse(node.func), node) for node in named]


def test_files_are_opened_at_one_place() -> None:
    """Bounded and regular ones, but where the program's own files are read."""
    for path, tree in SOURCES.items():
        if path.relative_to(ROOT).as_posix() not in {*OPENERS, *OWN}:
            found = {called for called, _ in calls(tree, READING)}
            ours = {"read_text", "read_bytes", "archive.open", "zipfile.open", "Image.open"}
            assert not found - ours, path


def test_files_are_written_at_one_place() -> None:
    """Whole or not at all, and never through a link: `framework.files.whole`."""
    for path, tree in SOURCES.items():
        if path.relative_to(ROOT).as_posix() not in WRITERS:
            for called, node in calls(tree, WRITING):
                modes = [str(arg.value) for arg in node.args if isinstance(arg, ast.Constant)]
                reads = called.endswith("open") and not any(m[:1] in {*"wax"} for m in modes)
                assert reads, f"{path}: {ast.unparse(node)}"
