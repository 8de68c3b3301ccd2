"""Generated tables in pages, between <!-- begin NAME --> and <!-- end NAME -->."""


def with_part(content: str, name: str, text: str) -> str:
    """`content` with `text` as its part. Errors: ValueError if it has no such part."""
    begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
    if begin not in content or end not in content:
        raise ValueError(f"the page has no part {name}")
    head, rest = content.split(begin, 1)
    tail = rest.split(end, 1)[1]
    return head + begin + text.rstrip("\n") + "\n" + end + tail


def table(header: list[str], rows: list[list[str]]) -> str:
    """Markdown."""
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])
