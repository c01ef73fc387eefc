"""What came of a batch, to look at: a contact sheet with one still of each film, and a page of films."""

from __future__ import annotations

import html
import subprocess
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from urllib.parse import quote

from PIL import Image, ImageDraw, ImageFont, ImageOps

from ..output import is_whole_png
from ..output.ffmpeg import find_ffmpeg
from ..output.files import atomic_file
from .record import Entry, Record

SHEET_NAME, PAGE_NAME = "contact.png", "index.html"
_MOST = 100  # films on one sheet
_COLUMNS = 5
_WIDTH, _HEIGHT, _MARGIN, _TEXT = 288, 162, 8, 16  # pixels of a still, of the gap, of a line
_LINES = 2
_LONGEST = 44  # characters in a line below a still
_BACK, _PALE, _BRIGHT = (18, 18, 20), (150, 150, 155), (225, 225, 228)
_LARGEST = 1 << 28  # pixels of a still that is opened


def show(record: Record) -> list[Path]:
    """Write the contact sheets and the page into the batch's folder; return their paths. Raises OSError."""
    entries = list(record.entries.values())
    sheets = []
    for first in range(0, len(entries), _MOST):
        number = first // _MOST + 1
        path = record.folder / (SHEET_NAME if number == 1 else f"contact-{number}.png")
        with atomic_file(path) as file:
            contact_sheet(record, entries[first : first + _MOST]).save(file, "PNG")
        sheets.append(path)
    page = record.folder / PAGE_NAME
    with atomic_file(page) as file:
        file.write(page_of(record).encode(errors="backslashreplace"))  # a folder's name need not be text
    return [*sheets, page]


def contact_sheet(record: Record, entries: Sequence[Entry]) -> Image.Image:
    """Return a picture of stills, each with the film's parameters below."""
    columns = min(_COLUMNS, max(1, len(entries)))
    rows = -(-len(entries) // columns)
    step = (_WIDTH + _MARGIN, _HEIGHT + _LINES * _TEXT + 2 * _MARGIN)
    sheet = Image.new("RGB", (columns * step[0] + _MARGIN, rows * step[1] + _MARGIN), _BACK)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(13)
    for i, entry in enumerate(entries):
        x, y = _MARGIN + i % columns * step[0], _MARGIN + i // columns * step[1]
        picture = still(record.out(entry.task.name))
        if picture is None:
            draw.rectangle((x, y, x + _WIDTH - 1, y + _HEIGHT - 1), outline=_PALE)
            draw.text((x + 10, y + 10), "\n".join(_wrapped(_trouble(entry), 6)), _PALE, font)
        else:
            picture = ImageOps.contain(picture, (_WIDTH, _HEIGHT))
            sheet.paste(picture, (x + (_WIDTH - picture.width) // 2, y + (_HEIGHT - picture.height) // 2))
        draw.text((x, y + _HEIGHT + 3), "\n".join(_wrapped(entry.task.caption(), _LINES)), _BRIGHT, font)
    return sheet


def _trouble(entry: Entry) -> str:
    return f"{entry.state}: {entry.error}" if entry.error else entry.state


def _wrapped(text: str, lines: int) -> list[str]:
    """Return `text` in so many lines, what leaves them cut off; letters that the font may lack as question marks."""
    plain = "".join(letter if letter.isprintable() and ord(letter) < 0x250 else "?" for letter in text)
    parts = [plain[i : i + _LONGEST] for i in range(0, len(plain), _LONGEST)] or [""]
    return parts if len(parts) <= lines else [*parts[: lines - 1], parts[lines - 1][:-3] + "..."]


def still(folder: Path) -> Image.Image | None:
    """Return the frame in the middle of what is finished of a film, from its pictures or else the film; None if there is none."""
    frames = sorted(folder.glob("frames/[0-9]*.png"))
    if frames:
        path = frames[len(frames) // 2]
        return _opened(path.read_bytes()) if is_whole_png(path) else None
    films = sorted(folder.glob("*.mp4"))
    if not films:
        return None
    film = films[0]
    command = [find_ffmpeg(), "-v", "error", "-i", str(film.absolute()), "-vf", "thumbnail=24", "-frames:v", "1"]
    try:
        made = subprocess.run(
            [*command, "-f", "image2pipe", "-c:v", "png", "-"],
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=60,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return _opened(made.stdout) if made.returncode == 0 else None


def _opened(data: bytes) -> Image.Image | None:
    try:
        with Image.open(BytesIO(data), formats=("PNG",)) as image:
            return image.convert("RGB") if image.width * image.height <= _LARGEST else None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning):
        return None


_STYLE = (
    "body{background:#121214;color:#e1e1e4;font:15px/1.5 system-ui,sans-serif;margin:2rem}"
    "ul{list-style:none;padding:0;display:grid;grid-template-columns:repeat(auto-fill,minmax(20rem,1fr));gap:1.5rem}"
    "video,img{width:100%;aspect-ratio:16/9;object-fit:contain;background:#000}"
    "li{overflow-wrap:anywhere}small{color:#98989d}.failed,.cancelled{color:#ff8a80}a{color:inherit}"
)
# No script runs, and nothing is loaded but pictures and films beside the page.
_POLICY = "default-src 'none'; img-src 'self' file:; media-src 'self' file:; style-src 'unsafe-inline'"


def page_of(record: Record) -> str:
    """Return a page of all films that works from a file, whatever the names are."""
    counts = ", ".join(f"{n} {state}" for state, n in record.counts().items() if n)
    items = "\n".join(_item(record, entry) for entry in record.entries.values())
    title = html.escape(record.folder.absolute().name)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{title}</title><style>{_STYLE}</style></head>
<body><h1>{title}</h1><p>{len(record.entries)} films: {counts}</p>
<ul>
{items}
</ul></body></html>
"""


def _item(record: Record, entry: Entry) -> str:
    folder = record.out(entry.task.name)
    films = sorted(p for p in folder.glob("*.mp4") if not p.name.endswith(".partial.mp4"))
    frames = sorted(folder.glob("frames/[0-9]*.png"))
    middle = _link(record, frames[len(frames) // 2]) if frames else ""
    name, caption = html.escape(entry.task.name), html.escape(entry.task.caption())
    if films:
        poster = f' poster="{middle}"' if middle else ""
        shown = f'<video controls loop muted preload="none"{poster} src="{_link(record, films[0])}"></video>'
    else:
        shown = f'<img loading="lazy" alt="{caption}" src="{middle}">' if middle else ""
    trouble = "" if entry.state == "done" else f'<div class="{entry.state}">{html.escape(_trouble(entry))}</div>'
    link = _link(record, folder) + "/"
    return f'<li>{shown}<div>{caption}</div>{trouble}<small><a href="{link}">{name}</a>, {entry.seconds:.1f} s</small></li>'


def _link(record: Record, path: Path) -> str:
    """Return the address of a file below the page."""
    return html.escape(quote(path.relative_to(record.folder).as_posix()))
