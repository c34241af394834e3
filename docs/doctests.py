"""For mkdocstrings: examples of docstrings (>>> ...) as code, which Markdown would take for text and links."""

import griffe


def fenced(text: str) -> str:
    """The docstring with a fence around every run of lines that begins with `>>>`."""
    out, inside = [], False
    for line in text.splitlines():
        if line.lstrip().startswith(">>>") and not inside:
            out.append("```pycon")
            inside = True
        if inside and not line.strip():
            out.append("```")
            inside = False
        out.append(line)
    return "\n".join([*out, "```"] if inside else out)


class Doctests(griffe.Extension):
    """Fences them as objects are loaded."""

    def on_object(self, *, obj: griffe.Object, **kwargs) -> None:
        if obj.docstring is not None:
            obj.docstring.value = fenced(obj.docstring.value)
