"""Photo files: which formats are read, and how a listed photo is found under another spelling."""

import importlib
import logging
import re
from collections.abc import Collection, Sequence
from pathlib import Path, PureWindowsPath

from framework.errors import UserError
from framework.files.opened import is_file, open_regular
from framework.files.paths import inside

log = logging.getLogger(__name__)

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")  # some of Pillow's other formats run programs
FORMAT_NAMES = "PNG, JPEG, WebP, TIFF or BMP"
SUFFIXES = {".png", ".jpg", ".jpeg", ".jfif", ".webp", ".tif", ".tiff", ".bmp"}
HEIC = {".heic", ".heif", ".hif"}
# optional Pillow plugins: their wheels contain libheif (LGPL) and, the second one, x265 (GPL)
HEIF_READERS = ("pi_heif", "pillow_heif")
RAW = {
    *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".orf", ".rw2", ".raf"),
    *(".pef", ".srw", ".raw", ".3fr", ".iiq"),
}  # some are TIFF files, of which Pillow would read the thumbnail
UNREAD = RAW | {".gif", ".avif", ".jxl", ".jp2", ".exr", ".hdr", ".tga", ".ppm", ".psd"}
VIDEO = {".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"}
SIGNATURES = {
    **{rb"\xff\xd8\xff": "JPEG", rb"\x89PNG": "PNG", rb"RIFF....WEBP": "WEBP"},
    **{rb"II\*\0|MM\0\*": "TIFF", rb"GIF8": "GIF", rb"....ftypavi": "AVIF"},
    **{rb"....ftyp(hei|hev|mif|msf)": "HEIC", rb"\0\0\0\x0cj[PX]": "JPEG 2000", rb"8BPS": "PSD"},
    **{rb"\xff\x0a|\0\0\0\x0cJXL": "JPEG XL", rb"v/1\x01": "OpenEXR"},
}
SHOWN = 5  # names in a message


def signature(start: bytes) -> str | None:
    """Name the picture format whose files start with these 12 bytes."""
    matches = (name for mark, name in SIGNATURES.items() if re.match(mark, start, re.DOTALL))
    return next(matches, None)


def pillow_formats(path: Path) -> tuple[str, ...]:
    """The formats that Pillow may try.

    Raises:
        UserError: for RAW photos, and for HEIC without a reader.
    """
    suffix = path.suffix.lower()
    if suffix in RAW:
        raise UserError(
            f"{path}: expected a photo in {FORMAT_NAMES}, got a RAW file ({suffix}); develop it to"
            " TIFF or JPEG first, for example with darktable or RawTherapee"
        )
    if suffix not in HEIC:
        return FORMATS
    for name in HEIF_READERS:
        try:
            importlib.import_module(name).register_heif_opener()
        except ImportError:
            continue
        return ("HEIF", *FORMATS)
    raise UserError(
        f"{path}: expected a photo in {FORMAT_NAMES}, got HEIC, which needs the package pi-heif;"
        " pip install pi-heif, or convert it to JPEG"
    )


def is_photo(path: Path) -> bool:
    """Whether a file is a photo: by its suffix, or, if it has none, by its first bytes."""
    if path.name.startswith("."):
        return False
    if path.suffix:
        return path.suffix.lower() in SUFFIXES | HEIC
    if not is_file(path):
        return False
    with open_regular(path, 2**63) as file:
        return signature(file.read(12)) in FORMATS


def warn_left_out(where: str, names: Sequence[str]) -> None:
    """Warn about files of a folder of photos that are not read."""
    if names:
        log.warning(
            f"{where}: {len(names)} files are left out, as their format is not read:"
            f" {listed(names)}; convert photos to {FORMAT_NAMES}"
        )


def unread_files(folder: Path, suffixes: Collection[str] = UNREAD) -> list[str]:
    """Names of the files with these suffixes, sorted, hidden ones omitted."""
    names = (p.name for p in folder.iterdir() if p.suffix.lower() in suffixes)
    return sorted(name for name in names if not name.startswith("."))


def listed(names: Sequence[str]) -> str:
    """The first five names, and the number of the others."""
    rest = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + rest


def find_photo(folder: Path, name: str) -> Path:
    """Find a photo by the name in a file of cameras.

    If no file has exactly this name, a backslash also separates folders, case is ignored, and the
    suffix may be missing. Of an absolute path (of another computer), the longest end that exists
    in `folder` counts, or else the bare name in `folder/images`.

    Returns:
        The file; `folder / name` if there is none.

    Raises:
        UserError: the name leads out of the folder, or several files match.
    """
    windows = PureWindowsPath(name)
    absolute = bool(windows.drive) or name.startswith(("/", "\\"))
    if not Path(name).is_absolute() and is_file(folder / name):
        return inside(folder, name)
    parts = [part for part in re.split(r"[/\\]", name) if part not in ("", ".")]
    elsewhere = is_file(folder / name) and not (folder / name).resolve().is_relative_to(
        folder.resolve()
    )
    if ".." not in parts and not elsewhere:
        parts = parts[1:] if windows.drive else parts
        ends = [parts[k:] for k in range(len(parts) if absolute else 1)]
        for end in [*ends, ["images", *parts[-1:]]] if absolute else ends:
            file = _match(folder, end)
            if file is not None:
                return inside(folder, file.relative_to(folder))
    return inside(folder, name)


def _match(folder: Path, parts: Sequence[str]) -> Path | None:
    """The file at `folder/parts`, in any case, with or without suffix."""
    path = folder
    for k, part in enumerate(parts):
        last = k == len(parts) - 1
        entries = sorted(path.iterdir()) if path.is_dir() else []
        exact = [e for e in entries if e.name == part]
        same = exact or [e for e in entries if e.name.casefold() == part.casefold()]
        if last and not same:
            same = [e for e in entries if e.stem.casefold() == part.casefold() and is_photo(e)]
        if last and len(same) > 1:
            raise UserError(
                f"{path / part}: expected one photo of that name, found"
                f" {', '.join(e.name for e in same)}; write the exact name with its suffix"
            )
        if len(same) != 1:
            return None
        path = same[0]
    return path if is_file(path) else None
