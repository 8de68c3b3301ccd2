"""Checks the house rules that a machine can check; prints one line for each breach.

Usage: tidy.py REPOSITORY
"""

import pathlib
import re
import subprocess
import sys

SOURCE_DIRS = ("core", "worker", "server", "client", "embedded", "tests", "bench")
LINE_COLUMNS_MAX = 100
FILE_LINES_MAX = 600

# Which folders each folder may include from. core knows nobody; server, worker and client never
# include each other; only embedded joins them.
MAY_INCLUDE = {
    "core": {"core"},
    "worker": {"core", "tessera", "worker"},
    "server": {"core", "tessera", "server"},
    "client": {"core", "tessera", "client"},
    "embedded": {"core", "tessera", "worker", "server", "client", "embedded"},
}
# Headers of a library, and the only folders that may see them.
CONFINED = {
    "embree3/": ("worker/integrator/",),
    "grpcpp/": ("server/", "worker/session/", "client/", "embedded/", "tests/", "bench/"),
    "OpenImageIO/": ("core/image/", "worker/scene/", "tests/", "bench/"),
    "sqlite3.h": ("server/store/", "tests/server/"),
}


def tracked_sources(root: pathlib.Path) -> list[pathlib.Path]:
    """The C++ files of the project, relative to root: git's, or all where there is no git."""
    listed = subprocess.run(["git", "-C", str(root), "ls-files", "-co", "--exclude-standard"],
                            capture_output=True, text=True, check=False)
    if listed.returncode == 0:
        names = listed.stdout.splitlines()
    else:
        names = [str(p.relative_to(root)) for p in root.rglob("*")]
    return [pathlib.Path(n) for n in names
            if n.endswith((".h", ".cpp")) and n.split("/")[0] in SOURCE_DIRS
            and (root / n).is_file()]


def include_breaches(name: str, line: str) -> list[str]:
    """What is wrong with one #include line of file `name`."""
    match = re.match(r'\s*#include\s+["<]([^">]+)[">]', line)
    if not match:
        return []
    target = match.group(1)
    breaches = []
    folder = name.split("/")[0]
    layer = target.split("/")[0]
    if line.lstrip().startswith('#include "') and folder in MAY_INCLUDE \
            and layer in set(MAY_INCLUDE) | {"tests", "bench"} and layer not in MAY_INCLUDE[folder]:
        breaches.append(f"{folder} must not include {target}")
    for prefix, homes in CONFINED.items():
        if target.startswith(prefix) and not name.startswith(homes):
            breaches.append(f"{target} belongs in {', '.join(homes)} only")
    return breaches


def check_file(root: pathlib.Path, path: pathlib.Path) -> list[str]:
    name = str(path)
    lines = (root / path).read_text(encoding="utf-8").split("\n")
    breaches = []
    if len(lines) > FILE_LINES_MAX:
        breaches.append(f"{name}: {len(lines)} lines, more than {FILE_LINES_MAX}: two nouns?")
    if path.suffix == ".h" and "#pragma once" not in lines:
        breaches.append(f"{name}: no #pragma once")
    if not lines[0].startswith(("//", "#include")):
        breaches.append(f"{name}:1: a file begins with what it is, or with its own header")
    for number, line in enumerate(lines, 1):
        where = f"{name}:{number}"
        if len(line) > LINE_COLUMNS_MAX:
            breaches.append(f"{where}: {len(line)} columns")
        if line != line.rstrip():
            breaches.append(f"{where}: white space at the end")
        if "\t" in line:
            breaches.append(f"{where}: a tab")
        if re.search(r"\b(TODO|FIXME|XXX)\b", line):
            breaches.append(f"{where}: open work belongs in an issue")
        if re.match(r"\s*//.*[;{]\s*$", line) and re.match(r"\s*//\s*[\w:<>,*& ]+\(.*\);\s*$", line):
            breaches.append(f"{where}: commented-out code")
        breaches += [f"{where}: {b}" for b in include_breaches(name, line)]
    return breaches


# Runs before main() of every program, so no test can call it.
UNTESTABLE = {"core/base/cpu_check.cpp"}


def untested_sources(paths: list[pathlib.Path]) -> list[str]:
    """Sources of core whose name no test mentions."""
    tests = {p.stem for p in paths if str(p).startswith("tests/")}
    return [f"{p}: no tests/.../{p.stem}_test.cpp" for p in paths
            if str(p).startswith("core/") and p.suffix == ".cpp" and str(p) not in UNTESTABLE
            and f"{p.stem}_test" not in tests]


def main() -> int:
    root = pathlib.Path(sys.argv[1]).resolve()
    paths = tracked_sources(root)
    breaches = [b for p in paths for b in check_file(root, p)] + untested_sources(paths)
    for breach in breaches:
        print(breach)
    print(f"{len(paths)} files, {len(breaches)} breaches")
    return 1 if breaches or not paths else 0


if __name__ == "__main__":
    sys.exit(main())
