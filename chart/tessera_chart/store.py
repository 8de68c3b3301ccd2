"""Results on disk, one small file each: what is finished is never made again."""

import json
import os
import pathlib


class Store:
    """Results of one scene under one set of settings."""

    def __init__(self, folder: pathlib.Path):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def path(self, name: str) -> pathlib.Path:
        return self.folder / name

    def get(self, key: str) -> dict | None:
        """None if it is not there; a file that was cut short counts as not there."""
        try:
            return json.loads(self.path(key + ".json").read_text(encoding="utf-8"))
        except (FileNotFoundError, json.JSONDecodeError):
            return None

    def put(self, key: str, result: dict) -> None:
        """Whole or not at all, whenever the run is stopped."""
        path = self.path(key + ".json")
        beside = path.with_suffix(".new")
        beside.write_text(json.dumps(result, indent=1), encoding="utf-8")
        os.replace(beside, path)
