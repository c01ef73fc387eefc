"""A table on stdout."""


class Table:
    """Rows of text under a title."""

    def __init__(self, title: str, columns: tuple[str, ...]):
        self.title, self.rows = title, [columns]

    def add(self, *cells: object) -> None:
        """Append a row."""
        self.rows.append(tuple(str(cell) for cell in cells))

    def print(self) -> None:
        """Print it as Markdown."""
        widths = [max(len(row[i]) for row in self.rows) for i in range(len(self.rows[0]))]
        lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) + " |" for row in self.rows]
        lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
        print(f"\n{self.title}\n\n" + "\n".join(lines), flush=True)
