"""The name of the kernels' cache changes with all that is compiled into them, and with nothing
else."""

from pathlib import Path

import pytest

from framework.compute import jit

KERNEL = (
    "from framework.compute.jit import kernel\nfrom framework.scenes.sizes import SIZE, other\n"
)


def test_constants_of_another_file_are_part_of_the_kernels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {
        "compute/jit.py": "import numba\n",
        "scenes/trace.py": KERNEL,
        "scenes/sizes.py": "SIZE = 3\n",
        "scenes/words.py": "TEXT = 'numba'\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "compute" / "jit.py"))
    first = jit._sources_hash()
    (tmp_path / "scenes" / "words.py").write_text("TEXT = 'other'\n")
    assert jit._sources_hash() == first
    (tmp_path / "scenes" / "sizes.py").write_text("SIZE = 4\n")
    second = jit._sources_hash()
    (tmp_path / "scenes" / "trace.py").write_text(KERNEL + "\n# other\n")
    assert len({first, second, jit._sources_hash()}) == 3
