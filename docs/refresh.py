"""Run the blocks of pages and write beneath each what it prints now: python docs/refresh.py docs/tutorial.md ...

What the tests would accept stays as it is. Read the difference before you keep it: the page's words may no longer fit.
"""

import contextlib
import doctest
import io
import os
import sys
import tempfile
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.documents.test_pages import FENCE, LOOSE, Checker, blocks, commands, shell


def kept(wanted: str, got: str) -> str:
    """Return the old output if it will do, the new one if not."""
    return wanted if wanted and Checker().check_output(wanted, got, LOOSE) else got


def python_block(body: str, session: dict[str, object]) -> str:
    """Run the examples of a block in a session and return the block with their output."""
    lines = []
    for example in doctest.DocTestParser().get_examples(body):
        first, *more = example.source.rstrip("\n").split("\n")
        lines += [f">>> {first}\n", *(f"... {line}".rstrip() + "\n" for line in more)]
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            try:
                exec(compile(example.source, "<page>", "single"), session)
            except Exception as error:
                said.write("Traceback (most recent call last):\n...\n")
                said.write("".join(traceback.format_exception_only(error)))
        lines.append(kept(example.want, said.getvalue()))
    return "".join(lines)


def console_block(body: str, folder: Path) -> str:
    """Run the commands of a block in a folder and return the block with their output."""
    parts = []
    for typed, command, wanted in commands(body):
        got = "\n".join(line.rstrip() for line in shell(command, folder).split("\n"))
        parts += [typed, kept(wanted, got)]
    return "".join(parts)


def refresh(page: Path) -> None:
    """Rewrite a page."""
    text, made, done = page.read_text(), [], 0
    session: dict[str, object] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        sys.path.insert(0, place)
        for match in FENCE.finditer(text):
            (block,) = blocks(match[0])
            body = match["body"]
            if block.caption is not None:
                Path(block.caption).write_text(block.body)
            elif block.kind == "python":
                body = python_block(body, session)
            elif block.kind == "console":
                body = console_block(body, Path(place))
            made += [text[done : match.start("body")], body]
            done = match.end("body")
        sys.path.remove(place)
    page.write_text("".join(made) + text[done:])


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for name in sys.argv[1:]:
        refresh(Path(name).resolve())
