"""Helpers for one self-contained HTML page: escaped text, numbers with units, inline images."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

NONE = "–"
MAX_PICTURE_PX = 960

CSS = """
:root { --ink:#1f2933; --soft:#5f6b7a; --line:#e3e7ed; --paper:#ffffff; --ground:#f4f6f9;
        --good:#0b7a55; --good-bg:#e6f5ef; --bad:#b3360b; --bad-bg:#fdeee7; --accent:#0072b2; }
* { box-sizing:border-box; }
body { margin:0; background:var(--ground); color:var(--ink); line-height:1.45;
       font-size:15px; font-family:system-ui,"Segoe UI",Roboto,"Liberation Sans",Arial,sans-serif; }
main { max-width:1180px; margin:0 auto; padding:28px 24px 48px; }
header { border-radius:12px; padding:20px 26px; margin-bottom:22px; border-left:8px solid; }
header.good { background:var(--good-bg); border-color:var(--good); }
header.bad { background:var(--bad-bg); border-color:var(--bad); }
h1 { margin:0; font-size:26px; } header.good h1 { color:var(--good); } header.bad h1 { color:var(--bad); }
header p { margin:6px 0 0; overflow-wrap:anywhere; } header .what { color:var(--soft); margin:0 0 4px; }
section { background:var(--paper); border:1px solid var(--line); border-radius:12px; padding:18px 24px 22px;
          margin-bottom:20px; }
h2 { margin:0 0 12px; font-size:18px; }
h3 { margin:18px 0 6px; font-size:14px; color:var(--soft); font-weight:600; }
.wide { overflow-x:auto; }
table { border-collapse:collapse; width:100%; font-size:14px; }
th { text-align:left; color:var(--soft); font-weight:600; font-size:12.5px;
     border-bottom:2px solid var(--line); }
th,td { padding:6px 10px; vertical-align:top; }
td { border-bottom:1px solid var(--line); overflow-wrap:anywhere; }
tr:last-child td { border-bottom:0; }
.num { text-align:right; font-variant-numeric:tabular-nums; white-space:nowrap; }
tr.bad td { background:var(--bad-bg); }
.tag { display:inline-block; border-radius:99px; padding:1px 10px; font-size:12.5px; font-weight:600; }
.tag.good { background:var(--good-bg); color:var(--good); }
.tag.bad { background:var(--bad-bg); color:var(--bad); }
.keys { display:grid; grid-template-columns:repeat(auto-fill,minmax(165px,1fr)); gap:12px; }
.key { border:1px solid var(--line); border-radius:10px; padding:10px 14px; }
.key b { display:block; font-size:20px; font-variant-numeric:tabular-nums; overflow-wrap:anywhere; }
.key span { color:var(--soft); font-size:12.5px; } .key.bad b { color:var(--bad); }
.chips { display:flex; flex-wrap:wrap; gap:8px; }
.chip { background:#f0f3f7; border-radius:99px; padding:2px 12px; font-size:13px; }
.plot { width:100%; height:auto; display:block; }
.pictures { display:grid; grid-template-columns:repeat(auto-fill,minmax(320px,1fr)); gap:16px; }
figure { margin:0; }
figure img { width:100%; height:auto; border-radius:8px; border:1px solid var(--line); display:block; }
figcaption { color:var(--soft); font-size:13px; margin-top:5px; }
pre { background:#f0f3f7; border-radius:8px; padding:12px 14px; overflow-x:auto; font-size:13.5px; margin:0;
      font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,"DejaVu Sans Mono",monospace; }
.log { max-height:420px; overflow-y:auto; }
.log th:first-child { width:90px; } .log th:nth-child(2) { width:100px; }
.name { overflow-wrap:normal; }
.none { color:var(--soft); margin:0; }
footer { color:var(--soft); font-size:12.5px; text-align:center; }
@media print { body { background:#fff; } .log { max-height:none; } section { break-inside:avoid; } }
"""


def page(title: str, body: str) -> str:
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{text(title)}</title><link rel="icon" href="data:,"><style>{CSS}</style></head>\n'
        f"<body><main>\n{body}\n</main></body></html>\n"
    )


def section(title: str, body: str) -> str:
    return f"<section><h2>{text(title)}</h2>\n{body}\n</section>"


def text(value: Any) -> str:
    """Format a value as escaped HTML text for a report page. None and empty text become a dash."""
    if value is None or value == "":
        return NONE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else NONE
    return escape(str(value))


def name(value: Any) -> str:
    """Format a name as HTML for a report page. Line breaks are possible only after underscores."""
    return f'<span class="name">{text(value).replace("_", "_<wbr>")}</span>'


def number(value: Any, unit: str = "", scale: float = 1.0, digits: int = 2) -> str:
    """Format the number `value * scale` with its unit for an HTML page.
    Values that are not numbers become text or a dash.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return text(value)
    if not math.isfinite(value):
        return NONE
    return f"{float(value) * scale:.{digits}f}{' ' + unit if unit else ''}"


def millimeters(value: Any, digits: int = 2) -> str:
    """Format a length, given in meters, as millimeters for an HTML page."""
    return number(value, "mm", 1000.0, digits)


def seconds(value: Any) -> str:
    return number(value, "s", digits=2)


def tag(good: bool, words: str) -> str:
    return f'<span class="tag {"good" if good else "bad"}">{text(words)}</span>'


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = (), bad: Iterable[int] = ()
) -> str:
    """Return an HTML table.

    Args:
        head: column titles.
        rows: cells that are HTML already (from `text`, `number`, ...).
        numeric: indices of right-aligned columns.
        bad: indices of highlighted rows.
    """
    right, marked = set(numeric), set(bad)

    def cells(name: str, row: Sequence[str]) -> str:
        return "".join(f"<{name}{' class=num' if i in right else ''}>{c}</{name}>" for i, c in enumerate(row))

    body = "\n".join(
        f"<tr{' class=bad' if i in marked else ''}>{cells('td', r)}</tr>" for i, r in enumerate(rows)
    )
    heading = cells("th", [text(h) for h in head])
    return (
        f'<div class="wide"><table><thead><tr>{heading}</tr></thead><tbody>\n{body}\n</tbody></table></div>'
    )


def key(label: str, value: str, bad: bool = False) -> str:
    return f'<div class="key{" bad" if bad else ""}"><span>{text(label)}</span><b>{value}</b></div>'


def image(png: bytes, alt: str, css_class: str = "plot") -> str:
    data = base64.b64encode(png).decode("ascii")
    return f'<img class="{css_class}" alt="{escape(alt, quote=True)}" src="data:image/png;base64,{data}">'


def picture_png(rgb: NDArray[np.uint8]) -> bytes:
    """Encode an image (h, w, 3) as PNG for an HTML page.
    Images wider than `MAX_PICTURE_PX` are reduced to this width.
    """
    picture = Image.fromarray(rgb)
    if picture.width > MAX_PICTURE_PX:
        picture = picture.resize(
            (MAX_PICTURE_PX, max(1, round(picture.height * MAX_PICTURE_PX / picture.width)))
        )
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=False)
    return buffer.getvalue()
