"""The diagnoser's process: sees the package, one log at a time, and nothing of the examination.

Started by `solve.py` in an empty folder with an empty environment, `python -I`, as text (this file is not imported from
here). Reads one JSON line per log from its input, runs the public command on it, answers with one JSON line.
"""

import sys

PACKAGE, SCRATCH, LIBRARIES, *READABLE = sys.argv[1:]
SAID = 4000
"""Characters of what the command printed that are kept, its last ones."""


def _isolate() -> None:
    """Only the copied package beside installed libraries can be imported; only what is allowed can be opened.

    The audit hook sees what Python opens (not what a C library might): a fence against accidents and shortcuts.
    """
    import os
    from importlib.util import find_spec
    from pathlib import Path

    own = Path(PACKAGE).resolve()

    def clean(path: str) -> bool:
        """Not a folder from which the examination could be imported."""
        places = (Path(path) / inside for inside in (".", "blind", "benchmarks/blind"))
        return not any((place / "vault.py").exists() for place in places)

    libraries = [p for p in LIBRARIES.split(os.pathsep) if p]
    sys.path[:] = [str(own), *(p for p in dict.fromkeys([*sys.path, *libraries]) if clean(p))]
    # Editable installs may bring finders of their own, past sys.path.
    sys.meta_path[:] = [f for f in sys.meta_path if "editable" not in repr(f).lower()]
    for name in ("benchmarks.blind", "benchmarks.exam", "vault"):
        try:
            found = find_spec(name)
        except ModuleNotFoundError:
            continue
        if found is not None:
            raise SystemExit(f"isolation: {name} can be imported from {found.origin}")
    spec = find_spec("jax_inertia")
    if spec is None or not Path(spec.origin or "").resolve().is_relative_to(own):
        raise SystemExit("isolation: jax_inertia would not come from the copy")
    roots = [sys.prefix, sys.base_prefix, sys.exec_prefix, str(own), SCRATCH, *READABLE]
    roots += [os.path.realpath(r) for r in roots]
    roots += [p for p in sys.path if p]
    roots += ["/usr", "/lib", "/lib64", "/bin", "/etc", "/proc", "/sys", "/dev", "/opt", "/var/lib"]
    allowed = tuple({os.path.join(r, "") for r in roots})

    def hook(event: str, args: tuple) -> None:
        if event not in ("open", "os.listdir", "os.scandir") or not isinstance(
            args[0], str | bytes
        ):
            return
        path = os.path.realpath(os.fsdecode(args[0]))
        if not os.path.join(path, "").startswith(allowed):
            raise PermissionError(f"isolation: {path} is not for the diagnoser")

    sys.addaudithook(hook)


def _serve() -> None:
    import contextlib
    import io
    import json
    import os
    import time
    import traceback

    lines, answers = sys.stdin, os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in lines:
        job = json.loads(line)
        start = time.perf_counter()
        console = io.StringIO()
        try:
            from jax_inertia.cli.main import main

            code = 0
            with contextlib.redirect_stdout(console), contextlib.redirect_stderr(console):
                try:
                    code = main(job["arguments"]) or 0
                except SystemExit as stop:
                    code = stop.code if isinstance(stop.code, int) else 1
            answer = {"exit": code}
        except Exception:
            answer = {"exit": 1, "error": traceback.format_exc()[-3000:]}
        answer["seconds"] = time.perf_counter() - start
        answer["console"] = console.getvalue()[-SAID:]
        sys.stderr.write(answer["console"])
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


_isolate()
_serve()
