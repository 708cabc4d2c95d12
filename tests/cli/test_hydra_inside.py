"""What breaks with a newer Hydra: the private parts that `hydra_inside` reaches into."""

from framework.command.config.schema import ROOT
from framework.command.hydra_inside import argument_parser

READ = ("help", "hydra_help", "cfg", "info", "shell_completion", "multirun", "resolve", "overrides")


def test_the_parser_has_the_flags_that_are_read() -> None:
    flags = vars(argument_parser().parse_args(["a=1", "-m"]))
    assert flags["multirun"] and flags["overrides"] == ["a=1"]
    missing = [name for name in READ if name not in flags]
    message = "framework/command/overrides.py reads it"
    assert not missing, f"Hydra's parser lost {missing}: {message}"


def test_only_one_file_reaches_into_hydra() -> None:
    files = [*(ROOT / "framework").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")]
    actual = [f.name for f in files if "hydra._internal" in f.read_text(encoding="utf-8")]
    assert actual == ["hydra_inside.py"]
