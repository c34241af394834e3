"""Results in shards with a manifest: written whole or not at all, resumed without losing or repeating one."""

import hashlib
import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

MANIFEST = "manifest.json"


class Shards:
    """A folder of npz files, `size` entries each (the last may be shorter), and what was asked for."""

    def __init__(self, folder: Path, asked: Mapping[str, Any], total: int, size: int) -> None:
        """Open or start the folder; ValueError where it holds the results of something else."""
        self.folder, self.total, self.size = folder, total, size
        self.asked = {**asked, "total": total, "size": size}
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(".part-*"):
            left.unlink()
        self.done: dict[int, dict] = {}
        path = folder / MANIFEST
        if not path.exists():
            self._write_manifest()
            return
        found = json.loads(path.read_text())
        other = {k: (found["asked"].get(k), v) for k, v in self.asked.items()}
        other = {k: pair for k, pair in other.items() if pair[0] != pair[1]}
        if other:
            raise ValueError(
                f"{folder} holds another run: {other} (there, asked for); choose another folder"
            )
        for entry in found["shards"]:
            # A file that is lost or damaged is made again.
            if self._digest(entry["file"]) == entry["sha256"]:
                self.done[entry["number"]] = entry

    def __len__(self) -> int:
        return -(-self.total // self.size)

    def missing(self) -> list[int]:
        """Numbers of the shards that are yet to be made."""
        return [k for k in range(len(self)) if k not in self.done]

    def entries(self, number: int) -> range:
        """The entries that a shard holds."""
        return range(number * self.size, min((number + 1) * self.size, self.total))

    def save(self, number: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write a shard, then say so in the manifest."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        name, data = f"shard-{number:05d}.npz", buffer.getvalue()
        self._replace(name, data)
        digest = hashlib.sha256(data).hexdigest()
        entry = {"number": number, "file": name, "count": len(self.entries(number))}
        self.done[number] = {**entry, "sha256": digest}
        self._write_manifest()

    def load(self) -> dict[str, np.ndarray]:
        """All entries in order, of the shards that are done."""
        parts = []
        for number in sorted(self.done):
            with np.load(self.folder / self.done[number]["file"], allow_pickle=False) as part:
                parts.append(dict(part))
        return (
            {name: np.concatenate([p[name] for p in parts]) for name in parts[0]} if parts else {}
        )

    def _digest(self, name: str) -> str:
        path = self.folder / name
        return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else ""

    def _write_manifest(self) -> None:
        shards = [self.done[k] for k in sorted(self.done)]
        text = json.dumps({"asked": self.asked, "shards": shards}, indent=1)
        self._replace(MANIFEST, text.encode())

    def _replace(self, name: str, data: bytes) -> None:
        part = self.folder / f".part-{name}"
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, self.folder / name)
