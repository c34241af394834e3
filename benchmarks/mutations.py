"""Hostile versions of sound files, by a seeded generator: bytes hit at random, and what a file says made absurd."""

import io
import re
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Bytes = Callable[[np.random.Generator, bytes], bytes]

NUMBERS = (
    *("nan", "inf", "-inf", "1e999", "-1e308", "1e39", "1e-320", "0", "-1", "1e6", "4294967296"),
    *("9" * 400, "9" * 5000, "0x10", "1_0", "1e", "", "--1", "1,5", "²", "٣"),
)
LETTERS = " a0\t\n\"'<>&;=[](){},.-_/\\*:\x00\x1b\x7fé\ud83d�"
WORDS = (
    *("&#99999999999;", "&#" + "9" * 5000 + ";", "&#xD800;", "&#0;", "&amp;", "&bogus;", "&" * 500),
    *("../../x", "/dev/zero", "\x1b[2J", "null", "NaN", "world", "-", "#", "%n%s", "ünïcödé", "::"),
)
MJCF = (
    [f'<size {n}="{v}"/>' for n in ("nkey", "njmax", "nconmax", "nuserdata", "nuser_body", "memory")
     for v in (900_000, 20_000, -5)]
    + ['<option gravity="0 0 nan"/>', '<option timestep="-1" density="inf"/>', "<!DOCTYPE m [<!ENTITY a 'a'>]>"]
    + ['<include file="robot.xml"/>', '<include file="/etc/passwd"/>', "<keyframe>" + "<key/>" * 3000 + "</keyframe>"]
    + ['<compiler settotalmass="nan"/>', '<compiler inertiafromgeom="true" boundmass="inf"/>']
    + ['<asset><texture name="t" type="2d" builtin="flat" width="30000" height="30000"/></asset>']
    + ['<asset><hfield name="h" nrow="30000" ncol="30000" size="1 1 1 1"/></asset>']
    + ['<default><joint armature="nan"/></default>', '<default><geom density="inf"/></default>']
    + ['<custom><numeric name="n" size="2000000000"/></custom>', '<equality><weld body1="b"/></equality>']
    + ['<contact><exclude body1="x" body2="y"/></contact>', '<statistic extent="nan"/>']
    + ['<default><equality solref="nan nan"/></default>', '<extension><plugin plugin="no.such"/></extension>']
)  # fmt: skip
URDF = (
    ['<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'] * 2
    + ['<link name="a"/>', '<link name="&#945;"/>', '<mujoco><size nkey="900000"/></mujoco>']
    + ['<mujoco><compiler balanceinertia="true" fusestatic="true"/></mujoco>', '<robot name="r">']
    + ['<inertial><mass value="nan"/><inertia ixx="nan" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>']
)  # fmt: skip


def pick(rng: np.random.Generator, among: Sequence) -> Any:
    return among[int(rng.integers(len(among)))]


