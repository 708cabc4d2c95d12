"""The page stands alone, and nothing from outside becomes markup in it or in the Markdown."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from framework.records.record import write_failed
from framework.report import build_report
from tests.record.fakes import fake_run, make_config

HOSTILE = (
    "<img src=x onerror=alert(1)>\"'</script><script>alert(2)</script>`[a](javascript:b) | {{body}}"
)


class Elements(HTMLParser):
    """Every element with its attributes, and the content of scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.found and self.found[-1][0] == "script" and data.strip():
            self.scripts.append(data)


@pytest.fixture(scope="module")
def study_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene, option, error and overrides with markup in them."""
    folder = tmp_path_factory.mktemp("hostile") / "study"
    init = {"name": "sparse", "path": HOSTILE}
    for seed in range(3):
        fake_run(folder, seed=seed, scene=HOSTILE, run_name=f"a{seed}")
        fake_run(folder, seed=seed, scene=HOSTILE, run_name=f"<b>&{seed}", init=init)
    write_failed(folder / "runs" / "x", make_config(seed=9), [HOSTILE], HOSTILE)
    build_report(folder, HOSTILE)
    return folder


@pytest.fixture(scope="module")
def page(study_dir: Path) -> str:
    return (study_dir / "report.html").read_text(encoding="utf-8")


def test_no_markup_from_outside(page: str) -> None:
    elements = Elements(page)
    assert not [
        tag for tag, attributes in elements.found if any(k.startswith("on") for k in attributes)
    ]
    assert [tag for tag, _ in elements.found].count("script") == 2
    assert not [a for _, a in elements.found if "javascript:" in str(a.get("href"))]
    assert "alert(2)" not in elements.scripts[1]
    assert HOSTILE.replace("`", "'") in json.loads(elements.scripts[0])["shots"][0][0]
    assert not [tag for tag, attributes in elements.found if "style" in attributes], "the policy"


def test_no_markup_from_outside_in_markdown(study_dir: Path) -> None:
    text = re.sub(r"`[^`]*`", "", (study_dir / "report.md").read_text(encoding="utf-8"))
    assert not re.search(r"(?<!\\)<[a-z/]", text)
    assert "](javascript" not in text


def test_the_page_needs_nothing_else(page: str) -> None:
    for tag, attributes in Elements(page).found:
        source = attributes.get("src") or (attributes.get("href") if tag == "link" else None)
        assert source is None or source.startswith("data:")
    assert (
        "default-src 'none'" in page
        and "@import" not in page
        and "http://" not in re.sub(r'"http://www\.w3\.org/(2000/svg|1999/xlink)"', "", page)
    )


@pytest.fixture
def looked_at(tmp_path: Path) -> Path:
    """Two runs; the first has a page and a video."""
    first, _ = (fake_run(tmp_path, augment, run_name=augment) for augment in ("none", "safi"))
    (first / "view.html").write_text("page")
    (first / "video.webp").write_bytes(b"video")
    return tmp_path


def _data(folder: Path, key: str) -> list[list[object]]:
    page = (folder / "report.html").read_text(encoding="utf-8")
    return list(json.loads(Elements(page).scripts[0])[key])


def test_the_page_and_the_video_of_a_run_are_linked(looked_at: Path) -> None:
    report = build_report(looked_at).path.read_text(encoding="utf-8")
    assert "[in 3D](runs/none/view.html)" in report and "[video](runs/none/video.webp)" in report
    assert "runs/safi/view.html" not in report
    links = [(one[2], *one[3:]) for one in _data(looked_at, "looks")]
    assert links == [(0, "in 3D", "runs/none/view.html"), (0, "video", "runs/none/video.webp")]
    report = build_report(looked_at, photos=False).path.read_text(encoding="utf-8")
    assert "view.html" not in report and _data(looked_at, "looks") == []
    for name in ("view.html", "video.webp"):
        (looked_at / "runs" / "none" / name).unlink()
    assert not re.search(
        r"\| (View|Video) ", build_report(looked_at).path.read_text(encoding="utf-8")
    )
