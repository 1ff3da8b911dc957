"""A report as one HTML file: no script, no network, pictures inside."""

from __future__ import annotations

import base64
from collections.abc import Callable
from html import escape as escaped
from importlib.resources import files
from typing import Any

from tuberline.export.report.page import MAY_BREAK, Bars, Figures, Grid, Picture, Report, Sentences, breakable


def report_html(report: Report) -> str:
    """The whole file."""
    style = files(__package__).joinpath("day.css").read_text(encoding="utf-8")
    body = "\n".join(_WRITERS[type(block)](block) for block in report.blocks)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escaped(report.title)}</title>\n<style>\n{style}</style></head>\n<body><main>\n"
        f"<header><h1>{escape(report.title)}</h1><p>{escape(report.subtitle)}</p></header>\n"
        f"{body}\n<footer>{escape(report.foot)}</footer>\n</main></body></html>\n"
    )


def escape(text: str) -> str:
    """Text between tags; a long word may be broken."""
    return escaped(breakable(text)).replace(MAY_BREAK, "<wbr>")


def _figures(block: Figures) -> str:
    items = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd><p>{escape(note)}</p></div>"
        for name, value, note in block.items
    )
    return f'<dl class="figures">{items}</dl>'


def _grid(block: Grid) -> str:
    aligned = [f' class="{align}"' if align == "right" else "" for _, align in block.columns]
    head = "".join(f"<th{css}>{escape(name)}</th>" for (name, _), css in zip(block.columns, aligned, strict=True))
    rows = [
        "".join(f"<td{css}>{escape(value)}</td>" for value, css in zip(row, aligned, strict=True)) for row in block.rows
    ]
    summed = len(rows) - 1 if block.summed else len(rows)
    body = "".join(f"<tr{' class=sum' if n == summed else ''}>{row}</tr>" for n, row in enumerate(rows))
    table = f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    return _section(block.title, table + _note(block.note))


def _bars(block: Bars) -> str:
    legend = "".join(f'<li><i style="background:{escaped(c)}"></i>{escape(name)}</li>' for name, c in block.parts)
    rows = []
    for name, side, shares in block.rows:
        spans = "".join(
            f'<i style="width:{100 * share:.2f}%;background:{escaped(colour)}"></i>'
            for share, (_, colour) in zip(shares, block.parts, strict=True)
        )
        rows.append(f"<tr><th>{escape(name)}</th><td><div>{spans}</div></td><td>{escape(side)}</td></tr>")
    inner = f'<ul class="legend">{legend}</ul><table class="bars">{"".join(rows)}</table>'
    return _section(block.title, inner + _note(block.note))


def _picture(block: Picture) -> str:
    data = base64.b64encode(block.png).decode()
    image = f'<img alt="{escaped(block.title)}" src="data:image/png;base64,{data}">'
    return _section(block.title, image + _note(block.note))


def _sentences(block: Sentences) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in block.items)
    return _section(block.title, f'<ul class="{"warn" if block.warn else "said"}">{items}</ul>')


def _section(title: str, inner: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{inner}</section>"


def _note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>' if text else ""


_WRITERS: dict[type, Callable[[Any], str]] = {
    Figures: _figures,
    Grid: _grid,
    Bars: _bars,
    Picture: _picture,
    Sentences: _sentences,
}
