"""`fishersplat search`: its space, that no test view chooses, and that a kill loses nothing."""

from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from framework.command import cli
from framework.command.search import driver
from framework.command.search.driver import Search, run_search
from framework.command.search.space import Dimension, space_of
from framework.command.search.trial import Result
from framework.errors import UserError
from framework.records.search import SEARCH, read_search
from framework.scenes.splits import HELD_OUT, PROTOCOLS, UNTESTED, protocol


def test_the_grammar_of_a_space() -> None:
    fixed, space = space_of(
        [
            "seed=1",
            "a=interval(1.0,2.0)",
            "b=tag(log,interval(0.1,10.0))",
            "c=int(interval(1,3))",
            "d=x,y",
        ]
    )
    assert fixed == ["seed=1"]
    assert space == [
        Dimension("a", 1.0, 2.0),
        Dimension("b", 0.1, 10.0, log=True),
        Dimension("c", 1.0, 3.0, whole=True),
        Dimension("d", choices=("x", "y")),
    ]
    assert [dimension.first for dimension in space] == ["a=1.0", "b=0.1", "c=1", "d=x"]


@pytest.mark.parametrize(
    "words", [["seed=1"], ["a=interval(2,1)"], ["a=tag(log,interval(0,1))"], ["a=interval(0,inf)"]]
)
def test_no_space(words: list[str]) -> None:
    with pytest.raises(UserError, match="expected"):
        space_of(words)


@pytest.mark.parametrize(
    "name", [n for n in PROTOCOLS if not n.endswith(HELD_OUT) and n != UNTESTED]
)
@pytest.mark.parametrize("n_views", [1, 3, 6])
def test_held_out_views_train_as_before_and_test_nothing(name: str, n_views: int) -> None:
    names = [f"{i:03d}" for i in range(protocol(name).images or 49)]
    usual = protocol(name).split(names, n_views, "here")
    held = protocol(f"{name}{HELD_OUT}").split(names, n_views, "here")
    assert held.train == usual.train
    assert 1 <= len(held.test) <= 6
    assert not {*held.test} & {*usual.test, *usual.train}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("trainer.lr_scale=interval(1.0,2.0)", "choose another, test views may not choose"),
        ("+augment=safi reg=none,[uar,depth_rank]", "choose another, test views may not choose"),
        ("trainer.lr_scale=2", "expected an option that varies"),
        ("reg=none,uar seed=0,1,2", "got seed, which would choose what is measured; give one"),
        ("hydra.sweep.dir=x reg=none,uar", "expected options of a run"),
        ("reg=none,uar trainer.lr_scale=interval(-1.0,2.0)", "trainer.lr_scale"),
    ],
)
def test_it_refuses_in_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    line: str,
    expected: str,
) -> None:
    pytest.importorskip("optuna", reason="optuna is an extra")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["search", *line.split()]) == 2
    message = capsys.readouterr().err
    assert expected in message and len(message.splitlines()) == 1
    assert not list(tmp_path.iterdir())


class Fake:
    """A slot whose runs take no time. done: the words of all requested runs."""

    done: list[list[str]]
    kill_after: int

    def submit(self, words: list[str], label: str, metric: str) -> Future[Result]:
        future: Future[Result] = Future()
        Fake.done.append(words)
        if len(Fake.done) == Fake.kill_after:
            raise KeyboardInterrupt
        x = float(words[1].partition("=")[2])
        if words[2] == "reg=broken":
            future.set_result(Result("runs/bad", None, error="broken"))
        elif words[2] == "reg=killed":
            future.set_exception(BrokenProcessPool())
        else:
            future.set_result(Result(f"runs/{x}", -((x - 3) ** 2), 1.5))
        return future

    def close(self) -> None: ...


def search(folder: Path, trials: int = 12, choices: tuple[str, ...] = ("none", "uar")) -> Search:
    space = (Dimension("x", 1.0, 5.0), Dimension("reg", choices=choices))
    return Search(folder, ("fixed=1",), space, "psnr", trials, 2, 0)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> type[Fake]:
    pytest.importorskip("optuna", reason="optuna is an extra")
    Fake.done, Fake.kill_after = [], 0
    monkeypatch.setattr(driver, "Slot", Fake)
    return Fake


def test_an_interrupted_search_loses_and_doubles_nothing(tmp_path: Path, fake: type[Fake]) -> None:
    fake.kill_after = 6
    with pytest.raises(KeyboardInterrupt):
        run_search(search(tmp_path))
    under_way = fake.done[-1]
    fake.kill_after = 0
    best = run_search(search(tmp_path))
    actual = read_search(tmp_path)
    assert actual is not None and [trial.number for trial in actual.trials] == list(range(12))
    words = [" ".join(words) for words in fake.done]
    assert words.count(" ".join(under_way)) == 2, "begun, and done after the kill"
    assert len({*words}) == 12
    top = max(actual.trials, key=lambda trial: trial.value or -1e9)
    assert best == list(top.words)
    assert run_search(search(tmp_path)) == best and len(fake.done) == len(words)  # all are done
    with pytest.raises(UserError, match="got another"):
        run_search(search(tmp_path, choices=("none",)))


@pytest.mark.parametrize("way", ["broken", "killed"])
def test_a_trial_that_fails_counts(tmp_path: Path, fake: type[Fake], way: str) -> None:
    run_search(search(tmp_path, 4, (way,)))
    actual = read_search(tmp_path)
    assert actual is not None and len(actual.trials) == 4
    assert all(trial.value is None and way in trial.error for trial in actual.trials)


@pytest.mark.parametrize("content", ["[]", '{"metric": "psnr", "fixed": [], "trials": [1]}'])
def test_a_forged_search_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / SEARCH).write_text(content)
    with pytest.raises(UserError, match="expected the trials of a search"):
        read_search(tmp_path)
