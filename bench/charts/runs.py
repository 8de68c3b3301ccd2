"""One regeneration of the charts: its settings, and what it will put into docs/ at the end."""

import dataclasses
import hashlib
import os
import pathlib
import shutil

from charts import pages
from tessera_chart import methods, oidn, programs


@dataclasses.dataclass
class Run:
    """Everything is made in `work`; docs/ changes only when all of it is there."""

    build: pathlib.Path
    work: pathlib.Path
    out: pathlib.Path  # docs/charts, or a folder to try
    docs: pathlib.Path | None  # with the pages; None if `out` is not docs/charts
    scenes: pathlib.Path | None
    quick: bool
    oidn: str | None = None
    oidn_weights: pathlib.Path | None = None

    def __post_init__(self):
        self.tessera = programs.Tessera(str(self.build / "bin" / "tessera"))
        self.version = self.tessera.version()
        self.made = self.work / "made"
        self._parts: list[tuple[str, str, str]] = []
        # Nothing is left of a run of another build or of other parts.
        shutil.rmtree(self.made, ignore_errors=True)
        self.made.mkdir(parents=True)
        if self.oidn:
            self.oidn = shutil.which(self.oidn) or self.oidn
            oidn.check(self.oidn_weights)

    def bin(self, name: str) -> pathlib.Path:
        return self.build / "bin" / name

    def digest(self, *names: str) -> str:
        """Of those of the build's programs that are there: others give other results."""
        files = [self.bin(name) for name in names if self.bin(name).is_file()]
        text = " ".join(programs.digest_of(file) for file in files)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def has_oidn(self) -> bool:
        return self.oidn is not None

    def add_part(self, page: str, name: str, text: str) -> None:
        """Text between the marks of that name in docs/PAGE."""
        self._parts.append((page, name, text))

    def publish(self) -> None:
        """Puts all that was made into its place, each file whole or not at all.

        Errors: ValueError if a page has no such part; nothing is changed then.
        """
        changed: dict[pathlib.Path, str] = {}
        if self.docs:
            for page, name, text in self._parts:
                path = self.docs / page
                before = changed.get(path) or path.read_text(encoding="utf-8")
                changed[path] = pages.with_part(before, name, text)
        self.out.mkdir(parents=True, exist_ok=True)
        for file in sorted(self.made.iterdir()):
            beside = self.out / f".{file.name}.new"
            shutil.copyfile(file, beside)
            os.replace(beside, self.out / file.name)
        for path, text in changed.items():
            beside = path.with_suffix(".new")
            beside.write_text(text, encoding="utf-8")
            os.replace(beside, path)
