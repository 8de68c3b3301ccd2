"""Puts generated tables into pages, between <!-- begin NAME --> and <!-- end NAME -->."""

import pathlib


def replace_part(page: pathlib.Path, name: str, text: str) -> None:
    """Errors: ValueError if the page has no such part."""
    content = page.read_text(encoding="utf-8")
    begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
    if begin not in content or end not in content:
        raise ValueError(f"{page}: has no part {name}")
    head, rest = content.split(begin, 1)
    tail = rest.split(end, 1)[1]
    page.write_text(head + begin + text.rstrip("\n") + "\n" + end + tail, encoding="utf-8")


def table(header: list[str], rows: list[list[str]]) -> str:
    """Markdown."""
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])
