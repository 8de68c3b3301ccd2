"""The scenes of a run, each with the flags of its view."""

import dataclasses
import hashlib
import pathlib
import re
import shlex

from tessera_chart.errors import BadInput

# Flags of `tessera render` that say what is looked at; the others are the run's own.
VIEW_FLAGS = {"--camera": 1, "--look-from": 1, "--look-at": 1, "--up": 1, "--fov-y": 1,
              "--lens-radius": 1, "--focus-distance": 1, "--env": 1, "--env-rotate": 1, "--sky": 1,
              "--max-depth": 1, "--region": 1, "--transparent": 0, "--isa": 1, "--tile-size": 1}


def _without(flags: tuple[str, ...], name: str) -> tuple[str, ...]:
    if name not in flags:
        return flags
    at = flags.index(name)
    return flags[:at] + flags[at + 2:]


@dataclasses.dataclass(frozen=True)
class View:
    """A scene file, and how it is looked at."""

    name: str
    file: pathlib.Path
    flags: tuple[str, ...]

    def flag(self, name: str) -> str | None:
        """The value of a flag; None without."""
        return self.flags[self.flags.index(name) + 1] if name in self.flags else None

    def picture_digest(self, size: str, version: str) -> str:
        """Of all that decides the bits of a picture."""
        return dataclasses.replace(self, flags=_without(self.flags, "--tile-size")).digest(
            size, version)

    def digest(self, size: str, version: str) -> str:
        """Of all settings: results of others are never taken for these."""
        content = hashlib.sha256(self.file.read_bytes())
        env = self.flag("--env")
        if env and pathlib.Path(env).is_file():
            content.update(pathlib.Path(env).read_bytes())
        flags = [f for f in self.flags if f != env]
        content.update("\0".join([*flags, size, version]).encode())
        return content.hexdigest()[:12]


def parse_view(text: str) -> View:
    """[NAME=]FILE, or that with flags of `tessera render` behind it in one argument.

    Errors: BadInput.
    """
    name, flags = None, []
    path = pathlib.Path(text)
    if not path.is_file():
        try:
            words = shlex.split(text)
        except ValueError as error:
            raise BadInput(f"{text}: {error}") from error
        if not words:
            raise BadInput("a scene's name is empty")
        match = re.fullmatch(r"([\w-]+)=(.+)", words[0])
        name = match.group(1) if match else None
        path = pathlib.Path(match.group(2) if match else words[0])
        flags = words[1:]
    if not path.is_file():
        raise BadInput(f"{path}: no such scene file; give SCENE.glb or SCENE.gltf, or in one "
                       "argument \"NAME=SCENE.glb --sky 1,1,1 ...\"")
    i = 0
    while i < len(flags):
        if flags[i] not in VIEW_FLAGS:
            raise BadInput(f"{path.name}: {flags[i]} is not a flag of a view; use "
                           + ", ".join(VIEW_FLAGS))
        i += 1 + VIEW_FLAGS[flags[i]]
    if i != len(flags):
        raise BadInput(f"{path.name}: {flags[-1]} needs a value")
    return View(name or path.stem, path, tuple(flags))


def parse_views(texts: list[str], shared_flags: list[str]) -> list[View]:
    """Errors: BadInput, also if two have one name."""
    views = [parse_view(text) for text in texts]
    views = [dataclasses.replace(v, flags=(*[f for f in shared_flags], *v.flags)) for v in views]
    names = [v.name for v in views]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"two scenes are called {name}: give names, NAME=FILE")
    return views
