"""A video in place of photos: its sharpest frames."""

from pathlib import Path

import cv2
import pytest

from framework.errors import UserError
from framework.scenes.images import read_image
from framework.scenes.photos.video import sharpest_frames
from tests.scenes.pictures import HEIGHT, WIDTH, photograph, rig

SHARP = (1, 5, 6, 11)  # of 12 frames: the sharp one of each stretch of three


def write_video(path: Path) -> Path:
    """12 frames, all but four out of focus; frame k has a white square k at its upper edge."""
    picture = photograph(rig(6)[0])[..., ::-1]
    blurred = cv2.GaussianBlur(picture, (0, 0), 3)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10, (WIDTH, HEIGHT))
    for k in range(12):
        frame = (picture if k in SHARP else blurred).copy()
        frame[:24], frame[:24, 24 * k : 24 * k + 24] = 0, 255
        writer.write(frame)
    writer.release()
    return path


def test_the_sharpest_frame_of_each_stretch(tmp_path: Path) -> None:
    video, ticks = write_video(tmp_path / "clip.mp4"), []
    files = sharpest_frames(video, 4, tmp_path, lambda *at: ticks.append(at))
    shown = [int(read_image(file)[:24].mean(axis=(0, 2)).argmax()) // 24 for file in files]
    assert tuple(shown) == SHARP and ticks[-1] == (12, 12)
    assert [file.name for file in files] == sorted(file.name for file in files)


def test_what_is_no_video(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_bytes(b"no video at all" * 100)
    with pytest.raises(UserError, match=r"clip.mp4: expected a video that OpenCV reads, got a dam"):
        sharpest_frames(tmp_path / "clip.mp4", 4, tmp_path, lambda *_: None)
