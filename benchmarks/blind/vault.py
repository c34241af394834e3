"""The sealed answers: encryption, the commitment, and the fingerprints of the logs that the answers belong to.

Fernet (AES-128-CBC with HMAC-SHA256, from the `cryptography` library) is used because its authentication binds key and
text: AES-GCM would let one ciphertext be opened by two keys into two different answers.
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from pathlib import Path

ANSWERS, KEY, COMMITMENT = "answers.sealed", "key", "commitment.txt"
FILES = ("log.npz", "nominal.xml", "test.npz")


class SealBroken(ValueError):
    """Answers, key, commitment and logs do not belong together."""


def fingerprint(folder: Path) -> str:
    """SHA-256 over the files of one log."""
    digest = hashlib.sha256()
    for name in FILES:
        digest.update(hashlib.sha256((folder / name).read_bytes()).digest())
    return digest.hexdigest()


def commitment(sealed: bytes, key: bytes) -> str:
    """SHA-256 that fixes the sealed answers and the key that opens them."""
    parts = hashlib.sha256(sealed).digest() + hashlib.sha256(key.strip()).digest()
    return hashlib.sha256(parts).hexdigest()


def seal(answers: dict, folder: Path) -> str:
    """Encrypt `answers` (JSON) into `folder`, the key beside it readable by its owner alone; the commitment."""
    from cryptography.fernet import Fernet

    folder.mkdir(parents=True, exist_ok=True)
    key = Fernet.generate_key()
    sealed = Fernet(key).encrypt(zlib.compress(json.dumps(answers).encode(), 9))
    promise = commitment(sealed, key)
    descriptor = os.open(folder / KEY, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(key)
    (folder / ANSWERS).write_bytes(sealed)
    (folder / COMMITMENT).write_text(promise + "\n")
    return promise


def unseal(
    folder: Path, promise: str, logs: Path | None, key: Path | None = None, part: bool = False
) -> dict:
    """The answers, after commitment and every log have been checked; `SealBroken` with one line otherwise.

    `part`: logs may be missing. `promise` is the commitment as published before any diagnosis, not the copy beside the
    answers.
    """
    from cryptography.fernet import Fernet, InvalidToken

    sealed = (folder / ANSWERS).read_bytes()
    secret = (key or folder / KEY).read_bytes().strip()
    got = commitment(sealed, secret)
    if got != promise.strip():
        raise SealBroken(
            f"{folder / ANSWERS}: commitment {got[:16]}…; published was {promise.strip()[:16]}…"
        )
    try:
        answers = json.loads(zlib.decompress(Fernet(secret).decrypt(sealed)))
    except InvalidToken:
        raise SealBroken(f"{folder / ANSWERS}: not sealed with this key") from None
    if logs is not None:
        check_logs(answers, logs, part)
    return answers


def check_logs(answers: dict, logs: Path, part: bool = False) -> None:
    """`SealBroken` where a log is missing (unless `part`), added or changed since it was sealed."""
    held = {p.name for p in logs.iterdir() if p.is_dir()}
    told = set(answers["logs"])
    if held - told or (told - held and not part):
        odd = sorted(held ^ told)
        raise SealBroken(f"{logs}: {len(odd)} logs missing or foreign, such as {odd[0]}")
    for name in sorted(held):
        if fingerprint(logs / name) != answers["logs"][name]["sha256"]:
            raise SealBroken(f"{logs / name}: changed since it was sealed")
