"""The page stands alone, and nothing from outside becomes markup in it or in the Markdown."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from framework.records.record import write_failed
from framework.report import build_report, gallery, render
from framework.report.study.collect import collect
from tests.record.fakes import fake_run, make_config
from tests.report.studies import write_study

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


def test_the_viewer_has_every_method_view_and_seed(page: str) -> None:
    data = json.loads(Elements(page).scripts[0])
    assert len({tuple(shot[1:4]) for shot in data["shots"]}) == len(data["shots"]) == 2 * 3 * 4
    assert max(max(shot[5:8]) for shot in data["shots"]) == len(data["images"]) - 1
    assert all(image.startswith("data:image/webp;base64,") for image in data["images"])
    assert {shot[8] for shot in data["shots"]} == set(range(len(data["methods"])))


def test_charts_are_drawn_once_and_can_be_filtered(page: str, study_dir: Path) -> None:
    marks = [a for tag, a in Elements(page).found if tag == "g" and "data-method" in a]
    assert {mark["data-method"] for mark in marks} == {"0", "1"}
    svg = (study_dir / "differences.svg").read_text(encoding="utf-8")
    assert page.count("<svg ") == len(list(study_dir.glob("*.svg"))) and "method" in svg
    assert "var(--s0)" in page and 'stroke="#000000"' not in page.partition("<script")[0]


def test_the_contents_link_to_every_section(page: str) -> None:
    ids = {str(a["id"]) for tag, a in Elements(page).found if tag == "h2"}
    (contents,) = re.findall(r'<nav class="toc".*?</nav>', page, re.DOTALL)
    assert set(re.findall(r'href="#([^"]+)"', contents)) == ids >= {"results", "appendix"}


def test_what_does_not_fit_is_told(study_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "MOST_BYTES", 1)
    actual = gallery.gallery(study := collect(study_dir), study.scenes)
    assert {(shot[1], shot[2]) for shot in actual.shots} == {(str(m), 0) for m in study.methods}
    assert len(actual.shots) == 2 and actual.left_out == 22


def test_what_is_about_one_of_many_scenes_is_folded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(render.templates().globals, "MANY", 3)  # as with 12, and sooner
    for name, scenes in (("few", 2), ("many", 3)):
        write_study(tmp_path / name, scenes=scenes, seeds=1)
        build_report(tmp_path / name)
    few, many = ((tmp_path / n / "report.md").read_text(encoding="utf-8") for n in ("few", "many"))
    assert "<details>" not in few and "\n### scene0\n" in few
    inside = re.findall(r"<details><summary>(.+?)</summary>(.*?)</details>", many, re.DOTALL)
    assert len(inside) == many.count("<details>") == many.count("</details>")
    assert {scene for scene, _ in inside} == {f"scene{i}" for i in range(3)}
    assert not any(re.search(r"^## |Machine: ", text, re.MULTILINE) for _, text in inside)


def test_no_two_headings_share_a_link(tmp_path: Path) -> None:
    page = render.Page("x", tmp_path)
    names = [page.heading(2, text).anchor for text in ("a", "A", "a 2", "a", "a")]
    assert names[:2] == ["a", "a-1"] and len({*names}) == len(names)


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
    report = build_report(looked_at).read_text(encoding="utf-8")
    assert "[in 3D](runs/none/view.html)" in report and "[video](runs/none/video.webp)" in report
    assert "runs/safi/view.html" not in report
    links = [(one[2], *one[3:]) for one in _data(looked_at, "looks")]
    assert links == [(0, "in 3D", "runs/none/view.html"), (0, "video", "runs/none/video.webp")]
    report = build_report(looked_at, photos=False).read_text(encoding="utf-8")
    assert "view.html" not in report and _data(looked_at, "looks") == []
    for name in ("view.html", "video.webp"):
        (looked_at / "runs" / "none" / name).unlink()
    assert not re.search(r"\| (View|Video) ", build_report(looked_at).read_text(encoding="utf-8"))


def test_the_page_holds_a_small_video_of_each_method(
    looked_at: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build_report(looked_at)
    (video,) = _data(looked_at, "videos")
    assert video[2:] == [0, "data:image/webp;base64,dmlkZW8="]
    monkeypatch.setattr(gallery, "VIDEO_BYTES", 4)
    build_report(looked_at)
    assert _data(looked_at, "videos") == [] and len(_data(looked_at, "looks")) == 2