def cut(rng: np.random.Generator, content: bytes) -> bytes:
    """Bytes set to what hurts, runs of them made huge numbers, parts cut out, doubled, or the end cut off."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        i, j = sorted(int(k) for k in rng.integers(0, max(len(data), 1), 2))
        how = pick(rng, ["byte", "byte", "byte", "number", "number", "cut", "double", "end"])
        if how == "byte":
            data[i : i + 1] = bytes([pick(rng, [0, 1, 127, 128, 255, 0x2C, 0x0A, 0x22])])
        elif how == "number":
            width = pick(rng, [2, 4, 8])
            value = pick(rng, [10**9, 2**31 - 1, 2**32 - 1, 0, 2**63, 65535]) % 256**width
            data[i : i + width] = value.to_bytes(width, "little")
        elif how == "cut":
            del data[i : min(j, i + 2000)]
        elif how == "double":
            data[i:i] = data[i : min(j, i + 2000)]
        else:
            del data[j:]
    return bytes(data)


def text(inserted: Sequence[str]) -> Bytes:
    """Mutations of a text: its numbers, words and tags made others, long runs of one letter, and what is inserted."""

    def mutate(rng: np.random.Generator, content: bytes) -> bytes:
        if rng.random() < 0.15:
            return cut(rng, content)
        out = content.decode("utf-8", "replace")
        for _ in range(pick(rng, [1, 1, 1, 2])):
            how = pick(
                rng, ["number"] * 4 + ["word", "run", "run", "part", "part", "insert", "insert"]
            )
            if how == "number":
                out = _instead(rng, out, r"-?\d[\d.e+-]*", pick(rng, NUMBERS))
            elif how == "word":
                out = _instead(rng, out, r"\w+", pick(rng, WORDS))
            elif how == "part":
                out = _instead(
                    rng, out, r"<[^<>]*>|[^\n]*\n", r"\g<0>\g<0>" if rng.random() < 0.6 else ""
                )
            elif how == "run":
                at, count = int(rng.integers(len(out) + 1)), pick(rng, [3, 300, 40_000])
                out = out[:at] + pick(rng, LETTERS) * count + out[at:]
            elif inserted:
                spots = [m.end() for m in re.finditer(r"<(?:mujoco|robot|body|link)[^<>]*>", out)]
                at = pick(rng, spots) if spots else 0
                out = out[:at] + pick(rng, inserted) + out[at:]
        return out.encode("utf-8", "surrogatepass")

    return mutate


def _instead(rng: np.random.Generator, whole: str, pattern: str, new: str) -> str:
    found = [m for m in re.finditer(pattern, whole) if m.group()]
    if not found:
        return whole
    match = pick(rng, found)
    new = match.group() * 2 if new == r"\g<0>\g<0>" else new
    return whole[: match.start()] + new + whole[match.end() :]


def npz(rng: np.random.Generator, content: bytes) -> bytes:
    """One or two arrays of another shape, type or value, left out, renamed, or of millions of zeros."""
    if rng.random() < 0.3:
        return cut(rng, content)
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    for _ in range(pick(rng, [1, 1, 1, 2])):
        name = pick(rng, sorted(arrays))
        x = arrays.pop(name)
        how = pick(rng, ["shape", "type", "value", "value", "gone", "name", "huge", "text", "size"])
        if how == "shape":
            shapes = [(), (0,), (1, *x.shape), x.shape[::-1], (x.size,), (1,) * 32, (x.size, 1, 1)]
            wanted = pick(rng, [s for s in shapes if np.prod(s, dtype=int) in (x.size, 0, 1)])
            x = np.resize(x, wanted)
        elif how == "type":
            kind = pick(rng, ["f2", "i1", "u8", ">f8", "c16", "?", "S3", "U4", "M8[s]", "V4"])
            try:
                x = np.asarray(x).astype(kind)
            except (ValueError, TypeError):
                x = np.zeros(x.shape, kind)
        elif how == "value" and x.dtype.kind == "f" and x.size:
            x = x.copy()
            x.flat[int(rng.integers(x.size))] = pick(
                rng, [np.nan, np.inf, -np.inf, 1e308, -1e30, 0]
            )
        elif how == "huge":
            x = np.zeros(
                (pick(rng, [1_000_000, 3_000_000]), *x.shape[1:][:1]), pick(rng, ["u1", "f8"])
            )
        elif how == "text":
            x = np.array(pick(rng, [["a", "a"], "x" * 5000, ["\x1b[2J", ""], "A", "\x00", "é" * 9]))
        elif how == "size" and x.ndim:
            x = np.concatenate([x, x[:1]])
        if how != "gone":
            arrays[name + "x" if how == "name" else name] = x
    out = io.BytesIO()
    save = np.savez_compressed if rng.random() < 0.7 else np.savez
    save(out, allow_pickle=False, **arrays)
    return out.getvalue()


def parquet(rng: np.random.Generator, content: bytes) -> bytes:
    """One or two columns of another type, length or name."""
    if rng.random() < 0.4:
        return cut(rng, content)
    import pyarrow as arrow
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(content))
    columns = {name: table.column(name).combine_chunks() for name in table.column_names}
    for _ in range(pick(rng, [1, 1, 1, 2])):
        name = pick(rng, sorted(columns))
        x = columns.pop(name)
        count = len(x)
        how = pick(rng, ["name", "name", "type", "null", "value", "gone"])
        if how == "name":
            name = pick(rng, [name + pick(rng, LETTERS[:-2]) * pick(rng, [1, 40_000]) + "x", " ", "\x1b",
                              name + " [" + "(" * 500, name + " [deg]", "qpos.", "observation.state"])  # fmt: skip
        elif how == "type":
            made = [["a"] * count, [[1.0, 2.0]] * count, [[1.0]] * (count - 1) + [[]], [b"x"] * count,
                    [True] * count, [{"a": 1}] * count, [None] * count, ["x" * 3000] * count]  # fmt: skip
            x = arrow.array(pick(rng, made))
        elif how == "null":
            x = arrow.array([None, *x.to_pylist()[1:]], type=x.type)
        elif how == "value" and arrow.types.is_floating(x.type):
            x = arrow.array([pick(rng, [np.nan, np.inf, 1e308, -1.0]), *x.to_pylist()[1:]])
        if how != "gone":
            columns[name] = x
    out = io.BytesIO()
    pq.write_table(arrow.table(columns), out, compression=pick(rng, ["none", "zstd", "snappy"]))
    return out.getvalue()


def bag(write: Callable[[Path, list], Path], maker: Any, suffix: str) -> Bytes:
    """Messages whose names, values and stamps do not fit, or a sound bag's bytes hit at random."""

    def mutate(rng: np.random.Generator, content: bytes) -> bytes:
        if rng.random() < 0.6:
            return cut(rng, content)
        sent = []
        for k in range(int(rng.integers(0, 12))):
            names = tuple(
                pick(rng, ["a", "b", "", "\x1b", "x" * 3000]) for _ in range(int(rng.integers(4)))
            )
            sizes = [len(names) if rng.random() < 0.9 else pick(rng, [0, 1, 500]) for _ in range(3)]
            values = [[pick(rng, [0.0, 1.0, np.nan, np.inf, 1e308])] * size for size in sizes]
            stamp = pick(rng, [0, k * 10**7 + 10**18, k * 10**7 + 10**18, 10**18, 2 * 10**18])
            sent.append(("/j", maker.joints(stamp, names, *values), 10**18 + k))
        with tempfile.TemporaryDirectory() as name:
            return write(Path(name) / f"log.{suffix}", sent).read_bytes()

    return mutate
