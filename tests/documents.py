"""The code of a document, block by block: Python, and lines of shell that call torchmesh."""

import re
import shlex
from pathlib import Path

import torch

from torchmesh.commands.main import main

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and code of each block of a page."""
    return BLOCK.findall(page.read_text(encoding="utf-8"))


def run_line(line: str, status: int = 0) -> None:
    """A line of shell in this process; its comment may say another exit status than this one."""
    command, _, comment = line.partition("#")
    expected = int(match[1]) if (match := re.search(r"exit status (\d)", comment)) else status
    program, *arguments = shlex.split(command)
    assert program == "torchmesh", line
    assert main(arguments) == expected, line


def run(code: list[tuple[str, str]], **names: object) -> None:
    """Blocks of Python and shell, in order, in this process and in the current folder, with one set of names."""
    names = {"__name__": "__main__", **names}
    with torch.random.fork_rng(devices=[]):
        for language, text in code:
            if language == "python":
                exec(compile(text, "<a block of the page>", "exec"), names)
            elif language == "sh":
                for line in text.strip().splitlines():
                    run_line(line)
