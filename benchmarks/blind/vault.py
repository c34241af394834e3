"""What fixes a sealed set: the hash of its seed, published before a log exists, and the manifest of its files.

LOGS/NAME holds what a tool may see, VAULT/NAME what the scorer alone opens, VAULT/manifest.json the SHA-256 of every
log's files beside the seed's. The SHA-256 of the manifest is the commitment: it is printed before the first diagnosis.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

MANIFEST = "manifest.json"
SHOWN, HIDDEN = ("log.npz", "nominal.xml", "validation.npz"), ("test.npz", "truth.json")


class SealBroken(ValueError):
    """Seed, manifest and logs do not belong together."""


def fingerprint(shown: Path, hidden: Path) -> str:
    """SHA-256 over the names and files of one log."""
    digest = hashlib.sha256()
    for folder, names in ((shown, SHOWN), (hidden, HIDDEN)):
        for name in names:
            if (folder / name).exists():
                digest.update(name.encode() + hashlib.sha256((folder / name).read_bytes()).digest())
    return digest.hexdigest()


def seal(logs: Path, vault: Path, about: dict) -> str:
    """Write the manifest of all logs; the commitment. `about`: what else it states."""
    names = sorted(p.name for p in logs.iterdir())
    prints = {name: fingerprint(logs / name, vault / name) for name in names}
    (vault / MANIFEST).write_text(json.dumps(about | {"logs": prints}, indent=1) + "\n")
    return commitment(vault)


def commitment(vault: Path) -> str:
    """SHA-256 of the manifest."""
    return hashlib.sha256((vault / MANIFEST).read_bytes()).hexdigest()


def check(logs: Path, vault: Path, promise: str, seed: bytes | None = None) -> dict:
    """The manifest, after all has been compared with it; `SealBroken` says in one line what differs.

    `promise`: the commitment as it was published; `seed`: once it is opened.
    """
    if (got := commitment(vault)) != promise.strip():
        raise SealBroken(f"{vault}: commitment {got[:16]}…; published was {promise.strip()[:16]}…")
    manifest = json.loads((vault / MANIFEST).read_text())
    if seed is not None and hashlib.sha256(seed).hexdigest() != manifest["seed_sha256"]:
        raise SealBroken(f"the seed's SHA-256 is not {manifest['seed_sha256'][:16]}…")
    held = {p.name for p in logs.iterdir() if p.is_dir()}
    if odd := sorted(held ^ set(manifest["logs"])):
        raise SealBroken(f"{logs}: {len(odd)} logs missing or foreign, such as {odd[0]}")
    for name, told in manifest["logs"].items():
        if fingerprint(logs / name, vault / name) != told:
            raise SealBroken(f"{logs / name}: changed since it was sealed")
    return manifest
